"""The process: its processor and memory, and forks of it in which the threads of JAX are missing."""

import os
import re
from pathlib import Path

import jax

# The processor that this process runs on, and its memory.


_LIMIT = Path("/sys/fs/cgroup/memory.max")  # of a container


def cores() -> int:
    """Number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def available_memory() -> float:
    """Bytes that a program can still take, as far as the system tells; infinite where it does not."""
    try:
        found = re.search(r"MemAvailable: +([0-9]+) kB", Path("/proc/meminfo").read_text(encoding="ascii"))
        available = 1024.0 * int(found[1]) if found else float("inf")
        limit = _LIMIT.read_text(encoding="ascii").strip() if _LIMIT.exists() else "max"
    except (OSError, ValueError):
        return float("inf")
    return min(available, float(limit)) if limit.isdigit() else available


def require_memory(name: str, size: float, what: str) -> None:
    """Raises ValueError where `size` bytes are not there. `name`: the argument that asks for them. `what` they are."""
    there = available_memory()
    if size > there:
        raise ValueError(
            f"Argument {name} must be smaller: {what} would take about {_shown(size)}, and {_shown(there)} of memory "
            "are free."
        )


def _shown(size: float) -> str:
    return f"{size / 1e9:.3g} GB"


# Forks of a process in which JAX has started: its threads are not in the fork, and what needs them waits for ever.


_PROBED = "jax_num_cpu_devices"  # which JAX refuses to change once it has started


class _State:
    """`started`: whether JAX had started when this process was forked last. `lost`: whether this is such a fork."""

    started = False
    lost = False


def require_threads_of_jax() -> None:
    """Raises RuntimeError in a fork of a process in which JAX had started."""
    if _State.lost:
        raise RuntimeError(
            "JAX cannot run in a fork of a process in which it had started, and would wait for threads that are not "
            'there; start processes by multiprocessing.get_context("spawn"), or let Sweep.run(workers=...) do it.'
        )


def _before() -> None:
    _State.started = _State.lost or _has_started()


def _in_fork() -> None:
    _State.lost = _State.started


def _has_started() -> bool:
    """Whether JAX has started. No function of JAX tells it, but it refuses another number of devices from then on."""
    now = getattr(jax.config, _PROBED)
    try:
        # Any negative number is the number that the flags of XLA say.
        jax.config.update(_PROBED, -2 if now < 0 else now + 1)
    except RuntimeError:
        return True
    jax.config.update(_PROBED, now)
    return False


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before, after_in_child=_in_fork)
