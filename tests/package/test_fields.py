"""What a field's annotation states is what the constructor checks, the docstring says, and a study's file offers."""

import dataclasses
import inspect
import sys
from types import ModuleType
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError

import stickslip_jax as ss
from stickslip_jax._foundation.fields import Checked, Choice, described
from stickslip_jax.study._config import StudyConfig
from stickslip_jax.study._sections import DescribedSection, kinds_in, section_of
from stickslip_jax.study._systems_config import BaseConfig, ForceConfig, FrictionConfig, SystemConfig

PUBLIC = [getattr(ss, name) for name in ss.__all__]
CHECKED = [kind for kind in PUBLIC if isinstance(kind, type) and issubclass(kind, Checked)]
DESCRIBED = [kind for kind in CHECKED if described(kind)]
KINDS = [kind for part in (SystemConfig, BaseConfig, ForceConfig, FrictionConfig) for kind in kinds_in(part).values()]
SECTIONS = [kind for kind in KINDS if hasattr(kind, "described_class")]


def name_of(kind) -> str:
    return kind.__name__


def test_what_is_described():
    assert len(DESCRIBED) > 15
    assert len(SECTIONS) > 12


@pytest.mark.parametrize("kind", DESCRIBED, ids=name_of)
def test_docstring_names_every_field_and_its_unit(kind):
    text = " ".join(inspect.getdoc(kind).split())
    for name, about in described(kind).items():
        assert f" {name}: " in text or f"`{name}`" in text, name
        if isinstance(about, ss.Quantity) and about.unit:
            assert about.unit in text, name


@pytest.mark.parametrize("kind", CHECKED, ids=name_of)
def test_every_field_of_numbers_is_described(kind):
    """Fields that hold no number of the constructor's are laws, signals, functions, distributions, the arrays of a
    realisation, and what fixes how many numbers are drawn.
    """
    others = {"friction", "force", "curve", "signal", "motion", "distribution", "gap", "spectrum", "acceleration"}
    others |= {"speed", "alternating", "harmonics"} if kind in (ss.SemiMarkovSwitching, ss.GaussianProcess) else set()
    others |= {"durations", "values", "slopes", "may_jump"} if kind is ss.VelocitySegments else set()
    others |= {"durations", "velocities"} if kind is ss.VelocitySteps else set()
    others |= {"smoothing"} if kind is ss.Recorded else set()  # in words
    others |= {"direction"} if kind is ss.Contact else set()
    others |= {"records"} if kind is ss.RecordSuite else set()  # stored by points
    others |= {"law", "growth"} if kind is ss.Ageing else set()
    others |= {"forward", "backward"} if kind is ss.Directional else {"forward"} if kind is ss.OneWay else set()
    others |= {"places", "laws", "on"} if kind is ss.FrictionByPlace else set()
    others |= {"counted_contact"}  # chosen by `of_contact`
    # Matrices, which have checks of their own.
    others |= {"mass", "stiffness", "damping", "contacts"} if kind is ss.LinearStructure else set()
    others |= {"uncoupled", "rotates", "drawn_as"}  # of structures, true or false, and a word
    assert {field.name for field in dataclasses.fields(kind)} - set(described(kind)) <= others


@pytest.mark.parametrize("kind", SECTIONS, ids=name_of)
def test_section_has_the_bounds_and_the_unit_of_each_field(kind):
    for name, about in described(kind.described_class).items():
        info = kind.model_fields[name]
        if isinstance(about, ss.Quantity):
            assert about.unit in info.description or "base velocity" in about.unit, name
            if about.ndim == 0:
                bounds = {type(bound).__name__: getattr(bound, type(bound).__name__.lower()) for bound in info.metadata}
                expected = {"Gt": about.above, "Ge": about.at_least, "Lt": about.below}
                assert bounds == {key: value for key, value in expected.items() if value is not None}, name


class Power(ss.FrictionLaw):
    """A friction law that the package does not have."""

    mu: Annotated[float, ss.Quantity(meaning="friction coefficient", at_least=0)]
    scale: Annotated[float | None, ss.Quantity("m/s", "of the speed; not given: none", above=0, below=9)] = None
    side: Annotated[str, Choice(("left", "right"), "left or right")] = "left"
    steps: Annotated[tuple, ss.Quantity("s", "in between", above=1, ndim=1, hint="add 1")] = (2.0, 3.0)

    @property
    def static(self):
        return self.mu

    def kinetic(self, speed):
        return self.mu

    def check_relations(self):
        if self.scale == self.mu:
            raise ValueError(f"Argument scale must not be mu = {self.mu}, but {self.scale} was given.")


