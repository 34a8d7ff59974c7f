"""Parameter sweeps by the command: their files, running, stopping, looking at them."""

import json
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from datetime import datetime, timedelta
from pathlib import Path
from typing import get_args

import jax
import matplotlib as mpl
import numpy as np
import pytest
from support.study import BAD_SWEEPS, config_file

mpl.use("Agg")

import stickslip_jax as ss
from stickslip_jax import _cli as cli
from stickslip_jax import papers
from stickslip_jax._sweep.dataset import SweepStatus, _seconds_left, read_dataset
from stickslip_jax._sweep.store import manifest_text
from stickslip_jax.study._reading import PAPERS, Paper, read_sweep_config
from stickslip_jax.study._run import status_text, sweep_of

COMMAND = [sys.executable, "-m", "stickslip_jax._cli"]
SMALL = """
[run]
t1 = 20.0
samples = 3000

[sweep]
keep = "totals"
batch = 1024

[sweep.over]
mu = [0.5, 1.0]
rate = { logspace = [0.5, 2.0, 3] }
"""
LONG = """
[run]
t1 = 2000.0
samples = 100_000

[sweep]
keep = "totals"
batch = 4096

[sweep.over]
mu = { linspace = [0.5, 2.0, 4] }
"""


KEPT = "what is done is kept, and the same command goes on from there.\n"

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a small sweep that is done."""
    folder = tmp_path_factory.mktemp("sweep")
    sweep_of(read_sweep_config(config_file(folder, SMALL))).run(folder / "done", progress=False)
    return folder / "done"


def _refused(capsys, *arguments, code=2):
    """Run the command, which must fail in one sentence; returns it."""
    assert cli.main([str(argument) for argument in arguments]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("stickslip: ")
    assert err.count("\n") == 1
    return err


# --- the file


# Sensitivities need exact friction, so no one file holds every key: each of the two adds to the rest what the other
# cannot have: lines of [run], of [sweep] and of [sweep.over], and what they are in Python.
FORMS = {
    "exact friction, sensitivities": (
        "",
        'sensitivities = { stick_fraction = ["mu", "stiffness"] }',
        "",
        {"sensitivities": [("stick_fraction", ("mu", "stiffness"))]},
        {},
    ),
    "regularised friction, its width swept": (
        "width = 0.01",
        "",
        '"method.width" = [0.01, 0.02]',
        {"method": ss.Regularized(0.01)},
        {"method.width": [0.01, 0.02]},
    ),
}


@pytest.mark.parametrize(("run", "sweep", "swept", "options", "over"), FORMS.values(), ids=FORMS.keys())
def test_file_is_the_sweep_that_python_makes(tmp_path, run, sweep, swept, options, over):
    text = f"""
