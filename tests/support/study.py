"""What the tests of studies and of the command share."""

from pathlib import Path

import numpy as np

import stickslip_jax as ss

SMALL = """
[run]
t1 = 20.0
samples = 40
chunk = 64

[output]
figures = false
"""
"""A study that takes a moment."""


def config_file(folder: Path, text: str = SMALL) -> Path:
    """`text` as a TOML file in `folder`."""
    path = folder / "case.toml"
    path.write_text(text, encoding="utf-8")
    return path


# Each case: a configuration, and what the message about it must contain.
BAD_CONFIGS = {
    "unknown key": ("[system]\nmas = 1.0", ["mas ", "[system]", "did you mean mass?"]),
    "unknown key of a law": ('[base]\nlaw = "SquareWave"\nspeed = 1.0\nperoid = 2.0', ["peroid", "mean period?"]),
    "key of another law": ("[base]\ninterval = 2.0", ["interval", "[base]", "law PoissonSwitching", "RandomSteps"]),
    "key of another section": ("[system]\nt1 = 3.0", ["t1", "[system]", "t1 belongs in [run]"]),
    "key like no other": ("[run]\nzzzz = 3.0", ["zzzz", "[run]", "its keys are t1, samples"]),
    "key called like a law": ("[run]\nConstant = 1", ["Constant", "[run]", "its keys are t1"]),
    "key of two words": ('"a b" = 1', ["a b", "outside every section"]),
    "table for a number": ("[system.mass]\nkg = 1", ["mass in [system]", "a number"]),
    "unknown section": ("[sistem]\nmass = 1.0", ["[sistem]", "did you mean system?"]),
    "section like no other": ("[zzzz]", ["[zzzz]", "system, base, run, output"]),
    "key outside sections": ("mass = 1.0", ["mass", "outside every section", "[system]"]),
    "section that is none": ("system = 3", ["system must be a section", "3"]),
    "base that is none": ("base = 3", ["base must be a section", "3"]),
    "unknown law": (
        '[base]\nlaw = "PoisonSwitching"',
        ["law in [base]", '"PoisonSwitching"', "mean PoissonSwitching?"],
    ),
    "law in lower case": ('[base]\nlaw = "squarewave"', ["did you mean SquareWave?"]),
    "law that is none": ("[base]\nlaw = 3", ["law in [base]", "RandomSteps", "3"]),
    "unknown system": ('[system]\nmodel = "MotorCrat"', ["model in [system]", '"MotorCrat"', "mean MotorCart?"]),
    "missing key": ('[base]\nlaw = "RandomSteps"\nspeed = 1.0', ["[base] lacks interval", "RandomSteps"]),
    "text for a number": ('[system]\nmass = "1"', ["mass in [system]", "a number", '"1"']),
    "true for a number": ("[system]\nmass = true", ["mass in [system]", "a number", "true"]),
    "negative mass": ("[system]\nmass = -1.0", ["mass in [system]", "greater than 0", "-1.0"]),
    "negative stiffness": ("[system]\nstiffness = -1", ["stiffness in [system]", "greater than or equal to 0"]),
    "zero normal force": ("[system]\nnormal_force = 0.0", ["normal_force in [system]", "greater than 0"]),
    "negative mu": ("[system]\nmu = -0.1", ["mu in [system]", "greater than or equal to 0"]),
    "mass nan": ("[system]\nmass = nan", ["mass in [system]", "finite", "nan"]),
    "mass infinite": ("[system]\nmass = inf", ["mass in [system]", "finite", "inf"]),
    "mass beyond float64": ("[system]\nmass = 1e999", ["mass in [system]", "finite"]),
    "zero rate": ("[base]\nrate = 0", ["rate in [base]", "greater than 0"]),
    "negative speed": ("[base]\nspeed = -2.0", ["speed in [base]", "greater than 0", "-2.0"]),
    "wrong first sign": ('[base]\nfirst_sign = "up"', ["first_sign in [base]", "'random'", '"up"']),
    "zero t1": ("[run]\nt1 = 0.0", ["t1 in [run]", "greater than 0"]),
    "position nan": ("[run]\ninitial_position = nan", ["initial_position in [run]", "finite"]),
    "half a sample": ("[run]\nsamples = 2.5", ["samples in [run]", "whole number", "2.5"]),
    "no sample": ("[run]\nsamples = 0", ["samples in [run]", "greater than or equal to 1"]),
    "too many samples": ("[run]\nsamples = 3_000_000_000", ["samples in [run]", "less than or equal to 2147483648"]),
    "negative seed": ("[run]\nseed = -1", ["seed in [run]", "greater than or equal to 0"]),
    "unknown dtype": ('[run]\ndtype = "float16"', ["dtype in [run]", "'float64'", '"float16"']),
    "no directory": ('[output]\ndirectory = ""', ["directory in [output]", "not be empty"]),
    "figures neither nor": ("[output]\nfigures = 1", ["figures in [output]", "true or false", "1"]),
    "levels not numbers": (
        '[base]\nlaw = "RandomSteps"\nspeed = 1\ninterval = 1\nlevels = [1, "2"]',
        ["levels[1] in [base]", '"2"'],
    ),
    "levels that repeat": (
        '[base]\nlaw = "RandomSteps"\nspeed = 1\ninterval = 1\nlevels = [1, 1]',
        ["in [base]", "levels must hold two or more different numbers"],
    ),
    "odds beyond one": (
        '[base]\nlaw = "RandomSteps"\nspeed = 1\ninterval = 1\nprobabilities = [0.5, 0.6]',
        ["in [base]", "probabilities", "summing to 1"],
    ),
    "times that fall": (
        '[base]\nlaw = "PiecewiseConstant"\ntimes = [0, 2, 1]\nvelocities = [1, 2, 3]',
        ["in [base]", "times must increase", "1.0 follows 2.0"],
    ),
    "times from one": (
        '[base]\nlaw = "PiecewiseConstant"\ntimes = [1, 2]\nvelocities = [1, 2]',
        ["in [base]", "times must begin with 0"],
    ),
    "lengths that differ": (
        '[base]\nlaw = "PiecewiseConstant"\ntimes = [0, 2]\nvelocities = [1]',
        ["in [base]", "same length", "(2,) and (1,)"],
    ),
    "no TOML": ("[system\nmass = 1", ["not valid TOML", "line 1"]),
}


