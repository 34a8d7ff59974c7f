"""Regularised dynamics: against scipy, closed forms and the exact engine; in batches, ensembles and derivatives."""

import math
from functools import cache
from typing import ClassVar

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.interval import evaluate_compiled, padded, simulate_compiled
from support.regularized import (
    LAWS,
    PHI,
    POINTS,
    SLOTS,
    STEPS,
    TSIT,
    Case,
    as_floats,
    by_scipy,
    case,
    coefficient,
    field_of,
    follow,
    program,
    sticks,
)

import stickslip_jax as ss
from stickslip_jax._dynamics.common.method import Switch
from stickslip_jax._dynamics.regularized.field import balance

# Each shape and each law once; `test_coefficient` looks at all of them together.
PAIRS = [("tanh", "coulomb"), ("linear", "static"), ("arctan", "weakening"), ("rational", "stribeck")]


@pytest.mark.parametrize(
    ("shape", "law"), [PAIRS[0], *(pytest.param(*pair, marks=pytest.mark.slow) for pair in PAIRS[1:])]
)
def test_against_scipy(shape, law):
    """Adaptive steps: their ends by the tolerance, what is between them by a cubic. Fixed steps: of second order."""
    times, steps = np.linspace(0, 5, POINTS), (0.02, 0.01, 0.005)
    states, end, _ = by_scipy(case(law), field_of(case(law), shape, law), times)
    one = program(shape, False)(case(law))
    assert one.status == ss.Status.FINISHED
    np.testing.assert_allclose(one.final_state, end, atol=3e-8)
    np.testing.assert_allclose(evaluate_compiled(one, times), states, atol=1e-5)
    if shape in ("tanh", "rational"):
        runs = [program(shape, True)(case(law, pace=step)) for step in steps]
        errors = [np.max(np.abs(np.array(one.final_state) - end)) for one in runs]
        assert errors[0] < 5e-5
        assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(2, abs=0.1)
        np.testing.assert_allclose(evaluate_compiled(runs[2], times), states, atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("shape", PHI)
@pytest.mark.parametrize("law", LAWS)
def test_coefficient(shape, law):
    """Odd, by the definition, largest what a stick holds, and Coulomb's coefficient far away."""
    width, switch = 0.03, Switch(0.03, shape)
    r = np.concatenate([np.linspace(0, 10, 4001) * width, np.geomspace(1e-9, 1e4, 200) * width])
    found = np.asarray(switch.coefficient(LAWS[law][0], jnp.asarray(r)))
    np.testing.assert_allclose(found, coefficient(shape, law, r, width), rtol=1e-13, atol=1e-15)
    np.testing.assert_array_equal(np.asarray(switch.coefficient(LAWS[law][0], jnp.asarray(-r))), -found)
    if law == "static":
        assert np.max(found) == pytest.approx(0.7, abs=1e-12)
        assert found[-1] == pytest.approx(0.5, abs=1e-4)


@pytest.mark.slow_but_for("None-rational", "None-tanh", "None-linear")
@pytest.mark.parametrize("shape", PHI)
@pytest.mark.parametrize("slides", [None, 0.0, 1.0])
def test_the_friction_of_an_implicit_stage(shape, slides):
    """For any width, against bisection; with static friction (`slides`) a stick sticks while it can, a slip slides."""
    grids = np.meshgrid(np.geomspace(1e-12, 1e2, 29), [1e-9, 1e-3, 0.03, 0.099, 0.11, 0.139, 0.2, 2.0])
    (width, speed), stiffness = (grid.ravel() for grid in grids), 0.2
    law = "coulomb" if slides is None else "static"

    def friction(w, v):
        before = None if slides is None else jnp.asarray(slides)
        found, goes_on = balance(Switch(w, shape), LAWS[law][0], v, jnp.asarray(stiffness), before)
        return found, 0.0 if goes_on is None else goes_on

    found, goes_on = (np.asarray(leaf) for leaf in jax.jit(jax.vmap(friction))(jnp.asarray(width), jnp.asarray(speed)))

    def missing(at):
        return at + stiffness * coefficient(shape, law, at, width) - speed

    low, high, sliding = np.full_like(speed, 1e-40), speed, np.zeros_like(speed, bool)
    if slides is not None:
        # The fastest balance beyond the width lies behind the last point of a fine grid where friction is too weak.
        grid = np.geomspace(np.maximum(width, 1e-13), np.maximum(speed, width * (1 + 1e-9)), 20_001)
        weak = missing(grid) < 0
        last = len(grid) - 1 - np.argmax(weak[::-1], axis=0)
        slow, fast = (np.take_along_axis(grid, np.minimum(last + k, 20_000)[None], 0)[0] for k in (0, 1))
        breaks = speed > width + stiffness * 0.7
        sliding = np.any(weak, axis=0) & (breaks | (slides == 1)) & (speed > width)
        low, high = np.where(sliding, slow, low), np.where(sliding, fast, np.minimum(width, speed))
        np.testing.assert_array_equal(goes_on, sliding)
    for _ in range(200):
        middle = np.sqrt(low) * np.sqrt(high)
        above = missing(middle) > 0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    expected = coefficient(shape, law, high, width)
    np.testing.assert_allclose(found, expected, rtol=1e-10 if slides is None else 1e-5)


@pytest.mark.slow
def test_fixed_steps_are_stable_for_any_width():
    base = ss.PoissonSwitching(1.0, 1.0).sample(jax.random.key(3), 50.0, capacity=SLOTS)
    exact = simulate_compiled(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0)), base, 50.0, (0.0, 1.0))
    parts = np.linspace(0, 50, 10 * POINTS).reshape(-1, POINTS)  # no other size than elsewhere: compiled once

    def farthest(one):
        return max(np.max(np.abs(evaluate_compiled(one, times)[0])) for times in parts)

    most = farthest(exact)
    system = {"mu": 1.0, "damping": 0.0, "push": 0.0, "k": 4.0, "m": 1.0, "n": 1.0}
    system |= {"y0": (0.0, 1.0), "t1": 50.0, "pace": 0.05}

    for width in (1e-12, 1e-9, 1e-6, 1e-4, 1e-2, 1.0, 1e2):
        one = program("tanh", True)(case(durations=base.durations, speeds=base.velocities, width=width, **system))
        assert one.status == ss.Status.FINISHED
        assert farthest(one) < 1.1 * most
        if width <= 1e-6:
            assert float(one.stick_fraction) == pytest.approx(float(exact.stick_fraction), rel=0.1)


