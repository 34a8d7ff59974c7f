"""A process that times JAX cases on request, because precision, cores and caches are fixed once per process.

It reads one line of JSON at a time, ``{"case": NAME, "number": ROUND}``, and answers with one: the seconds of that
round, the work done and its error (`timed`), and the most memory used so far (bytes). Without a number the case
is compiled: `compile_seconds` is how much longer a first call takes than a second.
"""

import argparse
import json
import os
import sys
import time
from typing import Any

import jax

from .cases import CASES, Run
from .memory import largest_memory
from .rounds import Timed
from .sizes import FULL, TINY, Sizes


class _Clock:
    """The cases that this process has compiled."""

    def __init__(self, sizes: Sizes):
        self.sizes = sizes
        self.ready: dict[str, Run] = {}

    def compile_seconds(self, name: str) -> float:
        if name in self.ready:
            return 0.0
        self.ready[name] = CASES[name](self.sizes)
        first, second = self.timed(name, 0), self.timed(name, 0)
        return first.seconds - second.seconds

    def timed(self, name: str, number: int) -> Timed:
        started = time.perf_counter()
        done = self.ready[name](number)
        seconds = time.perf_counter() - started
        return Timed(seconds, done.amount, done.error)

    def answer(self, case: str, number: int | None) -> dict[str, Any]:
        memory = largest_memory()
        if number is None:
            return {"compile_seconds": self.compile_seconds(case), "memory": memory}
        return {"timed": self.timed(case, number), "memory": memory}


def main() -> None:
    """Answer requests until the input ends."""
    options = argparse.ArgumentParser()
    options.add_argument("--float32", action="store_true")
    options.add_argument("--one-core", action="store_true", help="stay on one core, XLA's own threads included")
    options.add_argument("--tiny", action="store_true", help="as little work as possible")
    chosen = options.parse_args()
    if chosen.one_core and hasattr(os, "sched_setaffinity"):
        # Two workers may compile at the same time, one in each precision.
        os.sched_setaffinity(0, {(max if chosen.float32 else min)(os.sched_getaffinity(0))})
    jax.config.update("jax_enable_x64", not chosen.float32)
    if not chosen.tiny:  # compilations are timed
        jax.config.update("jax_enable_compilation_cache", False)
    clock, answers = _Clock(TINY if chosen.tiny else FULL), sys.stdout
    sys.stdout = sys.stderr
    for line in sys.stdin:
        print(json.dumps(clock.answer(**json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
