"""Processes that keep their programs in a folder."""

import os
import subprocess
import sys
from pathlib import Path

from stickslip_jax._compiler.programs import VARIABLE


def in_processes(number: int, code: str, folder: Path, **environment: str) -> list[str]:
    """What each of this number of processes prints that run `code` at once."""
    started = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, VARIABLE: str(folder), **environment},
        )
        for _ in range(number)
    ]
    printed = [one.communicate()[0] for one in started]
    assert all(one.returncode == 0 for one in started)
    return printed
