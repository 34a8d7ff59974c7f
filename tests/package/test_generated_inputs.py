"""More than ten thousand bad inputs, generated: each is taken with sense, or refused in one sentence that names it."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
GROUPS = {
    "constructors": 1000,
    "structures": 500,
    "periods": 200,
    "numbers_and_methods": 500,
    "designs": 500,
    "runs": 500,
    "results": 200,
    "files": 2000,
    "calibrations": 200,
}
"""How many besides one for each argument and kind of value."""
LEAST = {
    "constructors": 12_000,
    "structures": 7000,
    "periods": 5000,
    "numbers_and_methods": 5000,
    "designs": 3500,
    "runs": 7500,
    "results": 5000,
    "files": 2000,
    "calibrations": 5000,
}
"""How many there must be in all; more than ten thousand together."""

# Obscure outcomes that stay, by what is said of them, and why.
KNOWN = {
    r"len\(\) of unsized object|has no len\(\)|is not iterable": "A function of the user's fails in its own words.",
    "Fewer than two of 64 trajectories reached t1": "None that starts at 1e308: the ensemble is shown in lines.",
    r"SweepError: two\nlines holds ": "Names of files are shown as they are, with their ends of lines.",
}


@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
def test_no_bad_input_is_answered_obscurely(group):
    paths = [str(TESTS), str(TESTS.parent), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, "-m", "support.bad_inputs", group, str(GROUPS[group]), "26"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)}, capture_output=True, text=True, timeout=3000,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["cases"] >= LEAST[group]
    left = [(name, said) for name, said in told["obscure"] if not any(re.search(known, said) for known in KNOWN)]
    assert left == []
