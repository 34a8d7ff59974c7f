"""Designs refuse unsuitable arguments with one sentence that names the argument and its value."""

import math
import re

import jax
import numpy as np
import pandas as pd
import pytest

import stickslip_jax as ss

# Users run without annotation checks: here the package's own checks must answer.
pytestmark = pytest.mark.usefixtures("annotations_unchecked")

sobol, random, grid, table, saltelli = (getattr(ss.design, n) for n in ("sobol", "random", "grid", "table", "saltelli"))
SEVENTH = np.where(np.arange(10) == 6, math.nan, 0.5)
CASES = {
    "power of two": (
        lambda: sobol(1000, ["mu"]),
        "Argument samples must be a power of two, for which the points of a Sobol' sequence are balanced, but 1000 was "
        "given; take 512 or 1024, or latin_hypercube or random for any number.",
    ),
    "power of two, base": (lambda: saltelli(5, ["mu"]), "Argument base_samples must be a power of two"),
    "samples": (lambda: random(0, ["mu"]), "Argument samples must be a whole number of at least 1, but 0 was given."),
    "too many": (
        lambda: random(2**31, ["mu"]),
        "Argument samples must be at most 1073741824, but 2147483648 was given.",
    ),
    "too many rows": (lambda: saltelli(2**29, ["a"]), "Argument base_samples must be at most 1073741824"),
    "no columns": (lambda: random(4), "Argument names must be given, such as ['mu', 'stiffness'], or else dimensions,"),
    "one word": (lambda: random(4, "mu"), "Argument names must be a sequence of names of numbers, such as"),
    "no word": (lambda: random(4, [1]), "such as ['mu', 'stiffness', 'y0[0]'], but [1] was given."),
    "twice": (lambda: random(4, ["mu", "k", "mu"]), "must hold every name once, but 'mu' was given twice."),
    "dimensions": (
        lambda: random(4, ["mu"], dimensions=2),
        "Argument dimensions must be 1, the number of names, but 2 was given; leave it out.",
    ),
    "no dimensions": (
        lambda: random(4, dimensions=0),
        "Argument dimensions must be a whole number of at least 1, but 0",
    ),
    "too many dimensions": (
        lambda: saltelli(4, dimensions=20_000),
        "at most 21201 columns of a Sobol' sequence (tables A and B take two for each number), but 40000 are needed",
    ),
    "seed": (
        lambda: random(4, ["mu"], seed=-1),
        "Argument seed must be a whole number of at least 0, but -1 was given.",
    ),
    "seed of words": (
        lambda: sobol(4, ["mu"], seed="a"),
        "Argument seed must be a whole number of at least 0, but 'a'",
    ),
    "keys": (
        lambda: random(4, ["mu"], seed=jax.random.split(jax.random.key(0))),
        "Argument key must be a threefry key",
    ),
    "scramble": (lambda: sobol(4, ["mu"], scramble=1), "Argument scramble must be True or False, but 1 was given."),
    "second order": (lambda: saltelli(4, ["mu"], second_order=2), "Argument second_order must be True or False, but 2"),
    "realization": (
        lambda: random(4, ["mu"], realization="shared"),
        "must be 'own', 'common' or an array with a whole number for each sample, but 'shared' was given.",
    ),
    "saltelli realization": (
        lambda: saltelli(4, ["mu"], realization="all"),
        "Argument realization must be 'own', 'common', 'shared', 'factor' or an array with",
    ),
    "length of realizations": (
        lambda: random(4, ["mu"], realization=[0, 1]),
        "Argument realization must hold a whole number for each of the 4 samples, but [0, 1] was given.",
    ),
    "half a realization": (lambda: random(2, ["mu"], realization=[0.5, 1]), "each of the 2 samples, but [0.5, 1] was"),
    "negative realization": (
        lambda: random(2, ["mu"], realization=[0, -1]),
        "Argument realization must hold numbers from 0 to 4294967295, but realization[1] = -1 was given.",
    ),
    "no dict": (
        lambda: grid([1.0]),
        "Argument values must be a dict of arrays by name, such as {'mu': [0.2, 0.5]}, but",
    ),
    "empty dict": (lambda: grid({}), "Argument values must be a dict of arrays by name"),
    "one value": (
        lambda: grid({"mu": 0.2}),
        "Argument values['mu'] must be a one-dimensional sequence of real numbers, at",
    ),
    "no values": (
        lambda: grid({"mu": []}),
        "Argument values['mu'] must be a one-dimensional sequence of real numbers, at",
    ),
    "infinite": (
        lambda: grid({"mu": [0.2, math.inf]}),
        "Argument values['mu'] must hold finite numbers, but values['mu'][1] = inf was given.",
    ),
    "too large a grid": (
        lambda: grid({name: np.arange(2000.0) for name in "abc"}),
        "must have at most 1073741824 combinations, but has 8000000000; give fewer values of each, or take sobol.",
    ),
    "lengths": (
        lambda: table({"mu": [0.1, 0.2], "k": [1.0]}),
        "Argument numbers must have columns of equal length, but their lengths are {'mu': 2, 'k': 1}.",
    ),
    "nan": (
        lambda: table({"mu": SEVENTH}),
        "Argument numbers['mu'] must hold finite numbers, but numbers['mu'][6] = nan was given.",
    ),
    "nan of an array": (
        lambda: table(SEVENTH[:, None], ["mu"]),
        "Argument numbers must hold finite numbers, but numbers[6, 0] = nan was given.",
    ),
    "words": (
        lambda: table({"mu": ["a"]}),
        "Argument numbers['mu'] must be a one-dimensional sequence of real numbers",
    ),
    "number as a name": (
        lambda: table({1: [0.5]}),
        "a different name for each column, such as 'mu', but the names [1] were",
    ),
    "two columns of one name": (
        lambda: table(pd.DataFrame([[1.0, 2.0]], columns=["mu", "mu"])),
        "a different name for each column, such as 'mu', but the names ['mu', 'mu'] were given.",
    ),
    "names twice": (
        lambda: table({"mu": [0.5]}, ["mu"]),
        "Argument names must be left out where numbers has named columns",
    ),
    "no names": (
        lambda: table(np.ones((2, 2))),
        "Argument names must be given with an array of numbers, one name for each",
    ),
    "too few names": (
        lambda: table(np.ones((2, 2)), ["mu"]),
        "one name for each of the 2 columns of values, but ('mu',)",
    ),
    "flat": (
        lambda: table(np.ones(2), ["mu"]),
        "Argument numbers must be an array (samples, numbers) of real numbers, at",
    ),
    "no array": (
        lambda: table(None, ["mu"]),
        "Argument numbers must be an array (samples, numbers) of real numbers, at",
    ),
    "uniform": (
        lambda: table({"mu": [0.5, 1.0]}, uniform=True),
        "Argument numbers must hold uniform numbers, above 0 and below 1, but numbers[1, 0] = 1.0 was given.",
    ),
    "whether uniform": (
        lambda: table({"mu": [0.5]}, uniform="yes"),
        "Argument uniform must be True or False, but 'yes'",
    ),
    "neither": (
        lambda: ss.design.Design(kind="table", realization=[0]),
        "Argument u or values must be given, and the other",
    ),
    "base rows": (
        lambda: ss.design.Design(kind="saltelli", u=np.full((5, 1), 0.5), realization=np.arange(5), base_samples=2),
        "must fit the 5 rows of a design for Sobol' indices, but 2 was given; make such designs with",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_unsuitable_arguments_are_refused_in_a_sentence(case):
    make, part = CASES[case]
    with pytest.raises(ValueError, match=re.escape(part)) as caught:
        make()
    sentence = str(caught.value)
    assert sentence.startswith("Argument ")
    assert sentence.endswith(".")
    assert "\n" not in sentence
