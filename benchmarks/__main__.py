"""Measure everything: ``python -m benchmarks``. `make bench` calls it, and then `benchmarks.table`."""

import argparse
import datetime
import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from threading import Lock
from typing import Any

from .parts import PARTS
from .workers import Bench

SHARING = ("stepping", "compiling", "motor cart")
"""These parts compile the same programs: a tiny run has one process do so, beside another for the other parts."""
RESULTS = Path(__file__).with_name(".build") / "latest.json"


def _options() -> argparse.Namespace:
    options = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    options.add_argument("--rounds", type=int, default=15, help="how often each program is timed")
    options.add_argument("--only", action="append", choices=PARTS, help="this part alone; may be given again")
    options.add_argument("--tiny", action="store_true", help="as little work as possible: shows that everything runs")
    options.add_argument("--out", type=Path, default=RESULTS, help="where the results go (JSON)")
    return options.parse_args()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _measure(names: Sequence[str], bench: Bench, keep: Callable[[str, list[dict[str, Any]]], None]) -> None:
    try:
        for name in names:
            started = time.perf_counter()
            keep(name, PARTS[name].measure(bench))
            if not bench.tiny:  # later parts must not share the machine, or memory, with processes of earlier ones
                bench.close()
            print(f"{name}: {time.perf_counter() - started:.0f} s", flush=True)
    finally:
        bench.close()


def main() -> None:
    """Run the parts and write what they measured, each when it is done: an end before the last one loses nothing."""
    chosen = _options()
    names = chosen.only or list(PARTS)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    results = {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "machine": f"{_processor()}, {cores} cores; Python {platform.python_version()}, jax {version('jax')}",
        "rounds": chosen.rounds,
        "parts": {},
    }
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    chosen.out.write_text(json.dumps(results))  # nothing of an earlier run
    one_writes = Lock()

    def keep(name: str, rows: list[dict[str, Any]]) -> None:
        with one_writes:
            results["parts"][name] = rows
            chosen.out.write_text(json.dumps(results, indent=1))

    shares = [[name for name in names if (name in SHARING) is sharing] for sharing in (True, False)]
    with ThreadPoolExecutor(2 if chosen.tiny else 1) as pool:
        list(pool.map(lambda share: _measure(share, Bench(chosen.rounds, chosen.tiny), keep), shares))


if __name__ == "__main__":
    main()
