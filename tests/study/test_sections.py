"""What the sections of a study's file say is what the simulation is given."""

import pickle

import jax
import numpy as np
import pytest
from support.study import HARMONIC, TIMES, TONES, VALUES, G, config_file, mass_spring, write_records

import stickslip_jax as ss
from stickslip_jax.study._config import MotorCartRunConfig, RunConfig, StudyConfig
from stickslip_jax.study._reading import EXAMPLES, read_config


@pytest.fixture(autouse=True)
def _records(tmp_path):
    write_records(tmp_path)


def same(one, other) -> bool:
    """Whether two systems or laws are of the same kind and hold the same numbers."""
    alike = jax.tree.structure(one) == jax.tree.structure(other)
    return alike and jax.tree.all(jax.tree.map(np.array_equal, one, other))


SYSTEMS = {
    "mu": ("[system]\nmu = 0.3", mass_spring(ss.Coulomb(0.3))),
    "Coulomb": ("[system.friction]\nmu = 0.3\nmu_static = 0.4", mass_spring(ss.Coulomb(0.3, 0.4))),
    "VelocityWeakening": (
        '[system.friction]\nlaw = "VelocityWeakening"\nmu_static = 0.4\nweakening = 2',
        mass_spring(ss.VelocityWeakening(0.4, 2.0)),
    ),
    "VelocityDependent": (
        '[system.friction]\nlaw = "VelocityDependent"\nmu_slow = 0.05\nmu_fast = 0.1\nrate = 20\nmu_static = 0.06',
        mass_spring(ss.VelocityDependent(0.05, 0.1, 20.0, 0.06)),
    ),
    "Stribeck": (
        '[system.friction]\nlaw = "Stribeck"\nmu = 0.3\nmu_static = 0.4\nstribeck_speed = 0.1\nexponent = 2.0\n'
        "viscous = 0.2",
        mass_spring(ss.Stribeck(0.3, 0.4, 0.1, 2.0, 0.2)),
    ),
    "Directional": (
        '[system.friction]\nlaw = "Directional"\n[system.friction.forward]\nmu = 0.3\n[system.friction.backward]\n'
        'law = "Ageing"\n[system.friction.backward.slip]\nlaw = "VelocityWeakening"\nmu_static = 0.4\nweakening = 2\n'
        '[system.friction.backward.growth]\nlaw = "ExponentialGrowth"\namount = 0.1\ntime = 2',
        mass_spring(
            ss.Directional(ss.Coulomb(0.3), ss.Ageing(ss.VelocityWeakening(0.4, 2.0), ss.ExponentialGrowth(0.1, 2.0)))
        ),
    ),
    "OneWay": (
        '[system.friction]\nlaw = "OneWay"\ncapacity = 200\n[system.friction.forward]\nlaw = "VelocityWeakening"\n'
        "mu_static = 0.4\nweakening = 2",
        mass_spring(ss.OneWay(ss.VelocityWeakening(0.4, 2.0), 200.0)),
    ),
    "Ageing": (
        '[system.friction]\nlaw = "Ageing"\n[system.friction.slip]\nmu = 0.3\nmu_static = 0.4\n'
        '[system.friction.growth]\nlaw = "LogarithmicGrowth"\namount = 0.1\ntime = 2',
        mass_spring(ss.Ageing(ss.Coulomb(0.3, 0.4), ss.LogarithmicGrowth(0.1, 2.0))),
    ),
    "FrictionByPlace": (
        '[system.friction]\nlaw = "FrictionByPlace"\nplaces = [0, 0.3]\nperiod = 1\n'
        "[[system.friction.laws]]\nmu = 0.3\n[[system.friction.laws]]\nmu = 0.4",
        mass_spring(ss.FrictionByPlace((0.0, 0.3), (ss.Coulomb(0.3), ss.Coulomb(0.4)), 1.0)),
    ),
    "LuGre": (
        '[system.friction]\nlaw = "LuGre"\nmu = 0.3\nmu_static = 0.4\nstribeck_speed = 0.1\nstiffness = 1e3\n'
        "damping = 2",
        mass_spring(ss.LuGre(0.3, 0.4, 0.1, 1e3, 2.0)),
    ),
    "ElastoPlastic": (
        '[system.friction]\nlaw = "ElastoPlastic"\nmu = 0.3\nmu_static = 0.4\nstribeck_speed = 0.1\nstiffness = 1e3\n'
        "breakaway = 0.5",
        mass_spring(ss.ElastoPlastic(0.3, 0.4, 0.1, 1e3, breakaway=0.5)),
    ),
    "Dahl": ('[system.friction]\nlaw = "Dahl"\nmu = 0.3\nstiffness = 1e3', mass_spring(ss.Dahl(0.3, 1e3))),
    "BoucWen": (
        '[system.friction]\nlaw = "BoucWen"\nmu = 0.3\nstiffness = 1e3\nexponent = 3\nsharing = 0.7',
        mass_spring(ss.BoucWen(0.3, 1e3, 3.0, 0.7)),
    ),
    "SlipWeakening": (
        '[system.friction]\nlaw = "SlipWeakening"\nstatic = 0.6\ndynamic = 0.4\ndistance = 0.02\nhealing = 1.5\n',
        mass_spring(ss.SlipWeakening(0.6, 0.4, 0.02, 1.5)),
    ),
    "DieterichRuina": (
        '[system.friction]\nlaw = "DieterichRuina"\nmu = 0.6\ndirect = 0.01\nevolution = 0.02\nlength = 1e-5\n'
        'reference_speed = 1e-6\nform = "slip"\nsecond_evolution = -0.005\nsecond_length = 1e-4',
        mass_spring(
            ss.DieterichRuina(0.6, 0.01, 0.02, 1e-5, 1e-6, "slip", second_evolution=-0.005, second_length=1e-4)
        ),
    ),
    "damping": ("[system]\ndamping = 0.1", mass_spring(damping=0.1)),
    "no damping": ("[system]\ndamping = 0", mass_spring()),
    "Harmonic force": (
        f"[system.force]\n{HARMONIC}phase = 0.1\noffset = 0.2",
        mass_spring(force=ss.Harmonic(0.5, 1.5, 0.1, 0.2)),
    ),
    "constant force": ("[system]\nforce = -0.5", mass_spring(force=-0.5)),
    "force that jumps": (
        '[system.force]\nlaw = "ForceSteps"\ntimes = [0, 1]\nvalues = [1, -1]',
        mass_spring(force=ss.ForceSteps([0.0, 1.0], [1.0, -1.0])),
    ),
    "SumOfHarmonics force": (
        '[system.force]\nlaw = "SumOfHarmonics"\namplitudes = [0.5, 0.2]\nangular_frequencies = [1.5, 4]\n'
        "phases = [1, 2]",
        mass_spring(force=ss.SumOfHarmonics(*TONES, [1.0, 2.0])),
    ),
    "Recorded force": (
        '[system.force]\nlaw = "Recorded"\nfile = "record.csv"\nvalue_column = "value"\nscale = 2.0',
        mass_spring(force=ss.Recorded(TIMES, 2 * VALUES)),
    ),
    "MotorCart": ('[system]\nmodel = "MotorCart"', ss.MotorCart()),
    "MotorCart on places": (
        '[system]\nmodel = "MotorCart"\n[system.friction]\nlaw = "FrictionByPlace"\nplaces = [0]\non = "ground"\n'
        "[[system.friction.laws]]\nmu = 0.3\n[[system.friction.laws]]\nmu = 0.4",
        ss.MotorCart(friction=ss.FrictionByPlace((0.0,), (ss.Coulomb(0.3), ss.Coulomb(0.4)), on="ground")),
    ),
    "other MotorCart": (
        '[system]\nmodel = "MotorCart"\nmu = 0.5\ninductance = 1e-4\nequation = "printed"',
        ss.MotorCart(mu=0.5, inductance=1e-4, equation="printed"),
    ),
}


