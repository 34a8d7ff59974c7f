"""States once a period: against one long simulation, over parameters, starts, systems and bases."""

import itertools
import math
import warnings

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax import nonlinear
from stickslip_jax.nonlinear._cases import cases_of
from stickslip_jax.nonlinear._following import follow, recurrence

HARMONIC = ss.Harmonic(amplitude=0.8, angular_frequency=1.3)
DAMPED = ss.MassSpring(1.0, 1.0, 1.0, ss.Stribeck(mu=0.4, mu_static=0.6, stribeck_speed=0.5), damping=0.05)
FALLING = ss.VelocityWeakening(mu_static=1.0, weakening=3.0)
TWO = ss.LinearStructure(
    np.ones(2), np.array([[2.2, -1.2], [-1.2, 2.2]]), None,
    contacts=(ss.Contact.of_mass(0, 2, 1.0, ss.Coulomb(0.8)), ss.Contact.of_mass(1, 2, 1.0, ss.Coulomb(1.0))),
)  # fmt: skip
CASES = {
    "harmonic base": (DAMPED, HARMONIC, 2 * math.pi / 1.3, (0.3, 0.1)),
    "square wave": (ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.9)), ss.SquareWave(1.0, 5.6), 5.6, (0.3, -0.2)),
    "force on a belt": (
        ss.MassSpring(1.0, 1.0, 1.0, FALLING, damping=0.1, force=ss.Harmonic(0.6, 0.8)),
        ss.Constant(0.3), 2 * math.pi / 0.8, (0.0, 0.0),
    ),
    "several contacts": (TWO, ss.Harmonic(1.0, 0.9), 2 * math.pi / 0.9, (0.1, 0.0, 0.0, 0.2)),
    "a list of one contact": (
        ss.LinearStructure(TWO.mass, TWO.stiffness, None, contacts=TWO.contacts[:1]),
        ss.Harmonic(1.0, 0.9), 2 * math.pi / 0.9, (0.1, 0.0, 0.0, 0.2),
    ),
    "motor": (ss.MotorCart(mu=0.5), ss.SourceVoltage(), 2 * math.pi / 10, (0.4, 0.0, 0.0)),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        name if name in ("harmonic base", "square wave") else pytest.param(name, marks=pytest.mark.slow)
        for name in CASES
    ],
)
def test_as_in_one_simulation(name):
    system, base, period, y0 = CASES[name]
    transient, kept = 3, 9
    section = nonlinear.stroboscopic_section(
        system, base, y0=y0, transient=transient, kept=kept, longest_transient=transient, progress=False
    )  # fmt: skip
    ends = period * np.arange(1, transient + kept + 1)
    realised = base.sample(None, ends[-1]) if isinstance(base, ss.SquareWave) else base
    one = ss.simulate(system, realised, t1=ends[-1], y0=y0)
    states = [np.asarray(column)[transient:] for column in one.evaluate(ends * (1 - 1e-15))]
    assert int(section.status) == 0
    np.testing.assert_allclose(section.period, period, rtol=1e-14)
    for coordinate, expected in zip(system.coordinates, states, strict=True):
        found = section[coordinate.name.replace(" ", "_")]
        assert found.attrs["units"] == coordinate.unit
        turned = expected if coordinate.period is None else np.mod(expected, coordinate.period)
        np.testing.assert_allclose(found, turned, rtol=1e-8, atol=1e-8)
    np.testing.assert_array_equal(section.cycle, np.arange(transient + 1, transient + kept + 1))
    _assert_same_sticks(section, one, ends, transient)


def _assert_same_sticks(section, one, ends, transient):
    """The time in sticks of each period, and how many begin in it, from the list of all sticks."""
    contact = None if one.sticks.contact is None else np.asarray(one.sticks.contact)
    mask = np.asarray(one.sticks.mask)
    for number in range(1 if contact is None else int(section.sizes["contact"])):
        held = mask if contact is None else mask & (contact == number)
        start, end = np.asarray(one.sticks.start)[held], np.asarray(one.sticks.end)[held]
        own = section if contact is None else section.isel(contact=number)
        for cycle, last in enumerate(ends[transient:]):
            first = last - ends[0]
            inside = np.clip(np.minimum(end, last) - np.maximum(start, first), 0, None)
            np.testing.assert_allclose(own.stick_time[cycle], inside.sum(), atol=1e-8)
            begun = np.sum((start > first + 1e-9) & (start <= last + 1e-9)) + (
                np.sum(start == 0) if first == 0 else 0
            )  # fmt: skip
            assert int(own.stick_count[cycle]) == begun
            reaches = (end > first + 1e-9) & (start < last - 1e-9)
            longest = np.max(np.minimum(end, last)[reaches] - start[reaches], initial=0)
            np.testing.assert_allclose(own.longest_stick[cycle], longest, atol=1e-8)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.* not settled within")
