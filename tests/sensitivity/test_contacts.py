"""Sensitivities of systems with several contacts, of which one is counted, or all at once."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._dynamics.common.path import SegmentLaws, StepsShared
from stickslip_jax._sensitivity.boundaries import EngineStep
from stickslip_jax._sensitivity.counting import _distance_of_race

STEPS, KEYS = ss.PoissonSwitching(1.0, 1.0), (jax.random.key(1), jax.random.key(2))
ANYWHERE = (ss.Uniform(-0.6, 0.6),) * 4
MU = ("contacts[0].friction.mu", "contacts[1].friction.mu")
DAMPING = [[0.1, 0.0], [0.0, 0.1]]


def blocks(between=3.0, **more):
    """Two blocks on a belt, joined by a spring."""
    contacts = [ss.Contact.of_mass(i, 2, 1.0, ss.Coulomb(mu)) for i, mu in enumerate((0.9, 0.8))]
    stiffness = [[3.0 + between, -between], [-between, 4.0 + between]]
    return ss.LinearStructure([1.0, 1.0], stiffness, DAMPING, contacts, **more)


def rubbing():
    """A block on a belt, and one that rubs on it: friction in one contact has an effect on the other."""
    first = ss.Contact.of_mass(0, 2, 1.0, ss.Coulomb(0.9))
    second = ss.Contact.between(0, 1, 2, 1.0, ss.Coulomb(0.5))
    return ss.LinearStructure([1.0, 1.0], [[5.0, -2.0], [-2.0, 3.0]], DAMPING, (first, second))


def scores(statistics, system, wrt, samples=16_384, **more):
    """Of each statistic and parameter: z of the corrected derivative against differences with other random numbers, and
    of the pathwise part alone.
    """
    options = {"wrt": wrt, "t1": 10.0, "y0": ANYWHERE, **more}
    one = ss.sensitivity(statistics, system, STEPS, samples=samples, key=KEYS[0], estimator="corrected", **options)
    other = ss.sensitivity(statistics, system, STEPS, samples=4 * samples, key=KEYS[1], step=0.003, **options)
    found = []
    for statistic in statistics:
        for name in wrt:
            a, b = one[statistic][name], other[statistic][name]
            assert a.sticks_in_window > 100
            found.append(
                (
                    (a.derivative - b.derivative) / math.hypot(a.standard_error, b.standard_error),
                    (a.pathwise - b.derivative) / b.standard_error,
                )
            )
    return np.array(found).T


COUNTS = [ss.mean_stick_count, ss.mean_stick_duration]


@pytest.mark.slow
def test_blocks_on_a_belt():
    """Count and pooled duration of the second block by its own friction and by that of the first. Derivatives without
    what appears and vanishes are far off.
    """
    corrected, pathwise = scores(COUNTS, blocks().of_contact(1), MU)
    assert np.max(np.abs(corrected)) < 4
    assert np.min(np.abs(pathwise)[1::2]) > 8  # by its own friction
    assert np.max(np.abs(pathwise)[::2]) > 4  # by that of the other


@pytest.mark.slow
def test_all_at_once():
    corrected, pathwise = scores(COUNTS, blocks().of_all_contacts(), MU)
    assert np.max(np.abs(corrected)) < 4
    assert np.max(np.abs(pathwise)) > 8


@pytest.mark.slow
def test_single_sticks():
    """The duration of the first stick of the second block, from recorded sticks."""
    corrected, pathwise = scores([ss.StickDuration(1)], blocks().of_contact(1), MU[1:], samples=8192)
    assert np.max(np.abs(corrected)) < 4
    assert np.max(np.abs(pathwise)) > 4


@pytest.mark.slow
def test_one_contact_in_a_list():
    """The same numbers as without the list."""
    contact = ss.Contact.of_mass(0, 1, 1.0, ss.Coulomb(0.9))
    listed = ss.LinearStructure([1.0], [4.0], [0.1], (contact,))
    pairs = [
        (ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.9), 0.1), listed, "mu"),
    ]
    for system, in_list, name in pairs:
        one, other = (
            ss.sensitivity(
                COUNTS, each, STEPS, wrt=name, t1=10.0, samples=512, key=KEYS[0], y0=ANYWHERE[:2],
                estimator="corrected", relative_bandwidth=0.05,
            )
            for each in (system, in_list)
        )  # fmt: skip
        for statistic in COUNTS:
            assert one[statistic].sticks_in_window == other[statistic].sticks_in_window
            for what in ("value", "derivative", "standard_error", "pathwise"):
                expected = getattr(one[statistic], what)
                assert getattr(other[statistic], what) == pytest.approx(expected, rel=1e-6), (statistic, what)


def test_race():
    """All stick from the last arrival to the first release: a step with a release, and one with an arrival after it."""
    shared = StepsShared(SegmentLaws((), (), (), ()), jnp.asarray(10.0), jnp.asarray(0.1))
    y, never = (jnp.zeros(()),), -jnp.ones(3)

    def step(sign, sign_end, since, crossed=never):
        given = jnp.array(sign), (), jnp.asarray(2.0), y, jnp.array(sign_end), jnp.asarray(crossed), jnp.array(since)
        found = _distance_of_race(shared, EngineStep(jnp.asarray(1.9), y, *given))
        return float(found.switch.value), bool(found.switch.is_active), bool(found.exists)

    stuck, second, third = [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]
    assert step(stuck, second, [1.0, 1.2, 1.7]) == (pytest.approx(0.3), True, True)
    # Not where the contact that is released arrived last, nor at the end of a stick that a jump of the base began.
    assert step(stuck, second, [1.0, 1.8, 1.7])[1] is False
    assert step(stuck, second, [-1.0, -1.0, -1.0])[1] is False
    # Released at 1.95 s, before another arrives; and where it has crossed the base velocity since then.
    assert step([0.0, 1.0, -1.0], second, [1.0, 1.95, 1.7]) == (pytest.approx(-0.05), True, False)
    assert step([0.0, 1.0, -1.0], second, [1.0, 1.95, 1.7], [-1.0, 1.95, -1.0])[1] is False
    assert step([0.0, 1.0, -1.0], stuck, [1.0, 1.95, 1.7])[1] is False
    assert step(third, third, [1.0, 1.95, 1.7])[1] is False


@pytest.mark.slow
def test_what_is_refused():
    """Where the boundaries are not known: differences alone, which are the default there."""
    sprung = ss.Contact.of_mass(0, 2, 1.0, ss.Coulomb(0.9), 2.0)
    varying = ss.Contact.of_mass(0, 2, ss.Harmonic(0.5, 1.0, 0.0, 1.0), ss.Coulomb(0.9))
    run = {"t1": 1.0, "samples": 4, "key": KEYS[0], "estimator": "corrected"}
    second = ss.Contact.of_mass(1, 2, 1.0, ss.Coulomb(0.8))
    for first, name in ((sprung, MU[1]), (varying, MU[1]), (blocks().contacts[0], "contacts[0].on_base")):
        system = ss.LinearStructure([1.0, 1.0], [2.0, 3.0], None, (first, second))
        with pytest.raises(ValueError, match="Argument estimator must be 'finite-difference'"):
            ss.sensitivity(ss.mean_stick_count, system.of_contact(1), STEPS, wrt=name, **run)
    for counted in (rubbing().of_contact(0), rubbing().of_all_contacts()):
        with pytest.raises(ValueError, match="friction in one has an effect on another"):
            ss.sensitivity(ss.mean_stick_count, counted, STEPS, wrt="speed", **run)
