"""The command keeps what JAX compiled for it in the user's cache folder, and works whatever becomes of that."""

import json
import os
import subprocess
import sys
import time

import pytest
from support.study import config_file

from stickslip_jax._foundation import compilation_cache
from stickslip_jax._foundation.compilation_cache import VARIABLE
from stickslip_jax.study._run import STATISTICS

COMMAND = [sys.executable, "-m", "stickslip_jax._cli", "study", "--json", "--force"]


def start(folder, out="result", **variables):
    """A study in `folder`, as a process without cache folders but its own."""
    variables = {"XDG_CACHE_HOME": str(folder / "caches"), **variables}
    usual = {name: value for name, value in os.environ.items() if name not in (VARIABLE, "JAX_COMPILATION_CACHE_DIR")}
    return subprocess.Popen(
        [*COMMAND, str(config_file(folder)), "--out", str(folder / out), "--quiet"],
        env={**usual, **variables}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def finish(process):
    """What the study told: its numbers, and its complaints."""
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return {name: json.loads(out)[name] for name in STATISTICS}, err


# One small function instead of a study.
SMALL = """
from stickslip_jax._foundation.compilation_cache import use
print(use())
import jax
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
print(jax.jit(lambda x: jax.numpy.sin(x) + 1)(0.5))
"""


def test_ruined_entries_cost_a_compilation_and_no_word(tmp_path):
    def told():
        variables = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
        done = subprocess.run(
            [sys.executable, "-c", SMALL], env=variables | {VARIABLE: str(tmp_path)}, capture_output=True, text=True,
            timeout=300, check=True,
        )  # fmt: skip
        return done.stdout, done.stderr

    first = told()
    assert first[0].startswith("\n1.479")
    assert first[1] == ""
    entries = sorted(tmp_path.glob("*-cache"))
    assert entries
    for path in entries:
        path.write_bytes(path.read_bytes()[:-20])
    assert told() == first


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems keep caches elsewhere")
def test_two_at_once_a_later_one_and_one_that_finds_only_ruins_agree(tmp_path):
    both = [start(tmp_path, name) for name in ("one", "two")]
    (first, err), (second, other_err) = map(finish, both)
    assert (err, other_err) == ("", "")
    (folder,) = (tmp_path / "caches" / "stickslip_jax").iterdir()
    entries = sorted(folder.glob("*-cache"))
    assert entries
    kept = {path: path.read_bytes() for path in entries}
    third, err = finish(start(tmp_path))
    assert err == ""
    assert {path: path.read_bytes() for path in entries} == kept
    for path in entries:
        path.write_bytes(path.read_bytes()[:-20])
    fourth, err = finish(start(tmp_path))
    assert err == ""
    assert first == second == third == fourth


@pytest.mark.slow
def test_switched_off_it_leaves_nothing(tmp_path):
    numbers, err = finish(start(tmp_path, **{VARIABLE: "off"}))
    assert err == ""
    assert numbers
    assert not (tmp_path / "caches").exists()


@pytest.mark.slow
def test_folder_that_cannot_be_written_is_told_of_once(tmp_path):
    numbers, err = finish(start(tmp_path, **{VARIABLE: "/dev/null/nowhere"}))
    assert numbers
    assert err.count("\n") == 1
    assert "/dev/null" in err
    assert f"{VARIABLE} chooses a folder" in err


@pytest.mark.slow
def test_what_the_user_chose_stays(tmp_path):
    chosen = tmp_path / "own"
    finish(start(tmp_path, JAX_COMPILATION_CACHE_DIR=str(chosen), JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0"))
    assert any(chosen.glob("*-cache"))
    assert not (tmp_path / "caches").exists()


def test_halves_that_a_killed_process_left_are_removed(tmp_path):
    """But neither what another process may be writing just now, nor whole entries."""
    for name in ("whole-cache", "whole-atime", "old-cache", "young-cache"):
        (tmp_path / name).write_bytes(b"0")
    long_ago = time.time() - 3600
    for name in ("whole-cache", "old-cache"):
        os.utime(tmp_path / name, (long_ago, long_ago))
    compilation_cache._remove_halves(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["whole-atime", "whole-cache", "young-cache"]
