"""Friction laws by themselves, under a prescribed motion: closed forms, and scipy's implicit solver."""

import itertools
import math

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import stickslip_jax as ss

# Canudas de Wit et al. 1995, Table I, under a normal force of 1 N.
LUGRE = ss.LuGre(1.0, 1.5, stribeck_speed=0.001, stiffness=1e5, damping=math.sqrt(1e5), viscous=0.4)
AGEING = ss.DieterichRuina(0.6, 0.012, 0.017, length=1e-5, reference_speed=1e-6)
SLIP = ss.DieterichRuina(0.6, 0.012, 0.008, length=1e-5, reference_speed=1e-6, form="slip")
LAWS = {
    "LuGre": LUGRE,
    "elasto-plastic": ss.ElastoPlastic(1.0, 1.5, 0.001, 1e5, 300.0, 0.4, breakaway=0.6),
    "Dahl": ss.Dahl(0.4, 2e3),
    "Dahl, sharp": ss.Dahl(0.4, 2e3, exponent=0.5),
    "Bouc-Wen": ss.BoucWen(0.4, 2e3, exponent=3.0, sharing=0.7),
    "ageing": AGEING,
    "slip": SLIP,
}


def steady(law, velocity):
    """The coefficient of a steady slip, written anew."""
    v, sign = abs(velocity), math.copysign(1, velocity)
    if isinstance(law, ss.LuGre):
        return sign * (1.0 + 0.5 * math.exp(-((v / 0.001) ** 2)) + 0.4 * v)
    if isinstance(law, ss.DieterichRuina):
        a, b, v0 = 0.012, float(law.evolution), 1e-6
        return sign * a * math.asinh(v / (2 * v0) * math.exp((0.6 + b * math.log(v0 / v)) / a))
    return sign * 0.4


@pytest.mark.slow
@pytest.mark.parametrize("velocity", [0.0007, -0.02])
@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_steady_slip(law, velocity):
    """After a slip of many times the length in which the inner state changes."""
    force = law.force([0.0, 20.0, 40.0], [velocity] * 3, 2.5)
    np.testing.assert_allclose(force[1:], 2.5 * steady(law, velocity), rtol=1e-8)
    assert float(law.steady(jnp.asarray(velocity))) == pytest.approx(steady(law, velocity), rel=1e-12)


@pytest.mark.slow_for("ageing")
@pytest.mark.parametrize("name", ["LuGre", "ageing"])
def test_harmonic_motion_against_scipy(name):
    law = LAWS[name]
    speed, w = (0.01, 3.0) if name == "LuGre" else (1e-5, 0.5)
    times = np.linspace(0.0, 5.0, 41)

    def rate(t, z):
        v = speed * math.cos(w * t)
        if name == "LuGre":
            return [v - 1e5 * abs(v) * z[0] / (1 + 0.5 * math.exp(-((v / 0.001) ** 2)))]
        return [0.1 * math.exp(-z[0]) - abs(v) / 1e-5]

    # Its steps end where the velocity changes its sign, where rates have a kink.
    turns = [0.0, *((np.arange(0, 5) + 0.5) * math.pi / w), 5.0]
    turns, z, values = [t for t in turns if t <= 5.0], [0.0], {0.0: 0.0}
    for begin, end in itertools.pairwise(turns):
        inside = times[(times > begin) & (times <= end)]
        run = solve_ivp(rate, (begin, end), z, method="Radau", rtol=1e-10, atol=1e-16, t_eval=np.union1d(inside, end))
        values.update(zip(inside, run.y[0], strict=False))
        z = run.y[:, -1]
    states, v = np.array([values[t] for t in times]), speed * np.cos(w * times)
    if name == "LuGre":
        expected = 1e5 * states + math.sqrt(1e5) * np.array(
            [rate(t, [z])[0] for t, z in zip(times, states, strict=True)]
        )
        expected += 0.4 * v
    else:
        expected = 0.012 * np.arcsinh(v / 2e-6 * np.exp((0.6 + 0.017 * states) / 0.012))
    found = law.force(times, ss.Harmonic(speed, w))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("law", [ss.Dahl(0.4, 200.0), ss.BoucWen(0.4, 200.0, exponent=1.0), ss.BoucWen(0.4, 200.0)])