def test_grid_of_parameters_and_starts():
    starts = np.array([[0.0, 0.0], [1.0, 0.5], [-0.5, 0.2]])
    over = {"mu": [0.1, 0.3], "angular_frequency": [0.7, 1.3]}
    settings = {"transient": 5, "kept": 4, "progress": False}
    section = nonlinear.stroboscopic_section(DAMPED, HARMONIC, y0=starts, over=over, **settings)
    assert section.position.dims == ("mu", "angular_frequency", "start", "cycle")
    assert section.mu.attrs["long_name"] == "friction coefficient"
    assert section.angular_frequency.attrs["units"] == "rad/s"
    np.testing.assert_allclose(section.period[0, :, 0], 2 * np.pi / np.array([0.7, 1.3]))
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Stribeck(0.3, 0.6, stribeck_speed=0.5), damping=0.05)
    alone = nonlinear.stroboscopic_section(system, ss.Harmonic(0.8, 0.7), y0=starts[1], **settings)
    np.testing.assert_allclose(section.position[1, 0, 1], alone.position, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(section.stick_time[1, 0, 1], alone.stick_time, rtol=1e-12, atol=1e-13)


@pytest.mark.slow
def test_start_as_a_parameter_is_followed():
    settings = {"transient": 0, "kept": 2, "progress": False}
    section = nonlinear.stroboscopic_section(DAMPED, HARMONIC, y0=(0.1, 0.2), over={"y0[0]": [0.1, 0.4]}, **settings)
    alone = nonlinear.stroboscopic_section(DAMPED, HARMONIC, y0=(0.4, 0.2), **settings)
    np.testing.assert_allclose(section.position[1], alone.position, rtol=1e-12)


@pytest.mark.parametrize(
    ("multiplier", "returns"), [*itertools.product((0.8, 0.95, 0.99), (20, 50, 100, 200)), (0.999, 200)]
)
def test_motions_that_turn_about_an_orbit_have_not_settled(multiplier, returns):
    """``z -> multiplier exp(2 pi i r) z`` and its image by a nearly linear map, for 200 rotations r: each is told."""
    k, turns = np.arange(returns), np.random.default_rng(1).uniform(0, 1, 200)
    z = 1e-3 * multiplier**k * np.exp(2j * np.pi * turns[:, None] * k)
    states = np.stack([1 + z.real + 0.3 * z.imag, z.imag + z.real * z.imag], axis=-1)
    assert np.all(recurrence(states, np.ones((200, 2)), 1e-9, (None, None)) == -1)


def test_motions_on_a_closed_curve_and_chaos_have_settled():
    """Few are taken for others: those that move slowly along the curve look like a motion that comes nearer."""
    k, source = np.arange(100), np.random.default_rng(2)
    turn = 2 * np.pi * (source.uniform(0, 1, (400, 1)) + source.uniform(0, 1, (400, 1)) * k)
    curve = np.stack([np.cos(turn) + 0.1 * np.cos(2 * turn), np.sin(turn)], axis=-1)
    x, y = source.uniform(-0.1, 0.1, (2, 400))
    points = []
    for _ in range(200):  # the map of Henon
        x, y = 1 - 1.4 * x * x + y, 0.3 * x
        points.append(np.stack([x, y], axis=-1))
    for states in (curve, np.stack(points[100:], axis=1)):
        found = recurrence(states, np.ones((400, 2)), 1e-6, (None, None))
        assert np.mean(found == -1) < 0.04
        assert np.mean(found == 0) > 0.95


def test_recurrence_is_the_smallest_period():
    numbers = np.arange(12)
    states = np.stack([0.3 + 0 * numbers, numbers % 3.0, numbers % 4.0, numbers**2.0])[..., None]
    none = np.zeros((4, 1))
    np.testing.assert_array_equal(recurrence(states, none, 1e-6, (None,)), [1, 3, 4, -1])  # the last grows
    states[2, 5] = np.nan
    np.testing.assert_array_equal(recurrence(states, none, 1e-6, (None,)), [1, 3, 0, -1])
    turning = np.array([6.283, 0.0005, 6.2827, 0.0002])[None, :, None]
    np.testing.assert_array_equal(recurrence(turning, none[:1], 1e-2, (2 * np.pi,)), [1])
    np.testing.assert_array_equal(recurrence(turning, none[:1], 1e-6, (None,)), [0])


def _coming_nearer(multiplier, size, number, kept=64, error=0.0):
    """Of a period of `number` returns: each time round the motion is `multiplier` times as far from it."""
    at = np.arange(kept)
    way = size * np.abs(multiplier) ** (at / number) * np.sign(multiplier) ** (at // number)
    return (1 + np.cos(2 * np.pi * at / number) + way + error * np.random.default_rng(0).normal(size=kept))[:, None]


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        (_coming_nearer(-0.98, 1e-3, 2), -1),  # near a flip, from both sides in turn
        (_coming_nearer(-0.9999, 1e-4, 1), -1),  # four periods later it is within the tolerance of where it was
        (_coming_nearer(0.9999, 1e-4, 1), -1),  # one period too, but not of where it ends
        (_coming_nearer(1.001, 1e-8, 3), -1),  # it leaves an unstable orbit
        (_coming_nearer(-0.98, 1e-8, 2), 2),
        (_coming_nearer(0.5, 1e-3, 4)[32:], 4),
        (_coming_nearer(1.0, 0.0, 4, error=1e-11), 4),  # round-off of a simulation
        (np.arange(64.0)[:, None] % 13, 13),
        (np.cos(np.arange(64) * (1 + math.sqrt(5)))[:, None], 0),  # a torus
        (np.random.default_rng(1).normal(size=(64, 1)), 0),
        (_coming_nearer(-0.98, 1e-3, 2)[:7], 0),  # too few
    ],
)
def test_recurrence_of_motions_that_have_not_settled(states, expected):
    np.testing.assert_array_equal(recurrence(states[None], np.ones((1, 1)), 1e-6, (None,)), [expected])