def blind_field(t, y, pulse):
    """What `pulse` describes for an integrator that does not know when the base jumps."""
    at, delta = pulse
    v = jnp.where((t >= at) & (t < at + delta), 5.0, -5.0)
    return jnp.stack([y[1], (-3.0 * y[0] - 1.5 * 0.6 * jnp.tanh((y[1] - v) / 0.1)) / 1.2])


def pulse(delta, speed, start, at, pace):
    """A base of constant velocity but for a pulse."""
    return case(damping=0.0, push=0.0, durations=(at, delta, 9.0), speeds=(speed, 5.0, speed), y0=start, pace=pace)


@pytest.mark.slow
@pytest.mark.parametrize("delta", [1e-6, 1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("fixed", [False, True])
def test_a_short_pulse_is_not_stepped_over(fixed, delta):
    """While the mass slides, friction turns round for the pulse: a kick, which the spring turns."""
    simulate, pace, at, omega = program("tanh", fixed), 0.02 if fixed else 1e-8, 3.0, math.sqrt(3.0 / 1.2)
    one, calm = (simulate(pulse(delta, -5.0, (0.2, 0.0), begin, pace)) for begin in (at, 6.0))
    angle, kick = omega * (2 - delta / 2), 2 * 0.6 * 1.5 * delta / 1.2
    change = np.array(one.final_state) - np.array(calm.final_state)
    np.testing.assert_allclose(change, kick * np.array([math.sin(angle) / omega, math.cos(angle)]), atol=2e-3 * kick)
    stuck = simulate(pulse(delta, 0.05, (0.0, 0.05), at, pace))
    for run in (one, stuck):
        off = np.abs(np.asarray(run.step_starts)[:, None] - [at, at + delta])
        assert np.all(np.min(off, axis=0) <= 2 * np.spacing(at))
    start, end, position, ending = sticks(stuck)
    assert ending.tolist() == [ss.Ending.BASE_SWITCHED, ss.Ending.HORIZON]
    np.testing.assert_allclose([*start, *end], [0, at + delta, at, 5], rtol=1e-15)
    np.testing.assert_allclose(position, [0, evaluate_compiled(stuck, np.full(POINTS, start[1]))[0][0]], atol=1e-14)

    if not fixed:
        controller, save = diffrax.PIDController(rtol=1e-8, atol=1e-8), diffrax.SaveAt(steps=True)
        plain = {"max_steps": 512, "stepsize_controller": controller, "saveat": save}
        plain |= {"args": jnp.array([at, delta])}
        blind = diffrax.diffeqsolve(diffrax.ODETerm(blind_field), TSIT, 0.0, 5.0, None, jnp.array([0.2, 0.0]), **plain)
        assert not np.any((blind.ts >= at) & (blind.ts <= at + delta))
        np.testing.assert_allclose(blind.ys[np.sum(np.isfinite(blind.ts)) - 1], calm.final_state, atol=1e-7)


@pytest.mark.parametrize(
    "shape", ["linear", *(pytest.param(one, marks=pytest.mark.slow) for one in ("tanh", "arctan"))]
)
def test_steps_that_do_not_resolve_the_width_end_sticks_where_short_ones_do(shape):
    """A mass is released within a step that is ten times as long as it takes to leave the band."""
    for mu, frequency, speed in ((0.5, 0.8, 1.0), (0.3, 0.5, 1.0), (0.7, 0.7, 1.5)):
        system, belt = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(mu)), ss.Harmonic(speed, frequency)
        ends = []
        for step in (5e-4, 1e-2):
            method = ss.Regularized(1e-3, shape, step=step)
            found = ss.simulate(system, belt, t1=30.0, y0=(0.3, 0.2), method=method).sticks
            ends.append(np.asarray(found.end)[found.mask & (found.ending == ss.Ending.RELEASED)])
        assert len(ends[0]) > 0
        np.testing.assert_allclose(ends[1], ends[0], atol=0.2 * step)


@pytest.mark.parametrize("fixed", [False, True])
def test_sticks_are_what_evaluate_shows(fixed):
    """They begin and end at the threshold, and last for the shortest duration, by default of the documented size."""
    one = program("tanh", fixed)(case(width=0.02, pace=0.0025 if fixed else 1e-8, t1=5.0))
    threshold = 0.02 * (0.45 + math.log(0.6 * 1.5 / math.sqrt(1.2 * 3.0) / 0.02) / 4)
    assert float(one.method.threshold) == pytest.approx(threshold, rel=1e-12)
    shortest = max(10 * threshold / (0.6 * 1.5 / 1.2), 0.005 if fixed else 0)
    assert float(one.method.minimum_duration) == pytest.approx(shortest, rel=1e-12)
    assert one.sticks.count > 0
    for begin, stop, x, code in zip(*sticks(one), strict=True):
        assert stop - begin >= shortest
        states = evaluate_compiled(one, np.linspace(begin, stop, POINTS))
        creep = np.abs(np.asarray(states[1]) - (0.5, -0.3, 0.4)[np.searchsorted([2.1, 3.8], (begin + stop) / 2)])
        assert np.all(creep <= threshold * 1.001)
        assert creep[0] == pytest.approx(threshold, rel=1e-3)
        assert x == pytest.approx(float(states[0][0]), abs=1e-14)
        assert code == (ss.Ending.HORIZON if stop == 5 else ss.Ending.RELEASED)
        assert stop == 5 or creep[-1] == pytest.approx(threshold, rel=1e-3)


@pytest.mark.parametrize("fixed", [False, True])
def test_a_pass_is_no_stick_and_a_short_base_is_reported(fixed):
    pace = 0.02 if fixed else 1e-8
    still = {"push": 0.0, "durations": (9.0,), "speeds": (0.0,), "y0": (2.0, 0.0)}
    one = program("tanh", fixed)(case(mu=0.05, width=0.01, pace=pace, **still))
    v = np.asarray(evaluate_compiled(one, np.linspace(0, 5, POINTS))[1])
    assert np.sum(v[1:] * v[:-1] < 0) >= 2
    assert one.sticks.count == 0
    short = program("tanh", fixed)(case(durations=(1.0, 1.0, 1.0), pace=pace))
    assert (int(short.status), float(short.time_reached)) == (ss.Status.BASE_TOO_SHORT, 3.0)


POINT = {"mu": 0.6, "width": 0.1, "stiffness": 3.0, "first": 2.1}
WEIGHTS = np.array([1.0, 0.7, -0.4, 0.3])


def at_point(point, pace):
    """A case by its parameters, one of which is when the base first jumps (and all that follows is later)."""
    item = as_floats(case(mu=point["mu"], width=point["width"], k=point["stiffness"], pace=pace))
    return item._replace(base=ss.VelocitySteps(item.base.durations.at[0].set(point["first"]), item.base.velocities))


@cache
def differences():
    """Central differences of what `told` tells, by scipy: (told, parameters)."""

    def exact(point):
        item, scale = at_point(point, 1e-8), point["mu"] * 1.5 / math.sqrt(1.2 * point["stiffness"])
        item = jax.tree.map(np.asarray, item)._replace(base=item.base, width=point["width"])
        threshold = point["width"] * (0.45 + math.log(scale / point["width"]) / 4)
        field = field_of(item, "tanh", "coulomb", point["mu"])
        _, end, passages = by_scipy(item, field, np.zeros(0), lambda y, v: y[1] - v, threshold)
        return np.array([*end, passages[np.argmin(np.abs(passages - 2.4))], point["first"] + 1.7])

    moved = [[exact(POINT | {name: POINT[name] + way * 1e-3}) for way in (1, -1)] for name in POINT]
    return np.stack([(high - low) / 2e-3 for high, low in moved], axis=1)


def watched(one):
    """End state, start and end of the first stick."""
    return jnp.stack([*one.final_state, one.sticks.start[0], one.sticks.end[0]])


SEED = dict(zip(POINT, (0.7, 0.2, -0.5, 0.4), strict=True))


def told(point, fixed, **options):
    return watched(follow(at_point(point, 0.0025 if fixed else 1e-9), fixed=fixed, **options))


def along_seed(fixed, **options):
    """The derivative along `SEED`, forward; against differences. Of fixed steps a stick's start is of first order."""
    seed = as_floats(SEED)
    _, tangent = jax.jit(lambda at: jax.jvp(lambda at: told(at, fixed, **options), (at,), (seed,)))(as_floats(POINT))
    expected = differences() @ np.array([*SEED.values()])
    np.testing.assert_allclose(tangent[:2], expected[:2], rtol=1e-4)
    np.testing.assert_allclose(tangent[2:], expected[2:], rtol=5e-3 if fixed else 1e-4)
    return tangent


@pytest.mark.slow
def test_forward_derivatives_of_fixed_steps():
    along_seed(True)


@pytest.mark.slow
@pytest.mark.parametrize(("fixed", "solver"), [(True, False), (False, False), (False, True)])
def test_derivatives(fixed, solver):
    """Reverse as forward, and against differences."""
    options = {"solver": TSIT} if solver else {}
    tangent = along_seed(fixed, **options, **({"adjoint": diffrax.ForwardMode()} if solver else {}))
    back = jax.jit(jax.grad(lambda at: WEIGHTS @ told(at, fixed, **options)))(as_floats(POINT))
    along = sum(float(back[name] * SEED[name]) for name in POINT)
    assert along == pytest.approx(float(WEIGHTS @ tangent), rel=1e-8 if fixed else 1e-6)
    slopes = WEIGHTS @ differences()
    np.testing.assert_allclose([back[name] for name in POINT], slopes, rtol=3e-4, atol=1e-3 if fixed else 0)


@pytest.mark.slow
def test_vmap_in_float32():
    """Over width and friction; 250 steps of a few units in the last place."""
    items = [as_floats(case(mu=mu, width=width, pace=0.02)) for mu, width in ((0.6, 0.1), (0.3, 0.02))]
    exact = [np.stack(program("tanh", True)(item).final_state) for item in items]
    single = jax.tree.map(lambda *leaves: np.stack(leaves).astype(np.float32), *items)
    with jax.enable_x64(False), pytest.warns(UserWarning, match="float32"):
        found = jax.jit(jax.vmap(lambda item: jnp.stack(follow(item, fixed=True).final_state)))(single)
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, exact, atol=2e-5)


