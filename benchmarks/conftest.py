"""Workers that outlive a test: starting JAX takes seconds."""

import json
import subprocess
import sys

import pytest


class Worker:
    """A process of `benchmarks.worker`."""

    def __init__(self, *options: str):
        command = [sys.executable, "-W", "ignore", "-m", "benchmarks.worker", *options]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(self, case: str, rounds: int) -> dict:
        """Time `case` so many times; 0 only compiles it."""
        self.process.stdin.write(f"{case} {rounds}\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        if not answer:
            raise RuntimeError(f"the worker ended while it timed {case!r}; its message is above")
        return json.loads(answer)

    def close(self) -> None:
        """End the process."""
        self.process.communicate()


@pytest.fixture(scope="session")
def workers():
    """The worker for given options, started when first asked for."""
    started: dict[tuple[str, ...], Worker] = {}

    def get(*options: str) -> Worker:
        if options not in started:
            started[options] = Worker(*options)
        return started[options]

    yield get
    for worker in started.values():
        worker.close()
