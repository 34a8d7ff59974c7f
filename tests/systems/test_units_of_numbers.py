"""The unit and bounds of each number of a setting, by its path."""

from typing import NamedTuple

import pytest

import stickslip_jax as ss
from stickslip_jax._foundation.fields import Quantity
from stickslip_jax._systems.system import unit_at
from stickslip_jax._uncertainty.numbers import quantity_at


class Setting(NamedTuple):
    system: object
    law: object
    y0: tuple[float, ...] = (0.0, 0.0)

    @property
    def base(self):
        return self.law


MASS = ss.MassSpring(ss.Weibull(1.0, 5.0), 4.0, 1.0, ss.BoucWen(0.5, 0.01), damping=0.1, force=ss.Harmonic(0.1, 1.0))
SETTING = Setting(MASS, ss.Harmonic(ss.Truncated(ss.LogNormal(0.5, 0.1), high=2.0), 1.5))
UNITS = {
    ("system", "stiffness"): "N/m",
    ("system", "damping"): "N s/m",
    ("system", "friction", "exponent"): "1",
    ("system", "force", "amplitude"): "N",
    ("system", "mass", "scale"): "kg",
    ("system", "mass", "shape"): "1",
    ("law", "offset"): "m/s",
    ("base", "offset"): "m/s",
    ("law", "angular_frequency"): "rad/s",
    ("law", "amplitude", "high"): "m/s",
    ("law", "amplitude", "distribution", "median"): "m/s",
    ("law", "amplitude", "distribution", "log_std"): "1",
    ("y0", 0): "m",
    ("y0", 1): "m/s",
}


@pytest.mark.parametrize(("path", "unit"), UNITS.items())
def test_unit(path, unit):
    assert unit_at(SETTING, path) == unit


def test_bounds():
    assert quantity_at(SETTING, ("system", "friction", "exponent")).at_least == 1
    assert quantity_at(SETTING, ("law", "angular_frequency")).above == 0
    assert quantity_at(SETTING, ("y0", 0)) == Quantity()