class Own(ss.SwitchedSystem):
    """The system of `case` written by hand."""

    mu: float = 0.6
    traces: ClassVar[list] = []
    state_names = ("position in m", "velocity in m/s")
    shortest_time = 2 * math.pi / 2.5**0.5

    def rates(self, t, y, base, friction):
        if isinstance(t, jax.core.Tracer):
            self.traces.append(t)
        force = jnp.cos(0.7 * t + 0.2) - 0.2 * y[1] - 3.0 * y[0]
        return y[1], (force - 1.5 * self.mu * friction) / 1.2

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity


@pytest.mark.slow
@pytest.mark.parametrize("fixed", [False, True])
def test_a_system_written_by_hand(fixed):
    """The same steps, with thresholds given by hand; another width and threshold need no compilation."""
    counts = []
    Own.traces.clear()
    for width in (0.1, 0.05, 0.07):
        item = case(width=width, pace=0.02 if fixed else 1e-6)
        known = program("tanh", fixed)(item)
        given = {name: float(getattr(known.method, name)) for name in ("threshold", "minimum_duration")}
        pace = {"step": 0.02} if fixed else {"rtol": 1e-6, "atol": known.method.atol, "solver": TSIT}
        method = ss.Regularized(width, "tanh", **given, **pace, max_steps=STEPS)
        own = ss.simulate(Own(), item.base, t1=5.0, y0=(1.0, 0.5), method=method)
        np.testing.assert_allclose(own.final_state, known.final_state, atol=1e-9)
        for values, expected in zip(sticks(own), sticks(known), strict=True):
            np.testing.assert_allclose(values, expected, atol=1e-9)
        assert {name: float(getattr(own.method, name)) for name in given} == given
        counts.append(len(Own.traces))
    # The second compiles what checks the numbers of a system whose class has been tried.
    assert counts[1] == counts[2] > 0


