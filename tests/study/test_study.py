"""Studies: configuration, the folder of a result, and what is stored."""

import dataclasses
import json
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from support.study import BAD_CONFIGS, BAD_SYSTEMS_AND_BASES, SMALL, config_file

import stickslip_jax as ss
from stickslip_jax.study import StudyError
from stickslip_jax.study._config import OutputConfig, RunConfig, StudyConfig
from stickslip_jax.study._reading import OPTIONS, read_config
from stickslip_jax.study._run import (
    CONFIG,
    DATA,
    RESULT_FILES,
    STATISTICS,
    STICK_DURATIONS,
    SUMMARY,
    as_json,
    beginning_of_sample_0,
    result_folder,
    run_study,
    table,
)

LAWS = {
    "PoissonSwitching": (
        "speed = 2.0\nrate = 0.5\nfirst_sign = 'negative'",
        ss.PoissonSwitching(2.0, 0.5, "negative"),
    ),
    "SquareWave": ("speed = 2\nperiod = 3.5", ss.SquareWave(2.0, 3.5)),
    "RandomSteps": (
        "speed = 1.0\ninterval = 0.5\nlevels = [-1, 0, 2]\nprobabilities = [0.25, 0.25, 0.5]",
        ss.RandomSteps(1.0, 0.5, (-1.0, 0.0, 2.0), (0.25, 0.25, 0.5)),
    ),
    "Constant": ("speed = -1.5", ss.Constant(-1.5)),
    "PiecewiseConstant": (
        "times = [0, 1, 2.5]\nvelocities = [1, -1, 0]",
        ss.PiecewiseConstant(jax.numpy.array([0, 1, 2.5]), jax.numpy.array([1.0, -1.0, 0.0])),
    ),
}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A small study that has been run, with figures."""
    folder = tmp_path_factory.mktemp("small")
    options = {"out": str(folder / "result"), "figures": True}
    yield run_study(read_config(config_file(folder), options), progress=False)
    plt.close("all")


@pytest.fixture
def dataset(study):
    with xr.open_dataset(study.directory / DATA) as opened:
        yield opened


# --- configuration


def test_default_is_the_papers_oscillator_off_its_special_point():
    config = read_config()
    assert config == StudyConfig()
    assert config.system.build() == ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.8))
    assert config.base.build() == ss.PoissonSwitching(1.0, 1.0)
    run = config.run
    assert (run.t1, run.samples, run.seed, run.keep) == (200.0, 10_000, 0, "sticks")
    assert (run.initial_position, run.initial_velocity) == (0.0, 1.0)


@pytest.mark.parametrize("law", LAWS)
def test_round_trip_through_toml(tmp_path, law):
    keys, expected = LAWS[law]
    config = read_config(config_file(tmp_path, f'[base]\nlaw = "{law}"\n{keys}\n'))
    assert read_config(config_file(tmp_path, config.to_toml())) == config
    same = jax.tree.map(np.array_equal, config.base.build(), expected)
    assert jax.tree.all(same)
    assert jax.tree.structure(config.base.build()) == jax.tree.structure(expected)


def test_round_trip_of_unusual_values(tmp_path):
    config = StudyConfig(
        run=RunConfig(threads=3, chunk=7, seed=2**32 - 1, t1=1e-3),
        output=OutputConfig(directory='a "b"\\c\n\x7f\té', figures=False),
    )
    assert read_config(config_file(tmp_path, config.to_toml())) == config


def test_law_may_be_left_out(tmp_path):
    config = read_config(config_file(tmp_path, "[base]\nrate = 3.0\n"))
    assert config.base.build() == ss.PoissonSwitching(1.0, 3.0)


def test_options_replace_the_file(tmp_path):
    given = {"samples": 5, "seed": 7, "t1": 2.0, "threads": 1, "chunk": 2, "out": "elsewhere", "figures": True}
    config = read_config(config_file(tmp_path), given)
    assert set(given) == set(OPTIONS)
    assert (config.run.samples, config.run.seed, config.run.t1) == (5, 7, 2.0)
    assert (config.run.threads, config.run.chunk) == (1, 2)
    assert config.output == OutputConfig(directory="elsewhere", figures=True)
    assert read_config(config_file(tmp_path), dict.fromkeys(OPTIONS)) == read_config(config_file(tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("case", [*BAD_CONFIGS, *BAD_SYSTEMS_AND_BASES])
def test_bad_configuration_is_one_sentence_that_names_file_and_key(tmp_path, case):
    text, expected = (BAD_CONFIGS | BAD_SYSTEMS_AND_BASES)[case]
    path = config_file(tmp_path, text)
    with pytest.raises(StudyError) as caught:
        read_config(path)
    message = str(caught.value)
    for part in [str(path), *expected]:
        assert part in message
    assert "\n" not in message
    assert message.endswith((".", "?"))


@pytest.mark.parametrize(
    ("name", "content", "said"), [("none.toml", None, "no such file"), ("image.toml", b"\xff\xfe", "UTF-8")]
)
def test_configuration_that_cannot_be_read(tmp_path, name, content, said):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(StudyError, match=said):
        read_config(path)
    with pytest.raises(StudyError, match="cannot be read"):
        read_config(tmp_path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="this system has no such device")
def test_configuration_without_end():
    with pytest.raises(StudyError, match=r"/dev/zero: is longer than 16 MB, and no description of a study\."):
        read_config("/dev/zero")


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("samples", 0, "option --samples must be greater than or equal to 1, but 0 was given."),
        ("t1", -3.0, "option --t1 must be greater than 0, but -3.0 was given."),
        ("t1", float("nan"), "option --t1 must be a finite number, but nan was given."),
        ("seed", -1, "option --seed must be greater than or equal to 0, but -1 was given."),
        ("threads", 0, "option --threads must be greater than or equal to 1, but 0 was given."),
        ("chunk", 0, "option --chunk must be greater than or equal to 1, but 0 was given."),
        ("out", "", 'option --out must not be empty, but "" was given.'),
    ],
)
def test_bad_option_is_named(option, value, said):
    with pytest.raises(StudyError) as caught:
        read_config(None, {option: value})
    assert str(caught.value) == said


# --- the folder of a result


def _write(folder, text="new"):
    for name in (CONFIG, DATA):
        (folder / name).write_text(text)


def _make_result(directory, before_the_end=lambda: None, **options):
    with result_folder(directory, **options) as folder:
        _write(folder)
        before_the_end()


def test_result_appears_at_the_end_and_whole(tmp_path):
    directory = tmp_path / "a" / "b"
    with result_folder(directory) as folder:
        _write(folder)
        assert not any((directory / name).exists() for name in RESULT_FILES)
    assert sorted(path.name for path in directory.iterdir()) == sorted([CONFIG, DATA])


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_nothing_is_left_of_a_failure(tmp_path, failure):
    def fail():
        raise failure

    with pytest.raises(failure):
        _make_result(tmp_path / "a" / "b", fail)
    assert list(tmp_path.iterdir()) == []


def test_result_is_not_overwritten_unasked(tmp_path):
    (tmp_path / DATA).write_text("old")
    with pytest.raises(StudyError, match="holds a result already"), result_folder(tmp_path):
        pytest.fail("must be refused before the work begins")
    assert [path.name for path in tmp_path.iterdir()] == [DATA]
    assert (tmp_path / DATA).read_text() == "old"


def test_result_of_another_run_in_the_meantime_is_not_overwritten(tmp_path):
    with pytest.raises(StudyError, match="holds a result already"):
        _make_result(tmp_path, lambda: (tmp_path / DATA).write_text("theirs"))
    assert [path.read_text() for path in tmp_path.iterdir()] == ["theirs"]


def test_force_replaces_the_old_result_and_nothing_else(tmp_path):
    for name in (DATA, STICK_DURATIONS, "notes.txt"):
        (tmp_path / name).write_text("old")
    with result_folder(tmp_path, force=True) as folder:
        _write(folder)
        assert (tmp_path / DATA).read_text() == "old"
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        CONFIG: "new", DATA: "new", "notes.txt": "old",
    }  # fmt: skip


def test_old_result_survives_a_failing_replacement(tmp_path, monkeypatch):
    _write(tmp_path, "old")
    replace = type(tmp_path).replace

    def fail_for_new_data(source, target):
        if source.name == DATA and source.parent.name.startswith(".unfinished") and source.read_text() == "new":
            raise OSError("disk full")
        return replace(source, target)

    monkeypatch.setattr(type(tmp_path), "replace", fail_for_new_data)
    with pytest.raises(OSError, match="disk full"):
        _make_result(tmp_path, force=True)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {CONFIG: "old", DATA: "old"}


@pytest.mark.parametrize("below", ["", "child", "child/grandchild"])
def test_file_in_the_way_is_refused(tmp_path, below):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(StudyError, match="a file"), result_folder(tmp_path / "file" / below):
        pytest.fail("must be refused before the work begins")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


def test_folder_that_cannot_be_written_is_refused(tmp_path, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("stickslip_jax.study._run.tempfile.mkdtemp", refuse)
    with pytest.raises(StudyError, match="Permission denied"), result_folder(tmp_path / "new"):
        pytest.fail("must be refused before the work begins")
    assert list(tmp_path.iterdir()) == []


# --- what is stored


@pytest.mark.slow
def test_every_variable_has_units_and_a_name(dataset):
    assert len(dataset.data_vars) == 19 + 2 * len(STATISTICS)
    for variable in dataset.variables.values():
        assert variable.attrs["units"]
        assert variable.attrs["long_name"]


@pytest.mark.slow
def test_statistics_in_the_file_are_the_librarys(study, dataset):
    law, system = ss.PoissonSwitching(1.0, 1.0), ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.8))
    same = ss.simulate_ensemble(
        system, law, t1=20.0, samples=40, key=jax.random.key(0), y0=(0.0, 1.0), keep="sticks", chunk=64, progress=False
    )
    for name, estimate in STATISTICS.items():
        expected = estimate(same)
        assert expected.standard_error > 0
        assert float(dataset[name]) == expected.value
        assert float(dataset[f"{name}_standard_error"]) == expected.standard_error
        assert dataset[name].attrs["units"] == expected.unit
    np.testing.assert_array_equal(dataset["stick_start"], same.require_sticks().start)
    np.testing.assert_array_equal(dataset["stick_count"], same.require_sticks().count)


@pytest.mark.slow
def test_file_says_where_it_comes_from(study, dataset):
    attributes = dataset.attrs
    for name, version in {"stickslip_jax": ss.__version__, "jax": jax.__version__, "numpy": np.__version__}.items():
        assert attributes[f"{name}_version"] == version
    assert attributes["python_version"].startswith("3.")
    assert attributes["date_created"].endswith("+00:00")
    expected = {
        "system_mass": 1.0, "system_stiffness": 4.0, "system_normal_force": 1.0, "system_mu": 0.8,
        "base_law": "PoissonSwitching", "base_speed": 1.0, "base_rate": 1.0, "base_first_sign": "random",
        "run_t1": 20.0, "run_samples": 40, "run_seed": 0, "run_dtype": "float64",
        "run_initial_position": 0.0, "run_initial_velocity": 1.0,
        "samples_finished": 40, "samples_base_too_short": 0, "samples_not_finite": 0,
    }  # fmt: skip
    assert {name: attributes[name] for name in expected} == expected
    np.testing.assert_array_equal(attributes["key_data"], jax.random.key_data(jax.random.key(0)))


@pytest.mark.slow
def test_a_study_comes_back_as_an_ensemble(study):
    """From its folder or its file; the summary, the table and the file agree on the pooled sticks."""
    many = study.ensemble
    for path in (study.directory, study.directory / DATA):
        back = ss.load(path)
        assert repr(back.summary()) == repr(many.summary()) == (study.directory / SUMMARY).read_text().rstrip("\n")
        assert (back.system, back.law, back.y0, back.samples) == (many.system, many.law, many.y0, 40)
        for number in (0, 39):
            ours, theirs = back.realization(number), many.realization(number)
            np.testing.assert_array_equal(ours.base.durations, theirs.base.durations)
            assert ours.y0 == theirs.y0
    with xr.open_dataset(study.directory / DATA, group="statistics") as statistics:
        pooled = study.statistics["mean_stick_duration"]
        assert float(statistics["duration_mean"]) == pytest.approx(pooled.value, rel=1e-12)
        assert many.statistics.duration.mean.value == float(statistics["duration_mean"])
    sticks = many.flat_sticks
    later = sticks.start > 0
    assert 0 < np.sum(~later) < 40  # of those that begin at t = 0 none is pooled
    assert pooled.value == pytest.approx(sticks.duration[later].mean(), rel=1e-12)


def test_study_can_be_repeated_from_its_files(tmp_path, study, dataset):
    assert read_config(study.directory / CONFIG) == study.config
    assert read_config(config_file(tmp_path, dataset.attrs["configuration"])) == study.config


def test_figures_are_images(study):
    assert study.files == RESULT_FILES
    for name in study.files:
        if name.endswith(".png"):
            assert (study.directory / name).read_bytes().startswith(b"\x89PNG")


def test_figures_show_sample_0(study):
    one = beginning_of_sample_0(study.config, study.ensemble)
    ensemble = study.ensemble.sticks
    complete = np.asarray(one.sticks.mask) & (np.asarray(one.sticks.ending) != ss.Ending.HORIZON)
    assert complete.sum() > 2
    slots = np.flatnonzero(complete)
    np.testing.assert_allclose(np.asarray(one.sticks.start)[slots], ensemble.start[0, slots], rtol=0, atol=1e-12)


def test_statistics_alone_can_be_kept(tmp_path):
    config = read_config(config_file(tmp_path, SMALL + f'directory = "{tmp_path}/result"\n'))
    config = config.model_copy(update={"run": config.run.model_copy(update={"keep": "statistics"})})
    study = run_study(config, progress=False)
    with xr.open_dataset(study.directory / DATA) as dataset:
        assert "sample" not in dataset
        assert float(dataset["stick_fraction"]) == study.statistics["stick_fraction"].value


@pytest.mark.slow
def test_numbers_that_do_not_exist_are_null_and_said_to_be_undefined(tmp_path):
    # The mass starts on the circle of radius 0.5 m/s around its equilibrium: it never reaches the base's 5 m/s.
    text = '[base]\nlaw = "Constant"\nspeed = 5.0\n[run]\ninitial_velocity = 0.0\n' + SMALL.replace("[run]", "")
    study = run_study(read_config(config_file(tmp_path, text), {"out": str(tmp_path / "result")}), progress=False)
    content = json.loads(as_json(study))
    assert content["mean_stick_count"]["value"] == 0
    assert content["mean_stick_duration"] == {"value": None, "standard_error": None, "unit": "s", "samples": 40}
    (row,) = [line for line in table(study).splitlines() if line.startswith("mean stick duration")]
    assert "not defined" in row


def test_samples_that_did_not_finish_are_reported(study):
    counts = {ss.Status.FINISHED: 37, ss.Status.BASE_TOO_SHORT: 3, ss.Status.NOT_FINITE: 0}
    short = dataclasses.replace(study, ensemble=dataclasses.replace(study.ensemble, status_counts=counts))
    assert "All 40 samples reached t1." in table(study)
    assert "NOT FINISHED: 3 of 40 samples, because the base motion had too few intervals" in table(short)
    assert json.loads(as_json(short))["not_finished"] == {"BASE_TOO_SHORT": 3}


def test_precision_must_be_chosen_before_the_run(tmp_path):
    config = StudyConfig(run=RunConfig(dtype="float32"), output=OutputConfig(directory=str(tmp_path / "result")))
    with pytest.raises(StudyError, match="jax_enable_x64"):
        run_study(config)
    assert list(tmp_path.iterdir()) == []


def test_horizon_too_long_to_count_is_refused(tmp_path):
    config = read_config(None, {"t1": 1e300, "out": str(tmp_path / "result")})
    with pytest.raises(StudyError, match="t1"):
        run_study(config)
    assert list(tmp_path.iterdir()) == []


def test_outputs_by_name(tmp_path):
    """Numbers of each sample that the file names are those that the ensemble finds."""
    text = SMALL.replace("[run]", '[run]\noutputs = ["peak position", "stick"]')
    config = read_config(config_file(tmp_path, text), {"out": str(tmp_path / "result")})
    with pytest.raises(StudyError, match=r"begin with peak, maximum, minimum, residual"):
        run_study(config, progress=False)
    config = config.model_copy(update={"run": config.run.model_copy(update={"outputs": ["peak position"]})})
    found = run_study(config, progress=False)
    with xr.open_dataset(found.directory / DATA) as stored:
        values = stored["output_peak_position"]
        assert values.attrs["units"] == "m"
        np.testing.assert_array_equal(values, found.ensemble.output_values["peak_position"])
