"""Studies of every system and base: what the file says is what is simulated, and what is stored is what came out."""

import dataclasses
import json
import math
import os

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from support.study import HARMONIC, TIMES, TONES, VALUES, G, config_file, mass_spring, write_records

import stickslip_jax as ss
from stickslip_jax import _cli as cli
from stickslip_jax.study import StudyError
from stickslip_jax.study._reading import read_config, read_sweep_config
from stickslip_jax.study._run import (
    CONFIG,
    DATA,
    RESULT_FILES,
    STATISTICS,
    SUMMARY,
    as_json,
    beginning_of_sample_0,
    run_study,
    sweep_of,
    table,
)


@pytest.fixture(autouse=True)
def _records(tmp_path):
    write_records(tmp_path)


# --- what comes out


RUN = "[run]\nt1 = 10.0\nsamples = 20\nchunk = 64\nthreads = 1\ninitial_velocity = 0.0\n"
ONE_WAY = (
    '[system.friction]\nlaw = "Directional"\n[system.friction.forward]\nmu = 0.3\n[system.friction.backward]\n'
    'law = "Ageing"\n[system.friction.backward.slip]\nmu = 0.4\n[system.friction.backward.growth]\n'
    'law = "LogarithmicGrowth"\namount = 0.1\ntime = 0.01\n'
)
STUDIES = {
    "random start": (
        f'[system.force]\n{HARMONIC}[base]\nlaw = "SumOfHarmonics"\namplitudes = [0.5, 0.2]\n'
        f"angular_frequencies = [1.5, 4]\nrandom_phase = false\n{RUN}step = 0.05\n"
        "initial_position = { low = -0.5, high = 0.5 }\n",
        mass_spring(force=ss.Harmonic(0.5, 1.5)),
        ss.SumOfHarmonics(*TONES),
        {"y0": (ss.Uniform(-0.5, 0.5), 0.0), "method": ss.Exact(step=0.05)},
    ),
    "records": (
        '[system.force]\nlaw = "Recorded"\nfile = "record.csv"\n[base]\nlaw = "Recorded"\nfile = "record.csv"\n'
        f'value_column = "value"\n{RUN}initial_position = {{ low = -0.5, high = 0.5 }}\n',
        mass_spring(force=ss.Recorded(TIMES, 2 * VALUES)),
        ss.Recorded(TIMES, VALUES),
        {"y0": (ss.Uniform(-0.5, 0.5), 0.0)},
    ),
    "friction law": (
        f'[system.friction]\nlaw = "VelocityWeakening"\nmu_static = 0.5\nweakening = 0.3\n[base]\n{HARMONIC}{RUN}',
        mass_spring(ss.VelocityWeakening(0.5, 0.3)),
        ss.RandomPhase(ss.Harmonic(0.5, 1.5)),
        {},
    ),
    "ageing in one direction": (
        f"{ONE_WAY}[base]\n{HARMONIC}{RUN}",
        mass_spring(ss.Directional(ss.Coulomb(0.3), ss.Ageing(ss.Coulomb(0.4), ss.LogarithmicGrowth(0.1, 0.01)))),
        ss.RandomPhase(ss.Harmonic(0.5, 1.5)),
        {},
    ),
    "bristles": (
        f'[system.friction]\nlaw = "LuGre"\nmu = 0.5\nmu_static = 0.7\nstribeck_speed = 0.05\nstiffness = 1e3\n'
        f"damping = 10\n[base]\n{HARMONIC}{RUN}",
        mass_spring(ss.LuGre(0.5, 0.7, 0.05, 1e3, 10.0)),
        ss.RandomPhase(ss.Harmonic(0.5, 1.5)),
        {"method": ss.Regularized()},
    ),
    "regularised": (
        f'[base]\nlaw = "PoissonSwitching"\n{RUN}width = 1e-3\nshape = "linear"\nstep = 0.01\n',
        mass_spring(),
        ss.PoissonSwitching(1.0, 1.0),
        {"method": ss.Regularized(1e-3, "linear", step=0.01)},
    ),
    "jumps": (
        f'[system]\ndamping = 0.1\n[base]\nlaw = "WithJumps"\n[base.motion]\n{HARMONIC}[base.jumps]\nspeed = 0.5\n'
        f"{RUN}",
        mass_spring(damping=0.1),
        ss.WithJumps(ss.RandomPhase(ss.Harmonic(0.5, 1.5)), ss.PoissonSwitching(0.5, 1.0)),
        {},
    ),
    "accelerogram": (
        f'[system.friction]\nmu = 0.4\nmu_static = 0.5\n[base]\nlaw = "GroundAcceleration"\nfile = "record.AT2"\n{RUN}'
        "initial_position = { low = -0.5, high = 0.5 }\n",
        mass_spring(ss.Coulomb(0.4, 0.5)),
        ss.GroundAcceleration(TIMES, G * VALUES),
        {"y0": (ss.Uniform(-0.5, 0.5), 0.0)},
    ),
    "artificial accelerogram": (
        f'[base]\nlaw = "KanaiTajimi"\nrms = 2.0\nrise = 1.0\n{RUN}',
        mass_spring(),
        ss.KanaiTajimi(2.0, rise=1.0),
        {},
    ),
}