@pytest.mark.slow
def test_ensembles_of_fixed_steps():
    """Samples are simulations, whatever the chunks and threads; those that need more than 264 steps are given up."""
    system, law, t1 = case().system, ss.PoissonSwitching(0.5, 1.0), 5.2
    method = ss.Regularized(0.05, "tanh", step=0.02, max_steps=264)
    options = {"t1": t1, "samples": 10, "key": jax.random.key(1), "method": method, "keep": "sticks"}
    options["y0"] = (ss.Uniform(-1.0, 1.0), 0.5)
    many, other = (ss.simulate_ensemble(system, law, chunk=c, threads=n, **options) for c, n in ((8, 1), (5, 2)))
    for values, others in zip(many.flat_sticks, other.flat_sticks, strict=True):
        np.testing.assert_array_equal(values, others)
    statuses = []
    for number in range(10):
        _, base, start = many.realization(number)
        one = program("tanh", True)(Case(system, padded(base.durations, base.velocities, SLOTS), start, t1, 0.05, 0.02))
        lengths = np.diff(np.unique(np.minimum([0.0, *np.cumsum(base.durations)], t1)))
        statuses.append(ss.Status.OUT_OF_STEPS if np.sum(np.ceil(lengths / 0.02 - 1e-6)) > 264 else ss.Status.FINISHED)
        assert float(one.method.threshold) == pytest.approx(float(many.method.threshold), rel=1e-12)
        if statuses[-1] == ss.Status.FINISHED:
            for values, expected in zip(sticks(many, number), sticks(one), strict=True):
                np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-9)
    finished, stick_time = statuses.count(ss.Status.FINISHED), np.sum(many.flat_sticks.end - many.flat_sticks.start)
    assert many.totals.status.tolist() == statuses
    assert 0 < finished == many.finished < 10 < 100 * stick_time
    assert f"NOT FINISHED: {10 - finished} samples, because all time steps allowed were used" in repr(many)
    assert "(leave max_steps out of method=, or raise it)" in repr(many)
    assert ss.stick_fraction(many).value == pytest.approx(stick_time / (finished * t1), rel=1e-12)