def test_curve_of_the_first_loading(law):
    """Exponentially, or as tanh, towards the force of a slip; a full turn ends on the same loop."""
    times = np.linspace(0.0, 1.0, 30)
    force = law.force(times, np.full(30, 0.01), 3.0)
    share = 200 * 0.01 * times / 0.4
    expected = 1.2 * np.tanh(share) if getattr(law, "exponent", 1) == 2 else -1.2 * np.expm1(-share)
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-7)


@pytest.mark.slow
def test_jumps_of_the_speed_give_the_numbers_of_the_law_back():
    """A speed e times as high raises the coefficient by a at once, and lowers it by b after a slip of many lengths."""
    few, speed = 1e-9, 1e-3
    for law in (AGEING, SLIP):
        times = np.array([0.0, 1.0, 1.0 + few, 2.0])
        force = law.force(times, speed * np.array([1.0, 1.0, math.e, math.e]), rtol=1e-10)
        a, b = 0.012, float(law.evolution)
        assert float(force[2] - force[1]) == pytest.approx(a, rel=1e-5)
        assert float(force[2] - force[3]) == pytest.approx(b, rel=1e-5)


@pytest.mark.slow
def test_time_at_rest_strengthens():
    """Ageing form: the state variable grows with the time at rest, and the friction with its logarithm."""
    for rest in (1.0, 1000.0):
        held = AGEING.force(np.array([0.0, rest, rest + 1e-9]), [0.0, 0.0, 1e-6], rtol=1e-10)
        # theta = theta_0 + rest, where theta_0 = length / reference speed = 10 s.
        expected = 0.012 * math.asinh(0.5 * math.exp((0.6 + 0.017 * math.log(1 + rest / 10)) / 0.012))
        assert float(held[-1]) == pytest.approx(expected, rel=1e-8)


@pytest.mark.slow
def test_stiff_bristles_are_coulomb_friction():
    """With growing stiffness the force of Dahl's law comes to Coulomb's: by exp(-stiffness x / mu) after a turn."""
    times = np.linspace(0.0, 10.0, 201)
    motion = ss.Harmonic(0.3, 1.3)
    exact = ss.Coulomb(0.4).force(times, motion, 2.0)
    since = (np.abs(0.3 * np.cos(1.3 * times)) > 0.05) & (times > 0.1)
    errors = [np.max(np.abs(ss.Dahl(0.4, k).force(times, motion, 2.0) - exact)[since]) for k in (1e2, 1e3, 1e4)]
    assert errors[1] < 0.1 * errors[0]
    assert errors[2] < 1e-6


def test_laws_of_speed():
    """Of a slip; not known at rest."""
    velocity = np.array([-0.2, 0.0, 0.5])
    found = ss.Directional(ss.VelocityWeakening(0.6, 2.0), ss.Coulomb(0.3)).force([0.0, 1.0, 2.0], velocity, 10.0)
    np.testing.assert_allclose(found, [-3.0, np.nan, 3.0], rtol=1e-14)


def slider(times, positions, most, least, stiffness, play):
    """An elastic slider with free play, in tiny steps of its position."""
    fine = np.linspace(times[0], times[-1], 200_001)
    deflection, values = 0.0, np.zeros(len(fine))
    for i, step in enumerate(np.diff(positions(fine))):
        deflection = min(max(deflection + step, -least / stiffness - play), most / stiffness + play)
        values[i + 1] = stiffness * (deflection - min(max(deflection, -play), play))
    return np.interp(times, fine, values)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["signal", "arrays"])