def test_recurrence_is_judged_by_the_size_of_each_motion_alone():
    # One that runs away does not make all others look as if they recurred; what is small once a period may be large in
    # between.
    doubling = 1e-3 * np.array([1.0, 2.0] * 4)
    states = np.stack([doubling, 1e6 * 2.0 ** np.arange(8)])[..., None]
    np.testing.assert_array_equal(recurrence(states, np.zeros((2, 1)), 1e-2, (None,)), [2, -1])
    np.testing.assert_array_equal(recurrence(states[:1], np.array([[1.0]]), 1e-2, (None,)), [1])


def test_round_off_of_a_small_number_does_not_hide_that_a_motion_recurs():
    """A velocity of 1e-17 m/s beside a position of 0.5 m is zero."""
    velocity = 1e-17 * np.random.default_rng(0).normal(size=8)
    states = np.stack([np.full(8, 0.5), velocity], axis=1)[None]
    np.testing.assert_array_equal(recurrence(states, np.zeros((1, 2)), 1e-6, (None, None)), [1])


@pytest.mark.slow
def test_subharmonic_motion_is_found():
    # Without friction and damping, released at rest with the force at a third of its frequency away from the mean.
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.0))
    base = ss.Harmonic(0.0, 3.0)
    section = nonlinear.stroboscopic_section(system, base, y0=(1.0, 0.0), transient=0, kept=12, progress=False)
    assert int(section.recurrence) == 3


@pytest.mark.slow
def test_sizes_within_the_periods():
    # Seen once a period the displacement is 0; between, it is the amplitude.
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.0))
    cases = cases_of(system, ss.Harmonic(0.0, 2.0), (0.0, 1.0), None, None, ss.Exact())
    seen = follow(cases, 0, 2, progress=False)
    instants = np.array([0.1, 0.35, 0.6, 0.85]) * np.pi
    expected = [np.max(np.abs(0.5 * np.sin(2 * instants))), np.max(np.abs(np.cos(2 * instants)))]
    np.testing.assert_allclose(seen.sizes, [expected], rtol=1e-12)


@pytest.mark.slow
def test_motion_that_has_come_to_rest_repeats_itself():
    # Its velocity falls for ever, until it is round-off: compared with itself, it would never come back.
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.5), damping=0.3)
    for transient in (20, 60):
        section = nonlinear.stroboscopic_section(
            system, ss.Constant(5.0), y0=(1.0, 0.0), transient=transient, kept=10, period=7.0, progress=False
        )
        assert int(section.recurrence) == 1
        np.testing.assert_allclose(section.position, 0.5, rtol=1e-8)


