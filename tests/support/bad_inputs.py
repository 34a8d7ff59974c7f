"""Bad inputs by the thousand, in a process of their own: python -m support.bad_inputs GROUP NUMBER SEED.

It prints, as JSON, how many there were, and what was said of each that was answered obscurely.
"""

import contextlib
import json
import resource
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np

MEMORY = 24 * 2**30  # bytes of addresses: what takes more was not refused in time


def main(group: str, number: int, seed: int) -> None:
    jax.config.update("jax_enable_x64", True)
    jax.devices()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    draw, obscure, cases = np.random.default_rng(seed), [], 0
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):  # sweeps make folders of any name
        for name, told in _files(draw, number, Path(folder)) if group == "files" else _calls(draw, group, number):
            cases += 1
            if told:
                obscure.append([name, told])
    print(json.dumps({"cases": cases, "obscure": obscure}))


def _calls(draw, group, number):
    from support import bad_calls  # noqa: PLC0415

    for name, target, wrong in bad_calls.cases(draw, group, number):
        print(name, file=sys.stderr, flush=True)  # the last one is where a process died
        yield name, bad_calls.outcome(target, wrong)


def _files(draw, number, folder):
    from support import bad_files  # noqa: PLC0415

    for name, text, swept in bad_files.cases(draw, number):
        print(name, file=sys.stderr, flush=True)
        yield name, bad_files.outcome(text, folder / "study.toml", swept=swept)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
