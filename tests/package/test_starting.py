"""Ctrl-C while the command is being loaded: one sentence, at whatever moment, and only for the command."""

import os
import random
import signal
import subprocess
import sys
import time

import pytest

import stickslip_jax
from stickslip_jax._compiler.programs import VARIABLE

SCRIPT = """
import sys
print("begun", flush=True)
from stickslip_jax._cli import main
if __name__ == "__main__":
    sys.exit(main())
"""
"""What the console script of the command does."""


def environment(tmp_path) -> dict[str, str]:
    """Where a program finds the package, whatever its folder, and keeps its compilations, whoever runs the tests."""
    root = os.path.dirname(os.path.dirname(stickslip_jax.__file__))
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | {"PYTHONPATH": os.pathsep.join(paths), VARIABLE: str(tmp_path / "compiled")}


def started(tmp_path, name: str, *arguments: str) -> subprocess.Popen:
    """The command as a program of this name, begun."""
    script = tmp_path / name
    script.write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, str(script), *arguments], env=environment(tmp_path), cwd=tmp_path,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout.readline() == "begun\n"
    return process


def interrupted(tmp_path, after: float) -> tuple[int, str]:
    """How the command ends that gets Ctrl-C some time after its beginning."""
    # A sweep that takes minutes, however much of it earlier calls have done.
    process = started(tmp_path, "stickslip", "sweep", "--out", "sweep", "--samples", "10000000")
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    time.sleep(0.02)
    process.send_signal(signal.SIGINT)  # as impatient people do; a sweep stops at the second one
    _, err = process.communicate(timeout=120)
    return process.returncode, err


@pytest.mark.parametrize("after", [0.15, 0.4])
def test_ctrl_c_while_the_command_is_loaded(tmp_path, after):
    code, err = interrupted(tmp_path, after)
    assert (code, err.count("\n")) == (130, 1)
    assert err.startswith("stickslip: Interrupted; ")


@pytest.mark.slow
def test_ctrl_c_at_forty_moments_of_the_first_seconds(tmp_path):
    chance = random.Random(3)
    for _ in range(40):
        after = chance.uniform(0.05, 4.0)
        code, err = interrupted(tmp_path, after)
        assert code == 130, (after, err)
        assert "Traceback" not in err
        assert err.splitlines()[-1].startswith("stickslip: ")


@pytest.mark.slow
def test_other_programs_answer_ctrl_c_themselves():
    """Also while the package is loaded, and afterwards."""
    code = (
        "import signal, sys\nbefore = signal.getsignal(signal.SIGINT)\nimport stickslip_jax, stickslip_jax._cli\n"
        "assert signal.getsignal(signal.SIGINT) is before\n"
        "from stickslip_jax import _starting\n_starting.begin()\n"
        "assert signal.getsignal(signal.SIGINT) is before\n"
        "sys.argv[0] = '/usr/bin/stickslip'\n_starting.begin()\n"
        "assert signal.getsignal(signal.SIGINT) is _starting._interrupted\n"
        "_starting.end()\nassert signal.getsignal(signal.SIGINT) is before\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n_starting.begin()\n_starting.end()\n"
        "assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_program_that_has_the_name_of_the_command_keeps_ctrl_c(tmp_path):
    """One that loads the package, and not the command: Python's answer is back when it is loaded."""
    script = tmp_path / "stickslip"
    script.write_text(
        "import signal\nimport stickslip_jax\nassert signal.getsignal(signal.SIGINT) is signal.default_int_handler\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)], env=environment(tmp_path), capture_output=True, text=True,
        timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