HARMONIC = 'law = "Harmonic"\namplitude = 0.5\nangular_frequency = 1.5\n'
_CART, _JUMPS = '[system]\nmodel = "MotorCart"\n', '[base]\nlaw = "WithJumps"\n[base.jumps]\n'
_STRIBECK = '[system.friction]\nlaw = "Stribeck"\nmu = 0.3\n'
_AGEING = '[system.friction]\nlaw = "Ageing"\n[system.friction.slip]\nmu = 0.3\n'
_RECORDED = '[base]\nlaw = "Recorded"\n'
BAD_SYSTEMS_AND_BASES = {
    "key of the other system": (_CART + "mass = 3.0", ["mass", "[system] of the model MotorCart", "model MassSpring"]),
    "start of a cart for a mass": (
        "[run]\ninitial_angle = 1.0",
        ["initial_angle in [run] of the model MassSpring", "belongs in [run] of the model MotorCart"],
    ),
    "start of a mass for a cart": (
        _CART + "[run]\ninitial_position = 1.0",
        ["initial_position in [run] of the model MotorCart", "belongs in [run] of the model MassSpring"],
    ),
    "solver for a cart": (_CART + '[run]\nsolver = "Tsit5"', ["solver in [run]", "of the model MassSpring"]),
    "voltage for a mass": (
        '[base]\nlaw = "SourceVoltage"',
        ["law in [base] must be a motion of the base", "MassSpring", '"SourceVoltage"', "drives a MotorCart"],
    ),
    "motion for a cart": (
        _CART + '[base]\nlaw = "PoissonSwitching"',
        ['law in [base] must be "SourceVoltage"', "MotorCart", '"PoissonSwitching"'],
    ),
    "another equation": (_CART + 'equation = "right"', ["equation in [system]", "'physical' or 'printed'"]),
    "model that is none": ("[system]\nmodel = 3", ["model in [system]", "MassSpring, MotorCart", "3"]),
    "range as a list": ("[run]\ninitial_position = [0, 1]", ["initial_position in [run]", "{ low = ..., high = ... }"]),
    "range that falls": (
        "[run]\ninitial_position = { low = 1, high = 0 }",
        ["in [run.initial_position]", "high must be above low = 1.0", "0.0"],
    ),
    "half a range": ("[run]\ninitial_position = { low = 1 }", ["[run.initial_position] lacks high"]),
    "range misspelt": ("[run]\ninitial_position = { low = 1, hihg = 2 }", ["hihg", "did you mean high?"]),
    "range of texts": ('[run]\ninitial_position = { low = "1", high = 2 }', ["low in [run.initial_position]", '"1"']),
    "friction twice": ("[system]\nmu = 0.3\n" + _STRIBECK, ["in [system], mu and [system.friction]"]),
    "unknown friction": ('[system.friction]\nlaw = "Stribek"', ["law in [system.friction]", "did you mean Stribeck?"]),
    "unknown key of a friction": (
        _STRIBECK + "mu_static = 0.4\nstribek_speed = 1.0",
        ["stribek_speed in [system.friction] of the law Stribeck", "did you mean stribeck_speed?"],
    ),
    "friction that lacks a key": (_STRIBECK, ["[system.friction] lacks mu_static", "which Stribeck needs"]),
    "static below kinetic": (
        "[system.friction]\nmu = 0.3\nmu_static = 0.2",
        ["in [system.friction]", "mu_static must be at least mu = 0.3", "0.2"],
    ),
    "growth misspelt": (
        _AGEING + '[system.friction.growth]\nlaw = "LogaritmicGrowth"\namount = 0.1\ntime = 1',
        ["law in [system.friction.growth]", "did you mean LogarithmicGrowth?"],
    ),
    "unknown key of a growth": (
        _AGEING + '[system.friction.growth]\nlaw = "LogarithmicGrowth"\namuont = 0.1\ntime = 1',
        ["amuont in [system.friction.growth] of the law LogarithmicGrowth", "did you mean amount?"],
    ),
    "growth in no time": (
        _AGEING + '[system.friction.growth]\nlaw = "ExponentialGrowth"\namount = 0.1\ntime = 0',
        ["time in [system.friction.growth]", "greater than 0"],
    ),
    "ageing without growth": (_AGEING, ["[system.friction] lacks [system.friction.growth]", "which Ageing needs"]),
    "growth outside its section": ("[growth]\ntime = 1", ["[growth]", "did you mean [system.friction.growth]?"]),
    "one direction misspelt": (
        '[system.friction]\nlaw = "Directional"\n[system.friction.forwards]\nmu = 0.3',
        ["forwards in [system.friction] of the law Directional", "did you mean forward?"],
    ),
    "bristles in one direction": (
        '[system.friction]\nlaw = "Directional"\n[system.friction.forward]\nlaw = "Dahl"\nmu = 0.3\nstiffness = 1e3\n'
        "[system.friction.backward]\nmu = 0.3",
        ["law in [system.friction.forward]", "Stribeck, Ageing", '"Dahl"'],
    ),
    "width of bristles": (
        '[system.friction]\nlaw = "Dahl"\nmu = 0.3\nstiffness = 1e3\n[run]\nwidth = 0.001',
        ["width in [run] must be left out", "inner state", "0.001"],
    ),
    "table misspelt": ("[system.frictoin]\nmu = 1", ["frictoin in [system]", "did you mean friction?"]),
    "table outside its section": ("[friction]\nmu = 1", ["[friction]", "did you mean [system.friction]?"]),
    "table of another law": ("[base.motion]\n" + HARMONIC, ["motion in [base]", "motion belongs", "law WithJumps"]),
    "force that is none": ("[system]\nforce = true", ["force in [system]", "true"]),
    "force without a law": ("[system.force]\namplitude = 3", ["[system.force] lacks law", "Harmonic, SumOf"]),
    "force that jumps": ('[system.force]\nlaw = "SquareWave"', ["law in [system.force]", '"SquareWave"']),
    "jumps without a motion": (_JUMPS, ["[base] lacks [base.motion]", "WithJumps"]),
    "jumps that do not": (
        _JUMPS + 'law = "Harmonic"\n[base.motion]\n' + HARMONIC,
        ["law in [base.jumps]", "SquareWave"],
    ),
    "unknown key of jumps": (_JUMPS + "raet = 1.0\n[base.motion]\n" + HARMONIC, ["raet in [base.jumps]", "mean rate?"]),
    "phase given and drawn": (
        f"[base]\n{HARMONIC}phase = 0.3\nrandom_phase = true",
        ["in [base]", "phase must be left out", "random_phase"],
    ),
    "amplitudes without frequencies": (
        '[base]\nlaw = "SumOfHarmonics"\namplitudes = [1.0]\nangular_frequencies = [1.0, 2.0]',
        ["in [base]", "amplitudes", "same length"],
    ),
    "record without a source": (_RECORDED, ["in [base]", "either file, or times and values"]),
    "record with half a source": (_RECORDED + "times = [0, 1]", ["in [base]", "either file, or times and values"]),
    "record with two sources": (
        _RECORDED + 'file = "case.toml"\ntimes = [0, 1]\nvalues = [0, 1]',
        ["in [base]", "either file, or times and values"],
    ),
    "sign between no columns": (
        _RECORDED + 'times = [0, 1]\nvalues = [0, 1]\ndelimiter = ";"',
        ["in [base]", "delimiter must be left out", '";"'],
    ),
    "record that turns back": (
        _RECORDED + "times = [0, 1, 1]\nvalues = [0, 1, 2]",
        ["in [base]", "times must increase"],
    ),
    "no such record": (_RECORDED + 'file = "none.csv"', ["in [base]", "file must be", '"none.csv"', "looked in is"]),
    "column that is none": (
        _RECORDED + 'file = "case.toml"\ntime_column = 1.5',
        ["in [base]", "time_column must", "1.5"],
    ),
    "two signs between columns": (_RECORDED + 'file = "case.toml"\ndelimiter = ";;"', ["delimiter must", "whitespace"]),
    "no such accelerogram": (
        '[base]\nlaw = "GroundAcceleration"\nfile = "none.at2"',
        ["in [base]", "file must be", '"none.at2"'],
    ),
    "accelerogram not given": ('[base]\nlaw = "GroundAcceleration"', ["[base] lacks file", "GroundAcceleration needs"]),
    "too coarse an accelerogram": (
        '[base]\nlaw = "KanaiTajimi"\nrms = 1.0\ninterval = 1.0',
        ["in [base]", "interval must be at most"],
    ),
    "zero step": ("[run]\nstep = 0.0", ["step in [run]", "greater than 0"]),
    "no steps": ("[run]\nmax_steps = 0", ["max_steps in [run]", "greater than or equal to 1"]),
    "unknown solver": ('[run]\nsolver = "Euler"', ["solver in [run]", "'Dopri8'", '"Euler"']),
    "negative damping": ("[system]\ndamping = -1.0", ["damping in [system]", "greater than or equal to 0"]),
}
"""Likewise, of what `BAD_CONFIGS` leaves out."""