def run(folder, text, *, figures=False, **options):
    """The study that `text` describes, run; its configuration in `folder`, its result in ``result``."""
    options = {"out": str(folder / "result"), "figures": figures} | options
    return run_study(read_config(config_file(folder, text), options), progress=False)


def check_against(study, many):
    """`study` holds, and stored, what the ensemble `many` holds."""
    sticks = many.require_sticks()
    assert len(sticks.start) > 10
    with xr.open_dataset(study.directory / DATA) as dataset:
        for name in ("start", "end", "position", "ending"):
            np.testing.assert_array_equal(dataset[f"stick_{name}"], getattr(sticks, name))
        np.testing.assert_array_equal(dataset["stick_count"], sticks.count)
        np.testing.assert_array_equal(dataset["near_grazing_count"], many.totals.near_grazing_count)
        for name, estimate in STATISTICS.items():
            assert float(dataset[name]) == estimate(many).value == study.statistics[name].value
        for variable in dataset.variables.values():
            assert variable.attrs["units"]
            assert variable.attrs["long_name"]
        assert dataset.attrs["samples_finished"] == many.samples
        assert dataset.attrs["samples_near_grazing"] == many.near_grazing_samples
        assert read_config(config_file(study.directory, dataset.attrs["configuration"])) == study.config
    assert read_config(study.directory / CONFIG) == study.config


# Compiling each takes seconds; `test_sections.py` reads every kind of section.
SLOWER = ("records", "random start", "jumps", "friction law", "artificial accelerogram", "regularised", "bristles")


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=pytest.mark.slow) if case in SLOWER else case for case in STUDIES],
)
def test_study_is_the_ensemble(tmp_path, case):
    text, system, law, more = STUDIES[case]
    arguments = {
        "t1": 10.0,
        "samples": 20,
        "key": jax.random.key(0),
        "keep": "sticks",
        "chunk": 64,
        "threads": 1,
    } | more
    check_against(run(tmp_path, text), ss.simulate_ensemble(system, law, **arguments, progress=False))


def check_sample_0(study):
    """What the figures show is the beginning of sample 0; returns how long a time they show."""
    one = beginning_of_sample_0(study.config, study.ensemble)
    whole = np.asarray(one.sticks.mask) & (np.asarray(one.sticks.ending) != ss.Ending.HORIZON)
    assert whole.any()
    starts = study.ensemble.sticks.start[0, : whole.sum()]
    np.testing.assert_allclose(np.asarray(one.sticks.start)[whole], starts, rtol=0, atol=1e-9)
    return float(one.t1)


@pytest.mark.slow
def test_figures_show_as_much_as_they_can_hold(tmp_path, monkeypatch):
    monkeypatch.setattr("stickslip_jax.study._run._PERIODS_SHOWN", 2)
    assert check_sample_0(run(tmp_path, STUDIES["artificial accelerogram"][0])) == pytest.approx(2 * math.pi)


CART = '[system]\nmodel = "MotorCart"\nmu = 0.25\n[run]\nt1 = 1.0\nsamples = 40\nchunk = 64\nthreads = 1\n'


