"""The processor that this process runs on, its memory, and the device that JAX computes on."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import jax

from .checks import warn

_LIMIT = Path("/sys/fs/cgroup/memory.max")  # of a container


def cores() -> int:
    """Number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def device() -> Any:
    """The `jax.Device` that JAX computes on by default."""
    return next(iter(jax.device_put(0.0).devices()))


# How work is laid out, by the device: the only place where that is decided.
#
# A core of a CPU is fastest with so few trajectories side by side (lanes) that their arrays stay in its cache, one
# thread for each core; sticks are collected and counted by loops of Numba on the host. A GPU is idle with so few. It
# takes as many lanes as its memory holds, in one thread, many steps in one launch, and collects and counts sticks
# itself, so that only sums are copied. Here the latter is called wide.


VARIABLE = "STICKSLIP_LANES"
"""The environment variable that asks for so many lanes, and so for the wide layout, on any device (docs/devices.md)."""
_MOST_LANES, _FEWEST = 2**20, 2**8
_RECORDED_AT_ONCE = 2**17  # steps of all lanes in a call that keeps sticks: few calls, records that stay in the cache
WIDE_BLOCKS = 16
"""Blocks of steps in a call that keeps sticks, in the wide layout: after each call the host asks for two numbers."""


def lanes_asked() -> int | None:
    """What the environment variable asks for; None if nothing. Raises ValueError for what is no number of lanes."""
    text = os.environ.get(VARIABLE, "").strip()
    if text in ("", "0"):
        return None
    if not re.fullmatch("[1-9][0-9]{0,8}", text):
        raise ValueError(
            f"Environment variable {VARIABLE} must be a whole number of lanes, such as 65536, but {text!r} was given; "
            "leave it out to have the device decide."
        )
    return int(text)


def is_wide() -> bool:
    """Whether work is laid out for a device of many lanes."""
    return lanes_asked() is not None or device().platform != "cpu"


def usual_threads() -> int:
    """One for each core; in the wide layout one keeps the device busy."""
    return 1 if is_wide() else cores()


def free_memory() -> float:
    """Bytes that are free on the device, infinite where it does not tell."""
    here = device()
    if here.platform == "cpu":
        return available_memory()
    known = here.memory_stats() or {}
    return float(known.get("bytes_limit", float("inf")) - known.get("bytes_in_use", 0))


def lanes_at_once(usual: int, useful: int, size: Callable[[], float]) -> int:
    """How many lanes to simulate side by side: the `usual` number on a CPU.

    In the wide layout as many as are `useful`, up to a million or what is asked for, a power of two, that take at most
    half of the free memory of the device, each `size()` bytes of it.
    """
    if not is_wide():
        return usual
    fits = int(min(lanes_asked() or _MOST_LANES, 0.5 * free_memory() / size()))
    return max(usual, min(1 << (useful - 1).bit_length(), 1 << max(fits.bit_length() - 1, 0)))


def blocks_at_once(lanes: int, steps: int) -> int:
    """How many blocks of so many `steps` a call that keeps sticks takes."""
    return WIDE_BLOCKS if is_wide() else max(1, _RECORDED_AT_ONCE // (steps * lanes))


_Found = TypeVar("_Found")


def fewer_lanes(error: Exception, lanes: int) -> int:
    """Half as many lanes, with a warning, where by the `error` the device lacks memory for these; else raises it."""
    if "RESOURCE_EXHAUSTED" not in str(error) or lanes <= _FEWEST:
        raise error
    warn(f"The device lacks memory for {lanes:,} trajectories at a time; {lanes // 2:,} are simulated at a time.")
    return lanes // 2


def as_many_as_fit(run: Callable[[int], _Found], lanes: int) -> _Found:
    """`run` of so many lanes, or of half as many, and so on, where the device lacks memory for them."""
    while True:
        try:
            return run(lanes)
        except jax.errors.JaxRuntimeError as error:
            lanes = fewer_lanes(error, lanes)


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
