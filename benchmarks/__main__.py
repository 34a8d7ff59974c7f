"""Measure everything: ``python -m benchmarks``. `make bench` calls it, and then `benchmarks.table`."""

import argparse
import datetime
import json
import os
import platform
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
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


def _measured(names: Sequence[str], bench: Bench) -> dict[str, list[dict[str, Any]]]:
    rows = {}
    try:
        for name in names:
            started = time.perf_counter()
            rows[name] = PARTS[name].measure(bench)
            if not bench.tiny:  # later parts must not share the machine, or memory, with processes of earlier ones
                bench.close()
            print(f"{name}: {time.perf_counter() - started:.0f} s", flush=True)
    finally:
        bench.close()
    return rows


def main() -> None:
    """Run the parts and write what they measured."""
    chosen = _options()
    names = chosen.only or list(PARTS)
    shares = [[name for name in names if (name in SHARING) is sharing] for sharing in (True, False)]
    with ThreadPoolExecutor(2 if chosen.tiny else 1) as pool:
        found = list(pool.map(lambda share: _measured(share, Bench(chosen.rounds, chosen.tiny)), shares))
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    results = {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "machine": f"{_processor()}, {cores} cores; Python {platform.python_version()}, jax {version('jax')}",
        "rounds": chosen.rounds,
        "parts": {name: rows for share in found for name, rows in share.items()},
    }
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    chosen.out.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