[system]
mu = 0.7
[base]
law = "SquareWave"
speed = 2.0
period = 3.0
[run]
t1 = 30.0
samples = 200
seed = 5
initial_position = 0.1
orders = 4
count_initial_rest = true
{run}
[sweep]
statistics = ["stick_fraction", "mean_stick_duration"]
independent = true
standard_error = {{ stick_fraction = 0.01 }}
realizations = 2
batch = 50
{sweep}
[sweep.over]
initial_velocity = {{ linspace = [0, 1, 3] }}
"mu, period" = [[0.5, 1.0], [1.0, 2.0]]
speed = {{ logspace = [1, 4, 3] }}
{swept}
"""
    config = read_sweep_config(config_file(tmp_path, text))
    assert read_sweep_config(config_file(tmp_path, config.to_toml())) == config
    expected = ss.Sweep(
        ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7), damping=0.0),
        ss.SquareWave(2.0, 3.0),
        over={
            "y0[1]": [0.0, 0.5, 1.0],
            ("mu", "period"): [[0.5, 1.0], [1.0, 2.0]],
            "speed": [1.0, 2.0, 4.0],
            **over,
        },
        t1=30.0,
        samples=200,
        key=jax.random.key(5),
        y0=(0.1, 1.0),
        statistics=[ss.stick_fraction, ss.mean_stick_duration],
        orders=4,
        count_initial_rest=True,
        independent=True,
        standard_error={"stick_fraction": 0.01},
        realizations=2,
        batch=50,
        **options,
    )
    assert manifest_text(sweep_of(config).plan) == manifest_text(expected.plan)


@pytest.mark.parametrize(
    "name", [name if name == "stick-share-random" else pytest.param(name, marks=pytest.mark.slow) for name in PAPERS]
)
def test_papers_by_name_are_those_of_the_module(name):
    belt = name.removeprefix("stick-share-")
    expected = papers.parametric_analysis() if belt == name else papers.stick_share_map(belt)
    assert manifest_text(sweep_of(read_sweep_config(paper=name)).plan) == manifest_text(expected.plan)
    assert list(get_args(Paper)) == list(PAPERS)


def test_printed_configuration_is_one_to_start_from(capsys, tmp_path):
    assert cli.main(["sweep", "--paper", "stick-share-random", "--samples", "7", "--print-config"]) == 0
    path = config_file(tmp_path, capsys.readouterr().out)
    assert read_sweep_config(path) == read_sweep_config(None, {"samples": 7}, paper="stick-share-random")


@pytest.mark.parametrize("case", BAD_SWEEPS)
def test_mistakes_name_file_and_key(capsys, tmp_path, case):
    text, said = BAD_SWEEPS[case]
    path = config_file(tmp_path, text)
    sentence = _refused(capsys, "sweep", path, "--out", "out")
    assert sentence.startswith(f"stickslip: {path}: ")
    assert said in sentence
    assert os.listdir() == [path.name]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["sweep"], "Option --out must name the folder"),
        (["sweep", "none.toml", "--out", "x"], "none.toml: no such file; `stickslip sweep --print-config` prints one"),
        (["sweep", "a.toml", "--paper", "parametric-analysis"], "were both given"),
        (["sweep", "--paper", "parametric"], "--paper"),
        (
            ["sweep", "--out", "x", "--threads", "2", "--workers", "2"],
            "Options --threads and --workers were both given",
        ),
        (["sweep", "--out", "x", "--workers", "0"], "option --workers must be at least 1, but 0 was given."),
        (["sweep", "--out", "x", "--samples", "0"], "option --samples must be greater than or equal to 1"),
        (["sweep", "--out", "/dev/null"], "/dev/null cannot hold a sweep, because it is a file"),
        (["resume"], "requires an argument"),
        (["resume", "none"], "none holds no sweep"),
        (["status", "none"], "none holds no sweep"),
        (["show", "none"], "none holds no sweep"),
        (["show", "none", "--out", "figure.txt"], "option --out must be a file name that ends in .png or .pdf or .svg"),
        (["status", "a", "b"], "b was given as well"),
    ],
)
def test_bad_arguments_are_refused(capsys, arguments, said):
    assert said in _refused(capsys, *arguments)
    assert os.listdir() == []


# --- run, looked at


def test_sweep_prints_what_the_ensembles_of_the_points_say(capsys, tmp_path):
    path = config_file(tmp_path, SMALL)
    assert cli.main(["sweep", str(path), "--out", "sweep", "--threads", "2"]) == 0
    out = capsys.readouterr().out
    sweep = sweep_of(read_sweep_config(path))
    rows = [line.split() for line in out.splitlines() if line.count("+-") == 5]
    assert len(rows) == 6
    for row in rows:
        many = sweep.ensemble_at(mu=float(row[0]), rate=float(row[1]), keep="totals", progress=False)
        assert " ".join(row[2:5]) == str(ss.stick_fraction(many)).split(": ")[1]
    assert "MassSpring, PoissonSwitching, on [0, 20] s (float64): 6 points, 3,000 samples each" in out
    assert "sweep/sweep.nc" in out


def test_the_same_sweep_adds_samples_and_another_is_refused(capsys, tmp_path):
    path = config_file(tmp_path, SMALL.replace("3000", "1024"))
    assert cli.main(["sweep", str(path), "--out", "sweep", "--quiet"]) == 0
    assert cli.main(["sweep", str(path), "--out", "sweep", "--quiet", "--samples", "2048"]) == 0
    assert capsys.readouterr() == ("", "")
    assert np.all(read_dataset(Path("sweep"))["samples"] == 2048)
    other = config_file(tmp_path, SMALL.replace("20.0", "25.0"))
    said = _refused(capsys, "sweep", other, "--out", "sweep")
    assert "t1: 20.0 there, 25.0 here" in said


def test_the_time_that_is_left_follows_from_the_log(tmp_path):
    """At the pace since the run under way began: 1500 samples in 60 s, 3000 are left."""
    ago = [(datetime.now() - timedelta(seconds=seconds)).strftime("%Y-%m-%d %H:%M:%S") for seconds in (900, 60, 30)]
    lines = [
        f"{ago[0]} begun: 6 points, 1000 samples each", f"{ago[0]} done mu = 1: samples 0 to 9 in 0.1 s",
        f"{ago[1]} begun: 6 points, 1000 samples each", f"{ago[2]} done mu = 1: samples 0 to 999 in 0.1 s",
    ]  # fmt: skip
    (tmp_path / "log.txt").write_text("\n".join([*lines, f"{ago[2]} done mu = 2: samples 500 to 999 in 0.1 s"]))
    assert _seconds_left(tmp_path, 3000) == pytest.approx(120, abs=5)
    (tmp_path / "log.txt").write_text(lines[2])
    assert _seconds_left(tmp_path, 3000) is None
    how_far = SweepStatus(6, 1, 1500, 4500, False, {}, 60.0, True, False, 121.0)
    assert "\nTime left at this pace: about 2 min 1 s." in status_text(tmp_path, how_far)


def test_loading_does_not_warn_of_a_precision_that_only_a_run_has(finished):
    with jax.enable_x64(False), warnings.catch_warnings():
        warnings.simplefilter("error")
        assert ss.Sweep.load(finished).points == 6


@pytest.mark.slow
def test_status_and_table_of_a_finished_sweep(capsys, finished, monkeypatch):
    assert cli.main(["status", str(finished)]) == 0
    first, spent, how = capsys.readouterr().out.splitlines()
    assert first == f"{finished}: 6 of 6 points done, 18,000 of 18,000 samples; finished."
    assert spent.startswith("Time spent simulating: ")
    assert how == f"`stickslip show {finished}` prints the result."
    assert cli.main(["show", str(finished), "--statistics", "mean_slip_count"]) == 0
    out = capsys.readouterr().out
    assert "mean number of" in out
    assert out.count("+-") == 6
    monkeypatch.setattr("stickslip_jax.study._run._MOST_ROWS", 4)
    assert cli.main(["show", str(finished), "--statistics", "mean_slip_count"]) == 0
    out = capsys.readouterr().out
    assert out.count("+-") == 4
    assert "\nand 2 more points: ss.Sweep.load(folder).results has all of them\n" in out
    said = _refused(capsys, "show", finished, "--statistics", "mean_slip_cout")
    assert "did you mean mean_slip_count?" in said
    assert cli.main(["show", str(finished), "--out", "figure.png"]) == 0
    assert Path("figure.png").read_bytes().startswith(b"\x89PNG")
    capsys.readouterr()
    said = _refused(capsys, "show", finished, "--out", "figure.png")
    assert "option --out must be a new file" in said
    assert "--force" in said
    assert cli.main(["show", str(finished), "--out", "figure.png", "--force"]) == 0


def test_looking_changes_nothing_and_leaves_damaged_batches_out(capsys, finished, tmp_path):
    """A batch that is cut in half is removed by resume, not by status or show; so are unfinished files."""
    folder = tmp_path / "copy"
    folder.mkdir()
    (folder / "batches").mkdir()
    for path in [finished / "manifest.json", *(finished / "batches").iterdir()]:
        (folder / path.relative_to(finished)).write_bytes(path.read_bytes())
    damaged = sorted((folder / "batches").iterdir())[0]
    damaged.write_bytes(damaged.read_bytes()[: damaged.stat().st_size // 2])
    (folder / "batches" / "new.zip.1.unfinished").write_bytes(b"")
    before = {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in folder.rglob("*") if path.is_file()}
    assert cli.main(["status", str(folder)]) == 0
    assert "not running." in capsys.readouterr().out
    assert cli.main(["show", str(folder)]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line[:5].strip() in ("0.5", "1")]
    assert sorted(line.count("+-") for line in rows) == [0, 5, 5, 5, 5, 5]
    after = {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in folder.rglob("*") if path.is_file()}
    assert after == before


# --- as a process of its own


def _started(*arguments, said="done"):
    """A run in ``sweep``, begun, and with a line that says `said` in its log."""
    begun = _log().count("begun")
    process = subprocess.Popen(
        [*COMMAND, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 120
    while (_log().count("begun") == begun or said not in _log()) and time.monotonic() < deadline:
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    return process


def _log():
    path = Path("sweep/log.txt")
    return path.read_text() if path.exists() else ""


def _numbers(folder):
    dataset = read_dataset(Path(folder))
    return {name: np.asarray(one) for name, one in dataset.data_vars.items() if name != "run_seconds"}


@pytest.mark.slow
def test_stopped_sweep_goes_on(capsys, tmp_path):
    """Ctrl-C waits for the batches under way; SIGTERM and a second Ctrl-C do not. Nothing that is stored is lost."""
    path = config_file(tmp_path, LONG)
    process = _started("sweep", path, "--out", "sweep", "--threads", "1")
    try:
        assert cli.main(["status", "sweep"]) == 0
        assert "0 of 4 points done" in (said := capsys.readouterr().out)
        assert "running now." in said
        assert cli.main(["show", "sweep", "--out", "figure.png"]) == 0
        assert capsys.readouterr().out.count("+-") >= 5
        assert "in use by another run" in _refused(capsys, "resume", "sweep")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    finally:
        process.kill()
    assert (process.returncode, out) == (130, "")
    asked, stopped = err.strip().splitlines()
    assert asked.startswith("Stopping after the batches under way")
    done = re.fullmatch(  # the batches under way may be the last of a point
        "stickslip: Stopped with ([01]) of 4 points done; `stickslip resume sweep`, or the same call again, goes on "
        r"from here\.",
        stopped,
    )
    assert done
    assert cli.main(["status", "sweep"]) == 0
    assert f"{done[1]} of 4 points done" in capsys.readouterr().out
    stored = set(Path("sweep/batches").iterdir())
    process = _started("resume", "sweep", "--threads", "1")
    try:
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, out, err) == (143, "", f"stickslip: Terminated; {KEPT}")
    assert stored <= set(Path("sweep/batches").iterdir())
    assert cli.main(["status", "sweep"]) == 0
    assert "`stickslip resume sweep` goes on from here." in capsys.readouterr().out


@pytest.mark.slow
def test_second_interrupt_ends_a_sweep_at_once(capsys, tmp_path):
    """The batch under way takes minutes: a short one could end, and with it the process, before the second Ctrl-C."""
    path = config_file(tmp_path, LONG.replace("t1 = 2000.0", "t1 = 1e6").replace("batch = 4096", "batch = 100_000"))
    process = _started("sweep", path, "--out", "sweep", "--threads", "1", said="begun")
    time.sleep(1.0)  # until a batch is under way: before, there is nothing to wait for
    try:
        process.send_signal(signal.SIGINT)
        said = process.stderr.readline() + process.stderr.readline()
        assert said.startswith("\nStopping after the batches under way")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, out, err) == (130, "", f"stickslip: Interrupted; {KEPT}")
    assert cli.main(["status", "sweep"]) == 0
    assert "`stickslip resume sweep` goes on from here." in capsys.readouterr().out


@pytest.mark.slow
def test_resumed_sweep_has_the_numbers_of_one_that_was_not_stopped(tmp_path, finished):
    path = config_file(tmp_path, SMALL)
    sweep = sweep_of(read_sweep_config(path))
    sweep.run("sweep", progress=False)
    batches = sorted(Path("sweep/batches").iterdir())
    for one in batches[::2]:
        one.unlink()
    Path("sweep/sweep.nc").unlink()
    assert cli.main(["resume", "sweep", "--workers", "1", "--quiet"]) == 0
    numbers, expected = _numbers("sweep"), _numbers(finished)
    assert numbers.keys() == expected.keys()
    for name, values in numbers.items():
        assert np.array_equal(values, expected[name], equal_nan=True), name


@pytest.mark.slow
def test_answers_without_a_simulation_do_not_start_jax(finished):
    code = f"""
import sys
import jax
from stickslip_jax._cli import main
for command in ("sweep", "resume", "status", "show"):
    assert main([command, "--help"]) == 0
assert main(["sweep", "--print-config"]) == 0
assert main(["sweep", "--samples", "0", "--out", "x"]) == 2
assert not {{"xarray", "h5netcdf", "matplotlib.pyplot"}} & set(sys.modules)
assert main(["status", {json.dumps(str(finished))}]) == 0
jax.config.update("jax_num_cpu_devices", 2)  # raises RuntimeError if JAX has started
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