CART, CART_WIDTH, VOLTAGE = ss.MotorCart(mu=0.5), 0.02, ss.SourceVoltage(0.0, 2.0, 10.0)
CART_OPTIONS = {"t1": 0.5, "method": ss.Regularized(CART_WIDTH, "tanh", rtol=1e-7, max_steps=1024)}


def assert_is_the_cart_of_scipy(one, phase, start):
    def field(t, y, _):
        (a, w, c), m, d = y, 5.0, 0.01
        s, u = math.sin(a), 2.0 * math.sin(10.0 * t + phase)
        torque = 5.33e-2 * c - 1.545e-4 * w - 0.5 * m * 9.81 * d * abs(s) * math.tanh(d * w / CART_WIDTH)
        turn = (torque - m * d * d * s * math.cos(a) * w * w) / (1.21e-4 + m * d * d * s * s)
        return [w, turn, (u - 0.307 * c - 5.33e-2 * w) / 1.88e-4]

    assert one.sticks.count > 0
    item, threshold = Case(CART, padded([1.0], [0.0], 1), start, 0.5, CART_WIDTH, 0), float(one.method.threshold)
    _, end, passages = by_scipy(item, field, np.zeros(0), lambda y, _: 0.01 * y[1], threshold)
    np.testing.assert_allclose(one.final_state, end, atol=1e-5)
    for instant in np.concatenate([values[(values > 0) & (values < 0.5)] for values in sticks(one)[:2]]):
        assert np.min(np.abs(passages - instant)) < 1e-6