def test_quantity_shows_what_was_given():
    assert repr(ss.Quantity("kg", above=0)) == "Quantity(unit='kg', above=0)"


def test_constructor_checks_what_is_stated():
    assert Power(0.3).scale is None
    for arguments, message in {
        (-1.0,): "Argument mu must be zero or positive, but -1.0 was given.",
        (None,): "Argument mu must be a single real number, but None was given.",
        (0.3, 0.0): "Argument scale must be positive (in m/s), but 0.0 was given.",
        (0.3, 9): "Argument scale must be below 9 (in m/s), but 9 was given.",
        (0.3, 1e-200): (
            "Argument scale must be between 1e-100 and 1e+100 (in m/s), but 1e-200 was given; choose other units."
        ),
        (0.3, 0.3): "Argument scale must not be mu = 0.3, but 0.3 was given.",
        (0.3, 1.0, "up"): "Argument side must be 'left' or 'right', but 'up' was given.",
        (0.3, 1.0, "left", (2.0, 1.0)): "Argument steps must be above 1 (in s), but array([2., 1.]) was given; add 1.",
    }.items():
        with pytest.raises(ValueError, match=r"\AArgument ") as caught:
            Power(*arguments)
        assert str(caught.value) == message


def test_section_follows_from_the_class():
    section = section_of(Power, "law", {"mu": 0.5})
    assert issubclass(section, DescribedSection)
    assert list(section.model_fields) == ["law", "mu", "scale", "side", "steps"]
    assert section.model_fields["scale"].description == "of the speed, m/s; not given: none"
    made = section(scale=2.0, side="right").build()
    assert (made.mu, made.scale, made.side, made.steps) == (0.5, 2.0, "right", [2.0, 3.0])
    for wrong in ({"mu": -1.0}, {"scale": 9.0}, {"side": "up"}, {"mu": 0.3, "scale": 0.3}):
        with pytest.raises(ValidationError):
            section(**wrong)


POSTPONED = """
from __future__ import annotations
from typing import Annotated
import stickslip_jax as ss
class Postponed(ss.MassSpring):
    backlash: Annotated[float, ss.Quantity("m", above=0)] = 1.0
"""


def test_annotations_that_are_text(monkeypatch):
    """As ``from __future__ import annotations`` makes them."""
    module = ModuleType("postponed")
    monkeypatch.setitem(sys.modules, "postponed", module)
    exec(POSTPONED, vars(module))
    with pytest.raises(ValueError, match=r"Argument backlash must be positive \(in m\), but -1.0 was given\."):
        module.Postponed(1.0, 1.0, 1.0, ss.Coulomb(0.3), backlash=-1.0)


def law(number):
    return ss.MassSpring(number, number, 1.0, ss.Stribeck(0.1, number, number), damping=number)


def test_traced_numbers_pass_unchecked_and_add_nothing():
    assert jax.make_jaxpr(law)(jnp.asarray(-1.0)).eqns == []
    assert jax.jit(law)(-1.0).mass == -1
    many = jax.vmap(law)(jnp.asarray([1.0, -1.0]))
    assert many.friction.stribeck_speed.tolist() == [1.0, -1.0]
    assert jax.grad(lambda number: law(number).mass * 3.0)(-1.0) == 3


def test_known_numbers_are_checked_while_others_are_traced():
    known = jnp.asarray(-1.0)
    with pytest.raises(ValueError, match="normal_force must be positive"):
        jax.jit(lambda mass: ss.MassSpring(mass, 1.0, known, ss.Coulomb(0.3)).mass)(1.0)


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize("number", [np.float32(0.3), jnp.float32(0.3), 0.3, np.asarray(0.3)])
def test_numbers_stay_what_they_are(number):
    assert ss.Coulomb(number).mu is number


def test_units_of_a_written_study_are_those_of_the_fields():
    written = StudyConfig.model_validate({"system": {"model": "MotorCart"}}).to_toml()
    for name, about in described(ss.MotorCart).items():
        line = next(line for line in written.splitlines() if line.startswith(f"{name} = "))
        assert line.endswith(f"# {about.description}")
