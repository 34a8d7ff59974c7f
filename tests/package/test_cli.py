"""The ``stickslip`` command: output, exit codes, and that nothing is left of a failure."""

import gc
import json
import os
import signal
import subprocess
import sys
import time
import weakref
from typing import get_args

import pytest
import xarray as xr
from support.study import BAD_CONFIGS, SMALL, config_file

import stickslip_jax as ss
from stickslip_jax import _cli as cli
from stickslip_jax.study._reading import EXAMPLES, Example, read_config
from stickslip_jax.study._run import CONFIG, DATA, STATISTICS, SUMMARY

COMMAND = [sys.executable, "-m", "stickslip_jax._cli"]


pytestmark = pytest.mark.usefixtures("in_an_empty_folder")


def _subprocess(*arguments, **options):
    return subprocess.run(
        [*COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=120, check=False, **options
    )


def _refused(capsys, arguments, code=2):
    """Run the command, which must fail in one sentence and write nothing; returns the sentence."""
    before = sorted(os.listdir())
    assert cli.main([str(argument) for argument in arguments]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("stickslip: ")
    assert err.count("\n") == 1
    assert sorted(os.listdir()) == before
    return err


# --- in this process


@pytest.mark.parametrize("arguments", [[], ["--help"], ["study", "--help"]])
def test_help(capsys, arguments):
    assert cli.main(arguments) == 0
    assert "Usage: stickslip" in capsys.readouterr().out


def test_version(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == ss.__version__


def test_printed_configuration_is_one_to_start_from(capsys, tmp_path):
    assert cli.main(["study", "--print-config", "--samples", "7", "--out", "elsewhere"]) == 0
    path = config_file(tmp_path, capsys.readouterr().out)
    assert read_config(path) == read_config(None, {"samples": 7, "out": "elsewhere"})
    assert os.listdir() == [path.name]


@pytest.mark.parametrize("name", EXAMPLES)
def test_printed_example_is_one_to_start_from(capsys, tmp_path, name):
    assert cli.main(["study", "--print-example", name, "--seed", "7"]) == 0
    path = config_file(tmp_path, capsys.readouterr().out)
    assert read_config(path) == read_config(None, {"seed": 7}, example=name)
    assert os.listdir() == [path.name]


@pytest.mark.parametrize("case", ["unknown key", "unknown law", "negative mass", "text for a number", "no TOML"])
def test_bad_configuration_is_refused(capsys, tmp_path, case):
    text, expected = BAD_CONFIGS[case]
    path = config_file(tmp_path, text)
    said = _refused(capsys, ["study", path])
    assert all(part in said for part in [str(path), *expected])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["study", "none.toml"], "none.toml: no such file"),
        (["study", "--smaples", "3"], "Did you mean --samples?"),
        (["study", "--samples", "2.7"], "--samples"),
        (["study", "--samples", "many"], "not a whole number"),
        (["study", "--samples", "0"], "option --samples must be greater than or equal to 1, but 0 was given."),
        (["study", "--samples"], "--samples requires an argument"),
        (["study", "--t1", "inf"], "option --t1 must be a finite number"),
        (["study", "--t1", "-1"], "option --t1 must be greater than 0, but -1.0 was given."),
        (["study", "--t1", "x"], "--t1"),
        (["study", "--t1", "1e300"], "t1"),
        (["study", "--out", ""], "option --out"),
        (["study", "--out", "/dev/null"], "/dev/null cannot hold a result"),
        (["study", "--out", "/dev/null/x"], "/dev/null/x cannot hold a result"),
        (["study", "--out", "null\0character"], "cannot be written"),
        (["study", "no\nsuch.toml"], "no such file"),
        (["study", "a.toml", "b.toml"], "b.toml"),
        (["study", "--print-example", "cart"], "--print-example"),
        (["study", "a.toml", "--print-example", "motor-cart"], "a.toml and --print-example motor-cart were both given"),
        (["explore", "--port", "80000"], "--port must be from 1 to 65535, or 0 for any free one, but 80000 was given."),
        (["explore", "--port", "-1"], "--port must be from 1 to 65535, or 0 for any free one, but -1 was given."),
        (["explore", "--samples", "1000000"], "--samples must be from 2 to 20,000, but 1,000,000 was given."),
        (["explore", "/dev/zero"], "/dev/zero: is longer than 16 MB"),
        (["stdy"], 'Did you mean "study"?'),
        (["--unknown"], "--unknown"),
    ],
)
def test_bad_arguments_are_refused(capsys, arguments, said):
    assert said in _refused(capsys, arguments)