def test_spring_and_backlash_in_front(kind):
    law, w = ss.Directional(ss.Coulomb(0.3), ss.Coulomb(0.5)), 2.0
    times = np.linspace(0.0, 7.0, 36)
    if kind == "signal":
        motion = ss.Harmonic(0.1, w)

        def positions(t):
            return 0.1 / w * np.sin(w * t)
    else:
        motion = 0.1 * np.cos(w * times)

        def positions(t):
            fine = np.interp(t, times, motion)
            return np.concatenate([[0.0], np.cumsum((fine[1:] + fine[:-1]) / 2 * np.diff(t))])

    found = law.force(times, motion, 10.0, series_stiffness=500.0, backlash=0.01)
    expected = slider(times, positions, 3.0, 5.0, 500.0, 0.005)
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5)
    assert np.ptp(np.asarray(found)) == pytest.approx(8.0, abs=1e-9)


def branch(law, normal, x, turn):
    """The force after the contact has slipped by `x` since its force was `turn`, forward: closed forms of both laws."""
    most, slope = normal * 0.4, normal * 200.0
    if isinstance(law, ss.Dahl):
        return most + (turn - most) * math.exp(-slope * x / most)
    if turn < 0:  # unloads as a spring, then the curve of the first loading
        return turn + slope * x if turn + slope * x < 0 else most * math.tanh((turn + slope * x) / most)
    return most * math.tanh(slope * x / most + math.atanh(turn / most))


def forces_behind_a_spring(law, normal, stiffness, backlash, moves):
    """The force at the ends of moves to and fro of the spring's end: how slip, spring and play share each of them."""
    force, play, found = 0.0, 0.0, []
    for move in moves:
        way = np.sign(move)

        def left(slip, start=way * force, play=way * play, move=move):
            value = branch(law, normal, slip, start)
            return slip + (value - start) / stiffness + np.sign(value) * backlash / 2 - play - abs(move)

        start, slip = way * force, brentq(left, 0.0, 1.0, xtol=1e-16)
        end = branch(law, normal, slip, start)
        passed = abs(move) - slip - (end - start) / stiffness  # of the play
        force, play = way * end, way * min(way * play + passed, backlash / 2)
        found.append(force)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("backlash", [pytest.param(0.0, marks=pytest.mark.slow), 1e-3])
