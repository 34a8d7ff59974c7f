"""The processor that this process runs on, its memory, and the device that JAX computes on."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

_LIMIT = Path("/sys/fs/cgroup/memory.max")  # of a container


def cores() -> int:
    """Number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def device() -> Any:
    """The `jax.Device` that JAX computes on by default."""
    return next(iter(jax.device_put(0.0).devices()))


def usual_threads() -> int:
    """One for each core; for another device than a CPU one thread keeps it busy."""
    return cores() if device().platform == "cpu" else 1


_MOST_LANES = 2**20


def lanes_at_once(usual: int, useful: int, size: Callable[[], float]) -> int:
    """How many lanes to simulate side by side.

    On a CPU the `usual` number, whose arrays stay in its cache. A GPU is idle with so few, and needs hundreds of
    thousands: on other devices as many as are `useful`, up to a million, a power of two, that take at most half of its
    free memory, each `size()` bytes of it.
    """
    here = device()
    if here.platform == "cpu":
        return usual
    known = here.memory_stats() or {}
    free = known.get("bytes_limit", float("inf")) - known.get("bytes_in_use", 0)
    fits = int(min(_MOST_LANES, 0.5 * free / size()))
    return max(usual, min(1 << (useful - 1).bit_length(), 1 << max(fits.bit_length() - 1, 0)))


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
