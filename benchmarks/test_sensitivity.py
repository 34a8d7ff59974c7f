"""Time and error of the corrected derivative, beside the plain value and finite differences; the default study.

Marks: a relative standard error of at most 2 % from 100,000 trajectories, in at most 4 times the plain value's time.
"""

import json
import subprocess
import sys

import pytest

PROGRAMS = (
    "value alone",
    "corrected derivative",
    "finite difference, step 1 %",
    "finite difference, step 0.2 %",
)


@pytest.fixture(scope="module")
def measured():
    """All programs, timed in turn in a process of their own."""
    command = [sys.executable, "-W", "ignore", "-m", "benchmarks.sensitivity", "--rounds", "5"]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


@pytest.mark.parametrize("name", PROGRAMS)
def test_sensitivity(benchmark, measured, name):
    """What the process found; `cost` is the time to a relative error of 1 %, where there is one."""
    mine = measured[name]
    benchmark.pedantic(lambda: None, rounds=1)
    benchmark.extra_info |= {
        "sensitivity": name,
        "seconds": mine["seconds"],
        "times_value": mine["seconds"] / measured["value alone"]["seconds"],
    }
    if "relative_error" in mine:
        benchmark.extra_info["relative_error"] = mine["relative_error"]
        benchmark.extra_info["cost"] = mine["seconds"] * (mine["relative_error"] / 0.01) ** 2