@pytest.mark.slow
def test_a_cart():
    start = (0.7, 0.0, 0.0)
    one = ss.simulate(CART, ss.SourceVoltage(0.0, 2.0, 10.0, phase=jnp.asarray(0.8)), y0=start, **CART_OPTIONS)
    assert_is_the_cart_of_scipy(one, 0.8, start)


@pytest.mark.slow
def test_carts():
    """Against scipy, and an ensemble against its samples."""
    y0, options = (ss.Uniform(0.3, 1.2), 0.0, 0.0), {"key": jax.random.key(2), "keep": "sticks", **CART_OPTIONS}
    many = ss.simulate_ensemble(CART, ss.RandomPhase(VOLTAGE), samples=4, chunk=2, y0=y0, **options)
    for number in range(4):
        _, base, start = many.realization(number)
        one = ss.simulate(CART, base, y0=start, **CART_OPTIONS)
        assert one.sticks.count > 0
        alone = sticks(one)
        alone[2] = np.mod(alone[2], 2 * math.pi)  # the angle, which is in [0, 2 pi) in ensembles
        for values, expected in zip(sticks(many, number), alone, strict=True):
            np.testing.assert_allclose(values, expected, atol=1e-6)
    assert_is_the_cart_of_scipy(one, float(base.phase), start)


@pytest.mark.slow
def test_no_adaptive_sample_depends_on_its_neighbours():
    """To the last bit: batches that are full, nearly empty, or made of other samples, in one thread or two."""
    system, law = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.1)), ss.PoissonSwitching(1.0, 1.0)
    method = ss.Regularized(1e-2, "tanh", max_steps=4096)
    options = {"t1": 10.0, "key": jax.random.key(4), "y0": (0.0, 0.5), "method": method, "keep": "sticks"}

    def times(samples, chunk, threads):
        many = ss.simulate_ensemble(system, law, samples=samples, chunk=chunk, threads=threads, **options)
        return many.totals.stick_time

    whole = times(80, None, 1)
    for samples, chunk, threads in ((80, None, 2), (80, 7, 2), (80, 1000, 1), (64, None, 1), (3, 1, 1)):
        np.testing.assert_array_equal(times(samples, chunk, threads), whole[:samples])
