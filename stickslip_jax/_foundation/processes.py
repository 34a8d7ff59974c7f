"""The processor that this process runs on, and its memory."""

import os
import re
from pathlib import Path

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
