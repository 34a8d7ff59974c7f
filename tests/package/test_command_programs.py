"""The command keeps its programs in the user's cache folder, and works whatever becomes of that."""

import json
import os
import subprocess
import sys

import pytest
from support.study import config_file

from stickslip_jax._compiler.programs import VARIABLE
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
    """The numbers that the study told; it had nothing to complain of."""
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    assert err == ""
    return {name: json.loads(out)[name] for name in STATISTICS}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems keep caches elsewhere")
def test_two_at_once_a_later_one_and_one_that_finds_only_ruins_agree(tmp_path):
    both = [start(tmp_path, name) for name in ("one", "two")]
    first, second = map(finish, both)
    folder = tmp_path / "caches" / "stickslip_jax" / "programs"
    kept = {path: path.read_bytes() for path in folder.iterdir()}
    assert kept
    third = finish(start(tmp_path))
    assert {path: path.read_bytes() for path in folder.iterdir()} == kept
    for path, data in kept.items():
        path.write_bytes(data[:-20])
    fourth = finish(start(tmp_path))
    assert {path for path in folder.iterdir() if path.read_bytes() != kept[path][:-20]} == set(kept)
    assert first == second == third == fourth


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["off", "/dev/null/nowhere"])
def test_without_a_folder_it_works_and_leaves_nothing(tmp_path, folder):
    assert finish(start(tmp_path, **{VARIABLE: folder}))
    assert not (tmp_path / "caches").exists()


@pytest.mark.slow
def test_a_cache_of_jax_that_the_user_chose_is_used_too(tmp_path):
    chosen = tmp_path / "own"
    finish(start(tmp_path, JAX_COMPILATION_CACHE_DIR=str(chosen), JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0"))
    assert any(chosen.glob("*-cache"))