_OVER = "\n[sweep.over]\nmu = [1.0]\n"
BAD_SWEEPS = {
    "no points": ("[run]\nsamples = 3", "[sweep] lacks [sweep.over]"),
    "no parameter": ("[sweep.over]", "in [sweep.over], a parameter must be given with its values"),
    "samples": ("[sweep]\nsamples = 3" + _OVER, "unknown key samples in [sweep]; samples belongs in [run]."),
    "keep": ('[run]\nkeep = "totals"' + _OVER, "unknown key keep in [run] of the model MassSpring; keep belongs in"),
    "misspelt key": ("[sweep]\nkep = 1" + _OVER, "unknown key kep in [sweep]; did you mean keep?"),
    "misspelt section": ("[swep.over]\nmu = [1.0]", "unknown section [swep]; did you mean sweep?"),
    "section of another file": ("[output]\nfigures = true" + _OVER, "unknown section [output]; the sections are"),
    "inner section": ("[over]\nmu = [1.0]", "did you mean [sweep.over]?"),
    "sticks": ('[sweep]\nkeep = "sticks"' + _OVER, "keep in [sweep] must be 'statistics' or 'totals', but \"sticks\""),
    "misspelt parameter": ("[sweep.over]\nmw = [1.0]", "but 'mw' was given; did you mean mu?"),
    "misspelt range": ("[sweep.over]\nmu = { linspce = [0, 1, 5] }", "did you mean linspace?"),
    "NumPy's range": ("[sweep.over]\nmu = { geomspace = [1, 2, 5] }", "did you mean logspace?"),
    "short range": ("[sweep.over]\nmu = { linspace = [0, 1] }", "linspace of mu must be [from, to, number of values]"),
    "range from zero": ("[sweep.over]\nmu = { logspace = [0, 1, 5] }", "must go from and to positive numbers"),
    "half a value": ("[sweep.over]\nmu = { linspace = [0, 1, 2.5] }", "number of values"),
    "text": (
        '[sweep.over]\nmu = "a"',
        'mu must be a list, { linspace = ... } or { logspace = ... }, but "a" was given',
    ),
    "truth": ("[sweep.over]\nmu = [true]", "mu must hold finite numbers, but true was given"),
    "empty list": ("[sweep.over]\nmu = []", "but [] was given"),
    "name with a dot": ("[sweep.over]\nmu.low = [0, 1]", 'for a name with dots write "mu.low" = ...'),
    "rows": (
        '[sweep.over]\n"mu, rate" = [[1, 2, 3]]',
        "mu, rate must hold rows of 2 finite numbers, but [1, 2, 3] was",
    ),
    "the same row": (
        '[sweep.over]\n"mu, rate" = [[1, 2], [1, 2]]',
        "mu, rate in [sweep.over] must hold every point once, but entries 0 and 1 are both (1.0, 2.0).",
    ),
    "negative friction": ("[sweep.over]\nmu = [-1.0]", "mu must be zero or positive, but -1.0 was given"),
    "infinite": ("[sweep.over]\nmu = [inf]", "in [sweep.over], mu must hold finite numbers, but inf was given"),
    "no frequency": (
        '[base]\nlaw = "Constant"\nspeed = 1.0\n[sweep.over]\nr = [1.0]',
        "it needs a law with a frequency",
    ),
    "unknown statistic": (
        '[sweep]\nstatistics = ["mean_stick"]' + _OVER,
        "statistics in [sweep] must be names out of 'stick_fraction'",
    ),
    "unknown precision": (
        "[sweep]\nstandard_error = { stik_fraction = 0.1 }" + _OVER,
        "standard_error in [sweep] must name statistics out of",
    ),
    "unknown derivative": (
        '[sweep]\nsensitivities = { stik_fraction = ["mu"] }' + _OVER,
        "sensitivities in [sweep] must hold lists of parameters by statistic out of 'stick_fraction'",
    ),
}
"""Files of parameter sweeps, and what the message about each must contain."""


