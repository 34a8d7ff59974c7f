"""What the tests of studies and of the command share."""

from pathlib import Path

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
    "unknown system": ('[system]\nmodel = "MotorCart"', ["model in [system]", "'MassSpring'", '"MotorCart"']),
    "missing key": ('[base]\nlaw = "RandomSteps"\nspeed = 1.0', ["[base] lacks interval", "RandomSteps"]),
    "text for a number": ('[system]\nmass = "1"', ["mass in [system]", "a number", '"1"']),
    "true for a number": ("[system]\nmass = true", ["mass in [system]", "a number", "true"]),
    "negative mass": ("[system]\nmass = -1.0", ["mass in [system]", "greater than 0", "-1.0"]),
    "zero stiffness": ("[system]\nstiffness = 0", ["stiffness in [system]", "greater than 0"]),
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
        ["in [base]", "same length", "2 and 1"],
    ),
    "no TOML": ("[system\nmass = 1", ["not valid TOML", "line 1"]),
}
