"""The largest memory that the benchmarks print is that of their own process."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.memory import largest_memory

ROOT = Path(__file__).parents[2]
SIZE = 200_000_000


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_of_the_parent_does_not_count():
    held = np.ones(SIZE // 8)
    program = "from benchmarks.memory import largest_memory; print(largest_memory())"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert largest_memory() > held.nbytes
    assert 1e6 < int(done.stdout) < SIZE