TIMES = np.linspace(0.0, 12.0, 25)
VALUES = np.round(0.6 * np.sin(1.3 * TIMES), 3)
G, TONES = 9.80665, ([0.5, 0.2], [1.5, 4.0])
_AT2 = """PEER NGA STRONG MOTION DATABASE RECORD
A test, 1/1/2000, nowhere, 90
ACCELERATION TIME SERIES IN UNITS OF G
NPTS= 25, DT= .5000 SEC
"""


def write_records(folder: Path) -> None:
    """Files that hold `VALUES` at `TIMES`: tables, an accelerogram, and one that is none."""
    rows = [f"{t},{2 * v},{v}" for t, v in zip(TIMES, VALUES, strict=True)]
    values = "\n".join(map(str, VALUES)) + "\n"
    late = "\n".join(f"{t + 1} {v}" for t, v in zip(TIMES, VALUES, strict=True)) + "\n"
    files = {
        "record.csv": "\n".join(["time,twice,value", *rows]) + "\n",
        "late.txt": late,
        "record.AT2": _AT2 + values,
        "velocity.AT2": _AT2.replace("ACCELERATION", "VELOCITY") + values,
    }
    for name, text in files.items():
        (folder / name).write_text(text)


def mass_spring(friction: ss.FrictionLaw | None = None, **more) -> ss.MassSpring:
    """The mass and spring that a study has unless it says otherwise."""
    return ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.8) if friction is None else friction, **more)