@pytest.mark.slow
def test_table_and_files(capsys, tmp_path):
    assert cli.main(["study", str(config_file(tmp_path)), "--out", "result"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    lines = out.splitlines()
    for name in ("stick fraction", "mean number of sticks", "mean number of slips", "mean slip duration (pooled)"):
        assert any(line.startswith(name) for line in lines)
    assert "All 40 samples reached t1." in lines
    assert any("to compile" in line and "to run" in line for line in lines)
    assert f"Files in result: {CONFIG}, {SUMMARY}, {DATA}" in lines
    assert sorted(os.listdir("result")) == [DATA, CONFIG, SUMMARY]


@pytest.mark.slow
def test_quiet_prints_nothing(capsys, tmp_path):
    assert cli.main(["study", str(config_file(tmp_path)), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert sorted(os.listdir("results/study")) == [DATA, CONFIG, SUMMARY]


def test_quiet_leaves_json(capsys, tmp_path):
    assert cli.main(["study", str(config_file(tmp_path)), "--quiet", "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert set(STATISTICS) < set(json.loads(out))


@pytest.mark.slow
def test_result_is_replaced_only_by_force(capsys, tmp_path):
    path = str(config_file(tmp_path))
    assert cli.main(["study", path, "--quiet"]) == 0
    before = os.stat(f"results/study/{DATA}").st_mtime_ns
    said = _refused(capsys, ["study", path, "--seed", "1"])
    assert "results/study" in said
    assert "--force" in said
    assert os.stat(f"results/study/{DATA}").st_mtime_ns == before
    assert cli.main(["study", path, "--seed", "1", "--quiet", "--force"]) == 0
    with xr.open_dataset(f"results/study/{DATA}") as dataset:
        assert dataset.attrs["run_seed"] == 1


def test_existing_result_is_refused_before_anything_is_simulated(capsys, tmp_path, monkeypatch):
    (tmp_path / DATA).write_text("mine")
    monkeypatch.setattr("stickslip_jax.study._run.simulate_ensemble", lambda *_, **__: pytest.fail("simulated"))
    assert "holds a result" in _refused(capsys, ["study", "--out", tmp_path])


@pytest.mark.parametrize("force", [[], ["--force"]])
@pytest.mark.parametrize(("failure", "code"), [(OSError(28, "No space left on device"), 1), (KeyboardInterrupt(), 130)])
def test_failure_in_the_middle_leaves_all_as_it_was(capsys, tmp_path, monkeypatch, force, failure, code):
    if force:
        os.mkdir("result")
        (tmp_path / "result" / DATA).write_text("old")

    def write_half(path, *_):
        path.write_text("half")
        raise failure

    monkeypatch.setattr("stickslip_jax.study._run.write_netcdf", write_half)
    said = _refused(capsys, ["study", config_file(tmp_path), "--out", "result", *force], code)
    full = "'result' cannot be written (No space left on device); make room: nothing was changed."
    assert full in said or "Interrupted" in said
    if force:
        assert os.listdir("result") == [DATA]
        assert (tmp_path / "result" / DATA).read_text() == "old"


class Dying:
    """What calls a function when it is collected."""

    def __init__(self, call):
        self.call = call

    def __del__(self):
        self.call()


def of_the_collector(call):
    def collecting(phase, info):
        gc.callbacks.remove(collecting)
        call()

    gc.callbacks.append(collecting)
    gc.collect()


def of_a_weak_reference(call):
    dying = Dying(lambda: None)
    _ = weakref.ref(dying, lambda reference: call())
    del dying


def of_a_finalizer(call):
    Dying(call)


@pytest.mark.slow
@pytest.mark.parametrize("callback", [of_the_collector, of_a_weak_reference, of_a_finalizer])
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_stop_whose_exception_python_drops_is_not_lost(capsys, tmp_path, monkeypatch, number, code, callback):
    """JAX and numba have such callbacks, which run after every long compilation."""

    def simulate(*_, **__):
        callback(lambda: os.kill(os.getpid(), number))
        time.sleep(5)
        pytest.fail("not stopped")

    monkeypatch.setattr("stickslip_jax.study._run.simulate_ensemble", simulate)
    assert "no result was written" in _refused(capsys, ["study", config_file(tmp_path)], code)


def test_other_dropped_exceptions_are_told_as_ever(capsys, tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(sys, "unraisablehook", lambda dropped: told.append(dropped.exc_type))
    usual = sys.unraisablehook

    def simulate(*_, **__):
        of_a_finalizer(lambda: 1 / 0)
        raise MemoryError

    monkeypatch.setattr("stickslip_jax.study._run.simulate_ensemble", simulate)
    _refused(capsys, ["study", config_file(tmp_path)], 1)
    assert told == [ZeroDivisionError]
    assert sys.unraisablehook is usual


# --- as a process of its own


@pytest.mark.slow
def test_json_alone_on_standard_output(tmp_path):
    done = _subprocess("study", config_file(tmp_path), "--json", "--figures")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    assert set(STATISTICS) < set(content)
    assert content["stick_fraction"]["value"] > 0
    assert content["stick_fraction"]["standard_error"] > 0
    assert content["not_finished"] == {}
    assert all(os.path.isfile(name) for name in content["files"])
    assert "All 40 samples reached t1." in done.stderr
    assert "Warning" not in done.stderr
    with xr.open_dataset(f"results/study/{DATA}") as dataset:
        assert float(dataset["stick_fraction"]) == content["stick_fraction"]["value"]
        assert dataset["stick_start"].dtype == "float64"


@pytest.mark.slow
def test_float32_is_a_choice(tmp_path):
    done = _subprocess("study", config_file(tmp_path, SMALL.replace("[run]", '[run]\ndtype = "float32"')))
    assert (done.returncode, done.stderr) == (0, "")
    assert "(float32, seed 0)" in done.stdout
    with xr.open_dataset(f"results/study/{DATA}") as dataset:
        assert dataset["stick_start"].dtype == "float32"


@pytest.mark.slow
def test_bad_input_ends_the_process_with_code_2(tmp_path):
    done = _subprocess("study", config_file(tmp_path, "[system]\nmas = 1.0"))
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr
        == f"stickslip: {tmp_path}/case.toml: unknown key mas in [system] of the model MassSpring; did you mean mass?\n"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code", "seconds"),
    [(signal.SIGINT, 130, 0.5), (signal.SIGTERM, 143, 3)],
    ids=["while compiling", "while running"],
)
def test_interrupted_process_leaves_nothing(tmp_path, number, code, seconds):
    endless = '[run]\nsamples = 2_000_000_000\nkeep = "statistics"\n[output]\ndirectory = "result"\n'
    arguments = ["study", str(config_file(tmp_path, endless))]
    process = subprocess.Popen(
        [*COMMAND, *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        deadline = time.monotonic() + 60
        while not os.path.exists("result") and time.monotonic() < deadline:
            time.sleep(0.02)
        time.sleep(seconds)
        process.send_signal(number)
        out, err = process.communicate(timeout=30)
    finally:
        process.kill()
    assert (process.returncode, out) == (code, "")
    assert err in (
        "stickslip: Interrupted; no result was written.\n",
        "stickslip: Terminated; no result was written.\n",
    )
    assert os.listdir() == ["case.toml"]


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["--help"], ["study", "--print-config"]])
def test_output_that_nobody_reads_to_its_end_is_no_failure(arguments):
    """As in ``stickslip ... | head``: no message, and the exit code of a process that SIGPIPE ended."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            [*COMMAND, *arguments], stdout=writing, stderr=subprocess.PIPE, text=True, timeout=120, check=False
        )
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, "")


def test_another_broken_pipe_is_told(capsys, tmp_path, monkeypatch):
    def broken(*arguments, **options):
        raise BrokenPipeError("of a worker")

    monkeypatch.setattr("stickslip_jax.study._run.run_study", broken)
    assert "of a worker" in _refused(capsys, ["study", config_file(tmp_path, SMALL)], code=1)


@pytest.mark.slow
def test_answers_without_a_simulation_do_not_start_jax():
    code = """
import sys
import jax
from stickslip_jax._cli import main
assert main(["study", "--help"]) == 0
assert main(["study", "--print-config"]) == 0
for name in ("harmonic-base", "base-isolation", "motor-cart"):
    assert main(["study", "--print-example", name]) == 0
assert main(["study", "--samples", "0"]) == 2
assert not {"xarray", "h5netcdf", "matplotlib.pyplot"} & set(sys.modules)
jax.config.update("jax_num_cpu_devices", 2)  # raises RuntimeError if JAX has started
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr


def test_every_example_can_be_asked_for():
    assert list(get_args(Example)) == list(EXAMPLES)


WITHOUT_EXTRAS = """
import sys
for name in ("xarray", "h5netcdf", "h5py", "tqdm", "cyclopts", "pydantic", "filelock", "loky", "pandas", "panel"):
    sys.modules[name] = None
import jax
import stickslip_jax as ss
from stickslip_jax._cli import main
jax.config.update("jax_enable_x64", True)
there = [getattr(ss, name) for name in dir(ss) if name != "study"]
there += [getattr(ss.plot, name) for name in ss.plot.__all__]
sweep = ss.Sweep(ss.papers.belt_oscillator(), ss.PoissonSwitching(1.0, 1.0), over={"mu": [1.0]}, t1=5.0, samples=2,
                 key=jax.random.key(0))
calls = (
    lambda: ss.study,
    lambda: sweep.run(progress=False),
    lambda: ss.load(__file__),
    lambda: ss.nonlinear.basins(ss.papers.belt_oscillator(), ss.SquareWave(1.0, 2.0), y0=[[0.0, 1.0]]),
    lambda: ss.explore(ss.papers.belt_oscillator(), ss.Constant(1.0)),
)
for call in calls:
    try:
        call()
    except ImportError as error:
        print(error)
sys.exit(main(["--help"]))
"""


@pytest.mark.slow
def test_without_extras_all_names_are_there_and_each_says_what_it_needs(tmp_path):
    """`make test-wheel` tries everything, in an environment that has none."""
    program = tmp_path / "program.py"
    program.write_text(WITHOUT_EXTRAS)
    done = subprocess.run([sys.executable, program], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 1, done.stderr
    assert done.stderr == (
        "stickslip: Studies and the command need pydantic, cyclopts, xarray, h5netcdf, h5py, filelock: "
        "pip install 'stickslip_jax[study]'.\n"
    )
    assert [line.partition(":")[0] for line in done.stdout.splitlines()] == [
        "Studies and the command need pydantic, cyclopts, xarray, h5netcdf, h5py, filelock",
        "Sweeps need xarray, h5netcdf, h5py, filelock",
        "Files of ensembles need xarray, h5netcdf, h5py",
        "Labelled results need xarray",
        "The explorer needs panel, pydantic, xarray",
    ]


@pytest.mark.slow
def test_missing_extra_is_named():
    absent = "import sys; sys.modules['h5netcdf'] = None"
    code = f"{absent}; from stickslip_jax._cli import main; sys.exit(main(['study']))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "stickslip: Studies and the command need h5netcdf: pip install 'stickslip_jax[study]'.\n"