@pytest.mark.parametrize("case", SYSTEMS)
def test_system(tmp_path, case):
    text, expected = SYSTEMS[case]
    config = read_config(config_file(tmp_path, text))
    assert same(config.system.build(), expected)
    assert read_config(config_file(tmp_path, config.to_toml())) == config
    assert pickle.loads(pickle.dumps(config)) == config


BASES = {
    "Harmonic": (HARMONIC, ss.RandomPhase(ss.Harmonic(0.5, 1.5))),
    "Harmonic of no random phase": (HARMONIC + "random_phase = false\noffset = 1", ss.Harmonic(0.5, 1.5, offset=1.0)),
    "Harmonic of given phase": (HARMONIC + "phase = 0.3", ss.Harmonic(0.5, 1.5, 0.3)),
    "SumOfHarmonics": (
        'law = "SumOfHarmonics"\namplitudes = [0.5, 0.2]\nangular_frequencies = [1.5, 4.0]',
        ss.RandomPhase(ss.SumOfHarmonics(*TONES)),
    ),
    "SumOfHarmonics of given phases": (
        'law = "SumOfHarmonics"\namplitudes = [0.5, 0.2]\nangular_frequencies = [1.5, 4.0]\nphases = [1, 2]',
        ss.SumOfHarmonics(*TONES, [1.0, 2.0]),
    ),
    "Recorded": ('law = "Recorded"\ntimes = [0, 1, 3]\nvalues = [1, -1, 2]', ss.Recorded([0, 1, 3], [1, -1, 2])),
    "Recorded in a file": ('law = "Recorded"\nfile = "record.csv"', ss.Recorded(TIMES, 2 * VALUES)),
    "Recorded, columns by white space": (
        'law = "Recorded"\nfile = "late.txt"\ndelimiter = "whitespace"\nshift = true',
        ss.Recorded(TIMES, VALUES),
    ),
    "GroundAcceleration": ('law = "GroundAcceleration"\nfile = "record.AT2"', ss.GroundAcceleration(TIMES, G * VALUES)),
    "scaled GroundAcceleration": (
        'law = "GroundAcceleration"\nfile = "record.AT2"\nscale = -2.0',
        ss.GroundAcceleration(TIMES, -2 * (G * VALUES)),
    ),
    "GroundAcceleration in a table": (
        'law = "GroundAcceleration"\nfile = "record.csv"\ntime_column = "time"\nvalue_column = 2\nscale = 9.80665',
        ss.GroundAcceleration(TIMES, G * VALUES),
    ),
    "SemiMarkovSwitching": (
        'law = "SemiMarkovSwitching"\nspeed = 2.0\nfirst_sign = "positive"\n'
        '[base.gap]\nlaw = "Weibull"\nscale = 2\nshape = 1.5',
        ss.SemiMarkovSwitching(ss.Weibull(2.0, 1.5), 2.0, first_sign="positive"),
    ),
    "SemiMarkovSwitching of random speeds": (
        'law = "SemiMarkovSwitching"\nalternating = false\n[base.gap]\nlaw = "Exponential"\nmean = 2\n'
        '[base.speeds]\nlaw = "Discrete"\nvalues = [-1, 0, 2]\nprobabilities = [0.2, 0.5, 0.3]',
        ss.SemiMarkovSwitching(ss.Exponential(2.0), ss.Discrete([-1.0, 0.0, 2.0], [0.2, 0.5, 0.3]), alternating=False),
    ),
    "GaussianProcess": (
        'law = "GaussianProcess"\ncutoff = 30.0\nrms = 0.4\nharmonics = 64\n[base.spectrum]\n'
        'law = "VelocitySpectrum"\n[base.spectrum.acceleration]\nlaw = "CloughPenzienSpectrum"\nfilter_damping = 0.5',
        ss.GaussianProcess(
            ss.VelocitySpectrum(ss.CloughPenzienSpectrum(filter_damping=0.5)), 30.0, rms=0.4, harmonics=64
        ),
    ),
    "GaussianProcess of a table, with jumps": (
        'law = "WithJumps"\n[base.motion]\nlaw = "GaussianProcess"\ncutoff = 4.0\nmean = 0.1\n'
        '[base.motion.spectrum]\nlaw = "TabulatedSpectrum"\nangular_frequencies = [0.5, 1, 4]\n'
        "densities = [0, 1, 0]\n[base.jumps]\nrate = 2.0",
        ss.WithJumps(
            ss.GaussianProcess(ss.TabulatedSpectrum([0.5, 1.0, 4.0], [0.0, 1.0, 0.0]), 4.0, mean=0.1),
            ss.PoissonSwitching(1.0, 2.0),
        ),
    ),
    "KanaiTajimi": ('law = "KanaiTajimi"\nrms = 2.0\nrise = 1', ss.KanaiTajimi(2.0, rise=1.0)),
    "WithJumps": (
        f'law = "WithJumps"\n[base.motion]\n{HARMONIC}[base.jumps]\nrate = 2.0',
        ss.WithJumps(ss.RandomPhase(ss.Harmonic(0.5, 1.5)), ss.PoissonSwitching(1.0, 2.0)),
    ),
    "WithJumps on a record": (
        'law = "WithJumps"\n[base.motion]\nlaw = "Recorded"\nfile = "record.csv"\n'
        '[base.jumps]\nlaw = "SquareWave"\nspeed = 1\nperiod = 2',
        ss.WithJumps(ss.Recorded(TIMES, 2 * VALUES), ss.SquareWave(1.0, 2.0)),
    ),
}
VOLTAGES = {
    "usual": ("", ss.RandomPhase(ss.SourceVoltage())),
    "other": ("[base]\nmean = 2.0\namplitude = 0.4", ss.RandomPhase(ss.SourceVoltage(2.0, 0.4))),
    "given phase": ('[base]\nlaw = "SourceVoltage"\nphase = 1.0', ss.SourceVoltage(phase=1.0)),
}