@pytest.mark.slow
def test_parameter_named_as_a_variable_is():
    values = [5.0, 5.6]
    section = nonlinear.stroboscopic_section(
        CASES["square wave"][0], ss.SquareWave(1.0, 5.6), over={"period": values}, transient=3, kept=2, progress=False
    )
    np.testing.assert_array_equal(section.period, values)
    np.testing.assert_array_equal(section.period_, values)
    assert section.position.dims == ("period", "cycle")


@pytest.mark.slow
def test_cases_that_do_not_end_are_told():
    method = ss.Exact(max_steps=40)
    with pytest.warns(RuntimeWarning, match="status says which"):
        section = nonlinear.stroboscopic_section(
            DAMPED, HARMONIC, over={"mass": [1.0, 1e-8]}, transient=0, kept=2, method=method, progress=False
        )
    assert int(section.status[1]) == ss.Status.OUT_OF_STEPS
    assert np.all(np.isnan(section.position[1, 1:]))


@pytest.mark.slow
def test_long_periods_get_more_steps():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        section = nonlinear.stroboscopic_section(
            TWO, ss.Harmonic(3.0, 0.05), y0=(0.0,) * 4, transient=1, kept=1, progress=False
        )
    assert int(section.status) == 0


def test_periods_together():
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.2), damping=0.1, force=ss.Harmonic(0.5, 2.0))
    for base, period in (
        (ss.Harmonic(0.5, 3.0), 2 * np.pi),  # three of one, two of the other
        (ss.SumOfHarmonics([0.1, 0.2], [1.0, 0.4]), 10 * np.pi),
    ):
        cases = cases_of(system, base, None, None, None, ss.Exact())
        np.testing.assert_allclose(cases.cycle.duration, [period], rtol=1e-12)


@pytest.mark.slow
def test_record_begins_anew():
    times = np.linspace(0, 2, 21)
    base = ss.Recorded(times, np.sin(np.pi * times))
    section = nonlinear.stroboscopic_section(DAMPED, base, period=2.0, transient=0, kept=3, progress=False)
    twice = ss.Recorded(np.linspace(0, 6, 61), np.sin(np.pi * np.linspace(0, 6, 61)))
    one = ss.simulate(DAMPED, twice, t1=6.0)
    np.testing.assert_allclose(section.position[-1], one.final_state[0], rtol=1e-9)


BAD = {
    "random": (
        {"base": ss.PoissonSwitching(1.0, 1.0)},
        "Argument base must repeat itself, but the random law PoissonSwitching was given",
    ),
    "nothing drives it": ({"base": ss.Constant(1.0)}, r"Argument period must be given \(s\), because nothing"),
    "a record": (
        {"base": ss.Recorded([0.0, 1.0], [0.0, 1.0])},
        r"Argument period must be given \(s\), because none is known of the Recorded",
    ),
    "too short a record": ({"base": ss.Recorded([0.0, 1.0], [0.0, 1.0]), "period": 2.0}, "must last until t1 = 2 s"),
    "half a period": ({"period": 2.0}, "Argument period must be a whole number of periods"),
    "no common period": (
        {"base": ss.SumOfHarmonics([1.0, 1.0], [1.0, math.sqrt(2)])},
        "Argument period must be given",
    ),
    "regularized": ({"method": ss.Regularized(0.1)}, "Argument method must be Exact"),
    "no such parameter": ({"over": {"mo": [0.1]}}, "Argument over must name one of"),
    "a value out of bounds": ({"over": {"mu": [0.1, -1.0]}}, "mu = -1"),
    "transient": ({"transient": -1}, "Argument transient must be"),
    "kept": ({"kept": 0}, "Argument kept must be"),
    "tolerance": ({"tolerance": 0.0}, "Argument tolerance must be positive"),
    "start": ({"y0": np.zeros((2, 3))}, "Argument y0"),
    "no start": ({"y0": np.zeros((0, 2))}, "Argument y0"),
    "start that is not finite": ({"y0": np.array([[0.0, np.nan]])}, "Argument y0"),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_input_is_told_in_a_sentence(name):
    given, said = BAD[name]
    with pytest.raises(ValueError, match=said):
        nonlinear.stroboscopic_section(**({"system": DAMPED, "base": HARMONIC} | given), progress=False)


def test_traced_arguments_are_refused():
    with pytest.raises(ValueError, match="Sections, diagrams, basins and exponents need numbers, but JAX is tracing"):
        jax.jit(lambda x: nonlinear.stroboscopic_section(DAMPED, HARMONIC, y0=(x, 0.0)).position.values)(0.1)