@pytest.mark.parametrize("law", [ss.Dahl(0.4, 200.0), ss.BoucWen(0.4, 200.0)], ids=["Dahl", "Bouc-Wen"])
def test_bristles_behind_a_spring_with_backlash(law, backlash):
    """Forces at the turns of moves to and fro, and their derivatives, against the curves of the laws in closed form."""
    moves = np.array([0.004, -0.0025, 0.005, -0.008, 0.006, -0.007, 0.006])  # the second ends within the play
    velocity = np.append(np.stack([np.zeros(7), 2 * moves], axis=1).ravel(), 0.0)  # from rest to rest, in 1 s each

    def force(stiffness):
        times, adjoint = np.arange(15) / 2, diffrax.ForwardMode()
        return law.force(
            times, velocity, 2.5, series_stiffness=stiffness, backlash=backlash, rtol=1e-9, adjoint=adjoint
        )[2::2]  # fmt: skip

    expected, low, high = (forces_behind_a_spring(law, 2.5, k, backlash, moves) for k in (800.0, 799.9, 800.1))
    np.testing.assert_allclose(force(800.0), expected, rtol=0, atol=1e-6)
    assert np.ptp(expected) > 1.5
    np.testing.assert_allclose(jax.jacfwd(force)(800.0), (high - low) / 0.2, rtol=0, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("law", [LUGRE, pytest.param(AGEING, marks=pytest.mark.slow)], ids=["LuGre", "ageing"])
def test_derivatives(law):
    """Of the work done by the force with respect to every number of the law: both modes, against differences."""
    times = np.linspace(0.0, 2.0, 21)
    speed = 0.01 if law is LUGRE else 1e-5
    velocity = speed * np.sin(2 * times)
    leaves, tree = jax.tree.flatten(law)

    def work(numbers, adjoint=None):
        made = jax.tree.unflatten(tree, list(numbers * np.asarray(leaves)))
        force = made.force(times, velocity, rtol=1e-9, adjoint=adjoint)
        return jnp.sum(force * velocity) / speed

    one = jnp.ones(len(leaves))
    backward = jax.grad(work)(one)
    forward = jax.jacfwd(lambda numbers: work(numbers, diffrax.ForwardMode()))(one)
    np.testing.assert_allclose(forward, backward, rtol=1e-5, atol=1e-7)
    few = 1e-4
    differences = [(work(one + few * row) - work(one - few * row)) / (2 * few) for row in np.eye(len(leaves))]
    np.testing.assert_allclose(backward, differences, rtol=2e-4, atol=1e-4)


class Quick(ss.Dahl):
    """Bristles that follow the square of the speed."""

    def rate(self, z, velocity):
        return velocity * jnp.abs(velocity) - z


@pytest.mark.slow
def test_what_does_not_fit_is_told(annotations_unchecked):
    times, still = [0.0, 1.0], [0.1, 0.1]
    coulomb = ss.Coulomb(0.3)
    for call, message in (
        (lambda: LUGRE.force([0.0, 0.0], still), "Argument times must increase"),
        (lambda: LUGRE.force(times, [0.1]), "Argument velocity must have one number for each of the 2 times"),
        (lambda: LUGRE.force(times, ss.Recorded([0.0, 0.5], [0.1, 0.1])), "within the record of 0.5 s"),
        (lambda: LUGRE.force(times, still, -1.0), "Argument normal_force must be zero or positive"),
        (lambda: LUGRE.force(times, still, series_stiffness=1.0), "Argument series_stiffness must be None for LuGre"),
        (lambda: Quick(0.4, 1e3).force(times, still, series_stiffness=1.0), "series_stiffness must be None for Quick"),
        (lambda: ss.Dahl(0.4, 1e3).force(times, still, backlash=0.1), "give the series_stiffness too"),
        (lambda: LUGRE.force([0.0, 1e300], still), "Argument times must be between"),
        (lambda: LUGRE.force(times, [0.1, 1e300]), "Argument velocity must be between"),
        (lambda: LUGRE.force(times, still, [1.0, 1e300]), "Argument normal_force must be between"),
        (lambda: LUGRE.force(times, still, initial_state=1e300), "Argument initial_state must be between"),
        (lambda: LUGRE.force(times, still, max_steps=2**40), "Argument max_steps must be at most 2147483647"),
        (lambda: LUGRE.force(times, still, max_steps=3), "Argument max_steps must be larger"),
        (lambda: LUGRE.force(times, still, adjoint="forward"), "Argument adjoint must be one of diffrax's"),
        (lambda: coulomb.force(times, still, backlash=0.1), "give the series_stiffness too"),
        (lambda: coulomb.force(times, still, series_stiffness=-1.0), "Argument series_stiffness must be positive"),
        (
            lambda: ss.Coulomb(0.3, 0.4).force(times, still, series_stiffness=1.0),
            "Argument series_stiffness must be None",
        ),
        (lambda: ss.LuGre(1.0, 0.5, 0.1, 1e3), "Argument mu_static must be at least mu"),
        (lambda: ss.ElastoPlastic(1.0, 1.5, 0.1, 1e3, breakaway=1.0), "Argument breakaway must be"),
        (lambda: ss.BoucWen(0.4, 1e3, sharing=1.5), "Argument sharing must be"),
        (lambda: ss.DieterichRuina(0.6, 0.01, 0.01, 1e-5, 1e-6, form="aging"), "Argument form must be"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