@pytest.mark.slow
def test_motor_cart(tmp_path):
    study = run(tmp_path, CART)
    paper = ss.papers.motor_cart(mu=0.25, t1=1.0)
    many = ss.simulate_ensemble(
        paper.system,
        paper.law,
        t1=1.0,
        samples=40,
        key=jax.random.key(0),
        y0=paper.y0,
        keep="sticks",
        chunk=64,
        threads=1,
    )
    check_against(study, many)
    first = ss.first_stick(many)
    assert 0 < first.count < 40
    with xr.open_dataset(study.directory / DATA) as dataset:
        for name, expected in {
            "start": "start",
            "duration": "duration",
            "angle": "position",
            "ending": "ending",
        }.items():
            np.testing.assert_array_equal(dataset[f"first_stick_{name}"], getattr(first, expected))
        expected = {"long_name": "motor angle during the stick", "units": "rad", "period": 2 * math.pi}
        assert dataset["stick_position"].attrs == expected
        assert dataset["first_stick_angle"].attrs["units"] == "rad"
        expected = {"run_initial_angle_low": 0.0, "run_initial_angle_high": 2 * math.pi, "base_random_phase": 1}
        assert {name: dataset.attrs[name] for name in expected} == expected
    assert "40 samples of MotorCart, SourceVoltage of random phase, on [0, 1] s" in table(study)
    assert f"A first stick was found in {first.count} of 40 samples, rest at t = 0 not counted." in table(study)
    assert json.loads(as_json(study))["first_sticks"] == first.count


