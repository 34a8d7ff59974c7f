"""``help`` of a method shows its signature and docstring, not the module that it belongs to, and what arguments are."""

import inspect
import pydoc
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

LAW = ss.PoissonSwitching(1.0, 1.0)
SYSTEM = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))


@pytest.fixture(scope="module")
def one():
    return ss.simulate(SYSTEM, LAW.sample(jax.random.key(0), 40.0), t1=40.0, y0=(0.0, 1.0))


def shown(method):
    return pydoc.render_doc(method, renderer=pydoc.plaintext).splitlines()[2:]


@pytest.mark.slow
def test_help_of_methods(one):
    heads = {
        "evaluate(times: ": (one.evaluate, "    The state at `times` (s, any shape)"),
        "base_velocity(times: ": (one.base_velocity, "    The base velocity at `times`"),
        "sample(key: ": (LAW.sample, "    One realisation that covers"),
        "time_scales(excitation: ": (SYSTEM.time_scales, "    The time scales of the system"),
        "kinetic(speed: ": (SYSTEM.friction.kinetic, "    Kinetic friction coefficient"),
        "icdf(u: ": (ss.Uniform(0.0, 1.0).icdf, "    "),
        "_stick_band(times: ": (SYSTEM._stick_band, "    Positions with"),
    }
    for head, (method, docstring) in heads.items():
        first, second, *_ = shown(method)
        assert first.startswith(head)
        assert second.startswith(docstring)


def test_inherited_docstrings_are_shown():
    """`PoissonSwitching.next_interval` has none of its own."""
    assert "next_interval" in vars(ss.PoissonSwitching)
    assert ss.PoissonSwitching.next_interval.__doc__ is None
    assert shown(LAW.next_interval)[1].startswith("    Duration (s) and velocity (m/s) of an interval")
    assert repr(LAW.next_interval) == "<bound method PoissonSwitching.next_interval of a PoissonSwitching>"
    assert list(inspect.signature(LAW.next_interval).parameters) == ["memory", "drawn", "dtype"]
    assert LAW.sample.__name__ == "sample"


def test_attributes_are_looked_up_without_python():
    """Those of Equinox run a function written in Python for each."""
    assert type(SYSTEM).__getattribute__ is object.__getattribute__


def test_help_of_a_class_shows_its_methods():
    text = pydoc.render_doc(ss.PoissonSwitching, renderer=pydoc.plaintext)
    assert " |  sample(self, key: " in text
    assert " |  next_interval(self, memory, drawn, dtype)" in text


@pytest.mark.slow
def test_methods_are_still_trees(one):
    """They pass through jit, vmap and grad with the numbers of their module."""
    times = jnp.linspace(0.0, 40.0, 7)
    expected = np.asarray(one.evaluate(times)[0])
    for found in (
        eqx.filter_jit(one.evaluate)(times)[0],
        jax.vmap(one.evaluate)(times)[0],
        jax.jit(lambda method: method(times)[0])(one.evaluate),
    ):
        assert np.asarray(found) == pytest.approx(expected, abs=1e-14)

    def friction(method):
        return method(jnp.array(0.5))

    slope = jax.grad(friction)(ss.VelocityWeakening(0.6, 0.4).kinetic).__self__
    exact = jax.grad(lambda law: law.kinetic(jnp.array(0.5)))(ss.VelocityWeakening(0.6, 0.4))
    assert jax.tree.leaves(slope) == jax.tree.leaves(exact)
    assert LAW.sample == LAW.sample


def public():
    """All public functions, and all methods of public classes, by name."""
    modules = (ss, ss.design, ss.nonlinear, ss.plot, ss.papers, ss.study)
    names = [(module, name) for module in modules for name in getattr(module, "__all__", dir(module)) if name[0] != "_"]
    own = [getattr(module, name) for module, name in names]
    own = [one for one in own if getattr(one, "__module__", "").startswith("stickslip_jax")]
    found = {one.__name__: one for one in own if inspect.isfunction(inspect.unwrap(one))}
    for kind in filter(inspect.isclass, own):
        members = inspect.getmembers(kind, lambda member: inspect.isfunction(member) or inspect.ismethod(member))
        found |= {f"{kind.__name__}.{name}": one for name, one in members if name[0] != "_"}
    return found


def described(function):
    """What the docstring says of each argument, by name."""
    heads = re.findall(r"^ {4}(\S.*?): (.*)", (inspect.getdoc(function) or "").partition("Args:\n")[2], re.MULTILINE)
    return {name.strip(" *"): text for names, text in heads for name in names.split(",")}


def test_help_says_of_each_argument_what_it_is():
    """Of functions all; of methods, where one argument is described all are. In its own words, not "As in ..."."""
    found = public()
    assert len(found) > 400
    for name, function in found.items():
        said = described(function)
        wanted = set(inspect.signature(function).parameters) - {"self", "cls"}
        if "." not in name or said:
            assert wanted <= set(said), f"{name} says nothing of {wanted - set(said)}"
        assert not [one for one in wanted if re.match("(?i)as (in|for|there)|likewise", said.get(one, ""))], name