@pytest.mark.parametrize("case", BASES)
def test_base(tmp_path, case):
    text, expected = BASES[case]
    config = read_config(config_file(tmp_path, f"[base]\n{text}"))
    assert same(config.base.build(), expected)
    assert read_config(config_file(tmp_path, config.to_toml())) == config
    assert pickle.loads(pickle.dumps(config)) == config


@pytest.mark.parametrize("case", VOLTAGES)
def test_voltage(tmp_path, case):
    text, expected = VOLTAGES[case]
    config = read_config(config_file(tmp_path, f'[system]\nmodel = "MotorCart"\n{text}'))
    assert same(config.base.build(), expected)
    assert read_config(config_file(tmp_path, config.to_toml())) == config


def test_usual_motor_cart_is_the_papers(tmp_path):
    config = read_config(config_file(tmp_path, '[system]\nmodel = "MotorCart"'))
    paper = ss.papers.motor_cart()
    assert same((config.system.build(), config.base.build(), config.run.y0()), (paper.system, paper.law, paper.y0))
    assert config.run.t1 == paper.t1


def test_initial_states_and_method(tmp_path):
    text = "[run]\ninitial_position = { low = -1, high = 1 }\ninitial_velocity = 0.5\nstep = 0.01\nmax_steps = 900\n"
    config = read_config(config_file(tmp_path, text + 'solver = "Tsit5"'))
    assert same(config.run.y0(), (ss.Uniform(-1.0, 1.0), 0.5))
    method = config.run.method()
    assert (method.step, method.max_steps, type(method.solver).__name__) == (0.01, 900, "Tsit5")
    assert read_config(config_file(tmp_path, config.to_toml())) == config
    text = "[run]\ninitial_angle = 0.7\ninitial_current = { low = 0, high = 2 }\nstep = 1e-4"
    config = read_config(config_file(tmp_path, f'[system]\nmodel = "MotorCart"\n{text}'))
    assert same(config.run.y0(), (0.7, 0.0, ss.Uniform(0.0, 2.0)))
    assert same(config.run.method(), ss.Exact(1e-4))
    config = read_config(config_file(tmp_path, '[run]\nwidth = 1e-3\nshape = "linear"\nstep = 0.01'))
    assert same(config.run.method(), ss.Regularized(1e-3, "linear", step=0.01))
    assert read_config(config_file(tmp_path, config.to_toml())) == config


def test_run_without_a_start_takes_that_of_the_system():
    cart = StudyConfig.model_validate({"system": {"model": "MotorCart"}, "run": RunConfig(samples=3)})
    assert cart.run == MotorCartRunConfig(samples=3)
    assert StudyConfig(run=RunConfig(samples=3)).run.y0() == (0.0, 1.0)


@pytest.mark.parametrize("name", EXAMPLES)
def test_example_is_a_file_to_start_from(tmp_path, name):
    config = read_config(None, {"samples": 5}, example=name)
    assert config.run.samples == 5
    assert name in config.output.directory
    assert read_config(config_file(tmp_path, config.to_toml())) == config
