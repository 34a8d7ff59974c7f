"""Processes that time JAX cases on request (`benchmarks.worker`), seen from the program that asks."""

import json
import os
import subprocess
import sys
from typing import Any

from stickslip_jax._compiler.programs import VARIABLE

from .rounds import Program, Timed


class Worker:
    """One such process. Starting JAX takes seconds, so it is asked again and again."""

    def __init__(self, *options: str, programs: str = "off", **variables: str):
        """With compiled `programs` from that folder; by default each is compiled, since that is timed.

        `variables`: of its environment.
        """
        command = [sys.executable, "-W", "ignore", "-m", "benchmarks.worker", *options]
        environment = {**os.environ, "MPLBACKEND": "Agg"} | ({} if "--tiny" in options else {VARIABLE: programs})
        environment |= variables
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        self.memory = 0
        """The most memory that it has used so far, bytes."""

    def prepare(self, case: str) -> float:
        """Compile `case`; returns how long that took, s."""
        return self._ask(case, None)["compile_seconds"]

    def run(self, case: str, number: int) -> Timed:
        """Time `case` once, with the random numbers of that round."""
        return Timed(*self._ask(case, number)["timed"])

    def program(self, case: str, label: str | None = None, calls: int | None = None) -> Program:
        """`case`, compiled, as a program to be timed."""
        seconds = self.prepare(case)
        return Program(label or case, lambda number: self.run(case, number), seconds, calls)

    def close(self) -> None:
        """End the process."""
        self.process.communicate()

    def _ask(self, case: str, number: int | None) -> dict[str, Any]:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps({"case": case, "number": number}) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"the worker ended while it timed {case!r}; its message is above")
        answer = json.loads(line)
        self.memory = answer["memory"]
        return answer


class Bench:
    """What every part is given: how many rounds to make, whether tiny, and workers."""

    def __init__(self, rounds: int, tiny: bool):
        self.rounds, self.tiny = rounds, tiny
        self._workers: dict[tuple[str, ...], Worker] = {}

    def worker(self, *options: str, alone: str = "") -> Worker:
        """The worker for these options, started when first asked for; with another `alone` another process.

        Tiny runs do without most of them: they show that everything works, not how much memory or time it takes.
        """
        if self.tiny:
            options, alone = tuple(option for option in options if option != "--one-core"), ""
        chosen = (*options, alone)
        if chosen not in self._workers:
            self._workers[chosen] = Worker(*options, *["--tiny"] * self.tiny)
        return self._workers[chosen]

    def close(self) -> None:
        """End all workers."""
        while self._workers:
            self._workers.popitem()[1].close()