@pytest.mark.slow
def test_figures_of_a_motor_cart(tmp_path):
    study = run(tmp_path, CART, figures=True)
    plt.close("all")
    assert check_sample_0(study) == 1.0
    assert set(study.files) <= set(RESULT_FILES)
    for name in ("time_history.png", "phase_portrait.png", "stick_durations.png"):
        assert (study.directory / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_initial_rest_is_counted_if_asked_for(tmp_path):
    study = run(tmp_path, CART + "count_initial_rest = true\n")
    assert "A first stick was found in 40 of 40 samples." in table(study)
    with xr.open_dataset(study.directory / DATA) as dataset:
        assert np.all(dataset["first_stick_start"] == 0)


@pytest.mark.slow
def test_motor_cart_by_statistics_alone(tmp_path, monkeypatch):
    whole = run(tmp_path, CART).ensemble
    bare = dataclasses.replace(whole, flat_sticks=None, sample_totals=None)
    monkeypatch.setattr("stickslip_jax.study._run.simulate", lambda *_: bare)
    study = run(tmp_path, CART + 'keep = "statistics"\n', out=str(tmp_path / "bare"))
    assert study.first_sticks is None
    assert "first stick" not in table(study)
    back = ss.load(study.directory)
    assert back.keep == "statistics"
    assert repr(back.summary()) == repr(whole.summary()) == (study.directory / SUMMARY).read_text().rstrip("\n")


@pytest.mark.slow
def test_samples_out_of_steps_are_reported(tmp_path):
    study = run(tmp_path, CART + "max_steps = 20\n", figures=True)
    plt.close("all")
    assert "NOT FINISHED: 40 of 40 samples, because all time steps allowed were used before t1" in table(study)
    assert json.loads(as_json(study))["not_finished"] == {"OUT_OF_STEPS": 40}
    with xr.open_dataset(study.directory / DATA) as dataset:
        assert dataset.attrs["samples_out_of_steps"] == 40


@pytest.mark.slow
def test_what_to_know_of_the_samples_is_reported(tmp_path):
    study = run(tmp_path, CART)
    changed = dataclasses.replace(
        study, ensemble=dataclasses.replace(study.ensemble, near_grazing_samples=3, key_data=None)
    )
    assert "Near-grazing: 3 of 40 samples" in table(changed)
    assert json.loads(as_json(changed))["near_grazing_samples"] == 3
    assert "Nothing is random here: all 40 samples are the same." in table(changed)
    assert "near-grazing" not in table(study).lower()
    assert "Nothing is random" not in table(study)


# --- what is refused


REFUSED = {
    "record too short": (
        '[base]\nlaw = "Recorded"\ntimes = [0, 1]\nvalues = [0, 1]',
        ["[base] must last until t1 = 200 s", "ends at 1 s"],
    ),
    "force too short": (
        '[system.force]\nlaw = "Recorded"\nfile = "record.csv"',
        ["[system.force] must last until t1 = 200 s", "ends at 12 s"],
    ),
    "step too long": (
        f"[base]\n{HARMONIC}[run]\nstep = 1.0",
        ["step in [run] must be at most", "natural period", "1.0"],
    ),
    "cart's step too long": ('[system]\nmodel = "MotorCart"\n[run]\nstep = 0.1', ["step in [run]", "time constant"]),
    "resonance": (
        '[system.force]\nlaw = "Harmonic"\namplitude = 1.0\nangular_frequency = 2.0',
        ["[system.force] must not have the natural angular frequency", 'solver = "Dopri8" in [run]'],
    ),
    "solver of smoothed friction": (
        '[run]\nwidth = 1e-3\nsolver = "Tsit5"',
        ["solver in [run] must be left out with a width", "Tsit5 was given"],
    ),
    "no such column": (
        '[base]\nlaw = "Recorded"\nfile = "record.csv"\nvalue_column = "velocity"',
        ["in [base], value_column must be", "'velocity'"],
    ),
    "record that begins late": (
        '[base]\nlaw = "Recorded"\nfile = "late.txt"\ndelimiter = "whitespace"',
        ["in [base], file must name a file with times that begin with 0", "1.0 s"],
    ),
    "no accelerogram": (
        '[base]\nlaw = "GroundAcceleration"\nfile = "velocity.AT2"',
        ["in [base], file must name a file with an acceleration in units of g", "velocity.AT2"],
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_before_anything_is_simulated(tmp_path, case):
    text, expected = REFUSED[case]
    with pytest.raises(StudyError) as caught:
        run(tmp_path, text)
    message = str(caught.value)
    for part in expected:
        assert part in message
    assert "\n" not in message
    assert "Argument" not in message
    assert not (tmp_path / "result").exists()


def test_record_that_vanished_is_refused(tmp_path):
    config = read_config(config_file(tmp_path, '[base]\nlaw = "Recorded"\nfile = "record.csv"'))
    (tmp_path / "record.csv").unlink()
    with pytest.raises(StudyError, match=r"in \[base\], file must be the name of a file that exists"):
        run_study(
            config.model_copy(update={"output": config.output.model_copy(update={"directory": str(tmp_path / "r")})})
        )
    assert not (tmp_path / "r").exists()


def test_long_name_of_a_missing_record_is_shown_whole(tmp_path):
    name = "long" * 40 + "/record.csv"
    with pytest.raises(StudyError) as caught:
        read_config(config_file(tmp_path, f'[base]\nlaw = "Recorded"\nfile = "{name}"'))
    assert f'file must be the name of a file that exists, but "{name}" was given' in str(caught.value)


@pytest.mark.slow
def test_command_finds_records_beside_the_configuration(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("stickslip_jax.study._commands.prepare_jax", lambda dtype: None)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    text, *_ = STUDIES["accelerogram"]
    assert cli.main(["study", str(config_file(tmp_path, text)), "--no-figures", "--json", "--quiet"]) == 0
    assert json.loads(capsys.readouterr().out)["samples"] == 20
    assert os.listdir() == ["results"]
    assert cli.main(["study", "../case.toml", "--print-config"]) == 0
    assert f'file = "{tmp_path}/elsewhere/../record.AT2"' in capsys.readouterr().out


@pytest.mark.slow
def test_sweep_over_the_numbers_of_a_law_made_of_others(tmp_path):
    """Names are those of the sections; a start may leave out the ages of sticks."""
    text = (
        f"{ONE_WAY}[run]\nt1 = 20.0\nsamples = 10\n[sweep]\nkeep = \"totals\"\nstatistics = [\"stick_fraction\"]\n"
        '[sweep.over]\n"friction.forward.mu" = [0.3, 0.5]\n"friction.backward.slip.mu" = [0.2]\namount = [0.2]\n'
    )  # fmt: skip
    config = read_sweep_config(config_file(tmp_path, text))
    result = sweep_of(config).run(tmp_path / "sweep", threads=1, progress=False)
    law = ss.Directional(ss.Coulomb(0.5), ss.Ageing(ss.Coulomb(0.2), ss.LogarithmicGrowth(0.2, 0.01)))
    many = ss.simulate_ensemble(
        mass_spring(law), ss.PoissonSwitching(1.0, 1.0), t1=20.0, samples=10, key=jax.random.key(0), y0=(0.0, 1.0),
        keep="totals", threads=1, progress=False,
    )  # fmt: skip
    found = float(result.stick_fraction[1, 0, 0])
    assert found == pytest.approx(ss.stick_fraction(many).value, rel=1e-12)
    assert found != float(result.stick_fraction[0, 0, 0])
    wrong = read_sweep_config(config_file(tmp_path, text.replace("backward.slip.mu", "backward.slip.muu")))
    with pytest.raises(StudyError, match=r"did you mean 'system.friction.backward.slip.mu'\?"):
        sweep_of(wrong)
