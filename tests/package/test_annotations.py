"""The checks of annotations that run beside the tests (`support/annotations.py`) find what is wrong, wherever it is."""

import importlib
import sys

import jax.numpy as jnp
import jaxtyping
import pytest
from support.annotations import check_annotations

_CODE = '''
import dataclasses
import equinox as eqx
from jaxtyping import Array, Float

def twice(x: Float[Array, " n"]) -> Float[Array, " n"]:
    """Its words."""
    return x[:2] * 2

def name(of: "Later") -> str:
    return of.name

class Later:
    name = 1

class One(eqx.Module):
    x: Float[Array, " n"]

    def longer(self, by: int) -> int:
        return len(self.x) + by

    @classmethod
    def made(cls, n: int) -> "One":
        return cls(jnp_zeros(n))

    @staticmethod
    def half(n: int) -> int:
        return n / 2

    @property
    def size(self) -> str:
        return self.x.size

class Two(One):
    def __check_init__(self):
        assert self.x.shape

from jax.numpy import zeros as jnp_zeros
'''


@pytest.fixture(scope="module")
def annotated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("annotated")
    (folder / "annotated").mkdir()
    (folder / "annotated" / "__init__.py").touch()
    (folder / "annotated" / "part.py").write_text(_CODE)
    sys.path.insert(0, str(folder))
    check_annotations("annotated")
    yield importlib.import_module("annotated.part")
    sys.path.remove(str(folder))


_WRONG = {
    "argument": lambda part: part.twice("a"),
    "shape": lambda part: part.twice(jnp.zeros((2, 2))),
    "result": lambda part: part.twice(jnp.zeros(3)),
    "class defined later": lambda part: part.name(3),
    "result of what is defined later": lambda part: part.name(part.Later()),
    "field": lambda part: part.One("a"),
    "field of a subclass": lambda part: part.Two("a"),
    "method": lambda part: part.One(jnp.zeros(2)).longer("a"),
    "classmethod": lambda part: part.One.made("a"),
    "staticmethod": lambda part: part.One.half(2),
    "property": lambda part: part.One(jnp.zeros(2)).size,
}


@pytest.mark.parametrize("call", _WRONG.values(), ids=_WRONG)
def test_what_an_annotation_forbids_is_found(annotated, call):
    with pytest.raises(jaxtyping.TypeCheckError):
        call(annotated)


def test_what_annotations_allow_goes_on(annotated):
    assert annotated.twice(jnp.ones(2)).tolist() == [2, 2]
    assert annotated.Two.made(3).longer(1) == 4
    assert annotated.twice.__doc__ == "Its words."


@pytest.mark.usefixtures("annotations_unchecked")
def test_they_can_be_switched_off(annotated):
    assert annotated.name(annotated.Later()) == 1


def test_a_package_that_is_imported_already_is_refused():
    with pytest.raises(RuntimeError, match="stickslip_jax was imported before"):
        check_annotations("stickslip_jax")


def test_the_package_is_checked():
    import stickslip_jax as ss  # noqa: PLC0415 - as it is when the tests have begun

    with pytest.raises(jaxtyping.TypeCheckError):
        ss.simulate("no system", "no base velocity", t1=1.0)
