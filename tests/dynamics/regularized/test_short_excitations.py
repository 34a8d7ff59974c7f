"""Adaptive steps see every short excitation: against scipy's Radau, which begins where the excitation does."""

import dataclasses
import itertools
import math
from functools import partial

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss
from stickslip_jax._dynamics.common.method import longest_step, step_for
from stickslip_jax._excitation.excitation import excitation_of

T1, OMEGA2, MU, NORMAL = 20.0, 4.0, 0.3, 1.2
SHAPES = ("bell", "wave", "half sine", "doublet", "burst")
PERIODS = (2.5, 2.0, 4.0, 3.0, 2.0)  # of each shape, in widths
REACH = 8.0  # in widths: where the longest shape has ended


class Pulse(ss.Signal):
    """A pulse of one of the `SHAPES` around `at`."""

    at: float
    width: float
    size: float
    shape: float = 0.0

    def value(self, t):
        s = (t - self.at) / self.width
        near, bell = jnp.clip(s, -1, 1), jnp.exp(-s * s)
        all_of_them = (
            bell, (1 + jnp.cos(math.pi * near)) / 2, jnp.cos(math.pi / 2 * near), s * bell, jnp.cos(3 * s) * bell,
        )  # fmt: skip
        return self.size * jnp.select([self.shape == i for i in range(len(SHAPES))], all_of_them)

    @property
    def shortest_period(self):
        return self.width * jnp.select([self.shape == i for i in range(len(SHAPES))], jnp.asarray(PERIODS))


class Unknown(ss.Signal):
    """A signal that does not tell its shortest period."""

    def value(self, t):
        return 0.5 * jnp.exp(-(((t - 37.3) / 0.02) ** 2))


def numbers_of(row, t):
    """The same pulse by NumPy: `row` is at, width, size, shape."""
    s = (t - row[0]) / row[1]
    near, bell = min(max(s, -1), 1), math.exp(-s * s)
    return row[2] * (
        bell, (1 + math.cos(math.pi * near)) / 2, math.cos(math.pi / 2 * near), s * bell, math.cos(3 * s) * bell,
    )[int(row[3])]  # fmt: skip


LAWS = {
    "LuGre": ss.LuGre(MU, 0.4, 0.1, 20.0, 1.0),
    "stiff LuGre": ss.LuGre(MU, 0.4, 0.1, 400.0, 1.0, 0.1),
    "ElastoPlastic": ss.ElastoPlastic(MU, 0.4, 0.1, 50.0, 0.5),
    "Dahl": ss.Dahl(MU, 20.0),
    "BoucWen": ss.BoucWen(MU, 50.0),
    "Coulomb": ss.Coulomb(MU),
}


def rate_of(name, z, v):
    """The rate of the inner state, and the friction coefficient."""
    law = LAWS[name]
    if name == "Coulomb":
        return 0.0, MU * min(max(v / 0.01, -1), 1)
    k = law.stiffness
    if name == "Dahl":
        return v * (1 - k * z * np.sign(v) / MU), k * z
    if name == "BoucWen":
        return v * (1 - (abs(z) * k / MU) ** 2 * (0.5 + 0.5 * np.sign(v * z))), k * z
    most = MU + 0.1 * math.exp(-((v / 0.1) ** 2))
    share = k * z * np.sign(v) / most
    alpha = 0.5 * (1 + math.sin(math.pi * min(max((share - 0.85) / 0.3, -0.5), 0.5))) if "Plastic" in name else 1
    bent = v * (1 - alpha * share)
    return bent, k * z + law.damping * bent + law.viscous * v


def by_radau(name, row, where):
    """The final position and the largest one, from rest."""

    def rates(t, y):
        base, force = (numbers_of(row, t), 0.0) if where == "base" else (0.0, numbers_of(row, t))
        bent, coefficient = rate_of(name, y[2], y[1] - base)
        return [y[1], force - OMEGA2 * y[0] - NORMAL * coefficient, bent]

    begin, end = max(row[0] - REACH * row[1], 0), row[0] + REACH * row[1]
    state, largest, final = np.zeros(3), 0.0, 0.0
    for first, last, longest in ((begin, min(end, T1), row[1] / 10), (min(end, T1), T1, math.inf)):
        if first < last:
            run = solve_ivp(rates, (first, last), state, "Radau", rtol=1e-7, atol=1e-11, max_step=longest)
            state, largest, final = run.y[:, -1], max(largest, np.max(np.abs(run.y[0]))), run.y[0, -1]
    return final, largest


# Coarse methods are not accurate; a motion that steps have passed over is wrong by all of it.
BOUND = {"default": 0.02, "accurate": 0.02, "explicit": 0.1, "fixed": 0.2}
METHODS = {
    "default": {},
    "accurate": {"rtol": 1e-7},
    "explicit": {"solver": diffrax.Tsit5()},
    "fixed": {"step": 0.003},
}


@partial(jax.jit, static_argnames=("name", "where", "how"))
def follow(rows, name, where, how):
    options = METHODS[how] | ({"width": 0.01} if name == "Coulomb" else {})

    def one(row):
        pulse = Pulse(*row)
        system = ss.MassSpring(1.0, OMEGA2, NORMAL, LAWS[name], force=pulse if where == "force" else None)
        base = pulse if where == "base" else ss.Constant(0.0)
        method = ss.Regularized(max_steps=2**14, **options)
        found = ss.simulate(system, base, t1=T1, method=method)
        return found.final_state[0], found.peak("position"), found.status

    return jax.vmap(one)(rows)


def drawn(seed, number, shortest):
    """Pulses (number, 4): place, width, size and shape."""
    source = np.random.default_rng(seed)
    width = 10 ** source.uniform(math.log10(shortest), -0.5, number)
    size = source.choice([-1.0, 1.0], number) * 10 ** source.uniform(0, 1, number)
    return np.stack([source.uniform(1, T1 - 1, number), width, size, source.integers(len(SHAPES), size=number)], 1)


def check(rows, name, where, how, bound):
    final, peak, status = map(np.asarray, follow(jnp.asarray(rows), name, where, how))
    assert np.all(status == ss.Status.FINISHED)
    expected = np.array([by_radau(name, row, where) for row in rows])
    assert np.min(expected[:, 1]) > 1e-4  # each of them moves the mass
    error = np.maximum(np.abs(final - expected[:, 0]), np.abs(peak - expected[:, 1])) / expected[:, 1]
    assert not {tuple(rows[i]): error[i] for i in np.flatnonzero(error > bound)}


@pytest.mark.slow
def test_a_few_short_excitations():
    check(drawn(1, 4, 0.1), "Dahl", "base", "default", 0.01)


GROUPS = [
    (name, where, how)
    for name in LAWS
    for where in ("base", "force")
    for how in (METHODS if name == "Coulomb" else ("default", "accurate"))
]
"""28 of them: 504 excitations."""


@pytest.mark.slow
@pytest.mark.parametrize("group", range(len(GROUPS)))
def test_short_excitations(group):
    name, where, how = GROUPS[group]
    check(drawn(100 + group, 18, 0.03 if how == "fixed" else 0.01), name, where, how, BOUND[how])


@pytest.mark.slow
def test_samples_with_pulses_of_their_own():
    """Each in its own steps: the sticks of an ensemble are those of simulations. All pulses slip further than bristles
    bend.
    """
    at, width = np.array([5.0, 11.0, 17.0]), np.array([0.02, 0.3, 0.05])
    system, method = ss.MassSpring(1.0, 4.0, 1.0, ss.Dahl(0.3, 20.0)), ss.Regularized(max_steps=4096)
    many = ss.simulate_ensemble(
        system, Pulse(at, width, 2.0), t1=T1, samples=3, key=jax.random.key(0), method=method, keep="sticks"
    )
    for i in range(3):
        one = ss.simulate(system, Pulse(float(at[i]), float(width[i]), 2.0), t1=T1, method=method)
        starts, ends = (
            np.asarray(column)[np.asarray(one.sticks.mask)] for column in (one.sticks.start, one.sticks.end)
        )
        found = np.asarray(many.sticks.start)[i]
        np.testing.assert_allclose(found[~np.isnan(found)], starts, atol=1e-5)
        assert abs(ends[0] - at[i]) < 4 * width[i]  # the pulse ends the first


CLOSES, LASTS, PRESS, BELT = 7.3, 0.02, 40.0, 2.0
CLOSINGS = {
    "signal": (lambda: Pulse(CLOSES, LASTS, PRESS), lambda t: PRESS * math.exp(-(((t - CLOSES) / LASTS) ** 2))),
    "steps": (
        lambda: ss.ForceSteps([0.0, CLOSES, CLOSES + LASTS], [-1.0, PRESS, -1.0]),
        lambda t: PRESS if CLOSES <= t <= CLOSES + LASTS else 0.0,
    ),
    "record": (
        lambda: ss.Recorded([0.0, CLOSES - LASTS, CLOSES, CLOSES + LASTS, T1], [0.0, 0.0, PRESS, 0.0, 0.0]),
        lambda t: PRESS * max(1 - abs(t - CLOSES) / LASTS, 0.0),
    ),
}


QUICK = [("exact", "signal", True), ("exact", "signal", False), ("LuGre", "steps", True)]
ALL = [
    (name, load, x64) for name in ("Coulomb", "exact", "Dahl", "LuGre") for load in CLOSINGS for x64 in (True, False)
]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
@pytest.mark.parametrize(
    ("name", "load", "x64"), [*QUICK, *(pytest.param(*one, marks=pytest.mark.slow) for one in ALL if one not in QUICK)]
)
def test_short_closings_of_a_contact(name, load, x64):
    """A belt that touches the mass for a moment pushes it as scipy says that it does, in steps that end at the jumps.

    The belt is so fast that the mass slips back all the time, with friction of one sign.
    """
    normal_force, newtons = CLOSINGS[load]
    law = ss.Dahl(MU, 2000.0) if name == "Dahl" else LAWS["Coulomb" if name == "exact" else name]
    rules = {"threshold": 0.01} | ({"width": 0.01} if name == "Coulomb" else {})
    with jax.enable_x64(x64):
        method = ss.Exact() if name == "exact" else ss.Regularized(max_steps=2**14, minimum_duration=0.1, **rules)
        system = ss.MassSpring(1.0, OMEGA2, normal_force(), law)
        one = ss.simulate(system, ss.Constant(BELT), t1=T1, method=method)
    assert int(one.status) == ss.Status.FINISHED

    def rates(t, y):
        slip = y[1] - BELT
        if name == "Dahl":
            bent, coefficient = slip * (1 + 2000.0 * y[2] / MU), 2000.0 * y[2]
        else:
            bent, coefficient = rate_of("LuGre" if name == "LuGre" else "Coulomb", y[2], slip)
        return [y[1], -OMEGA2 * y[0] - newtons(t) * coefficient, bent]

    if load == "record":
        ends = [0.0, CLOSES - LASTS, CLOSES, CLOSES + LASTS, T1]
    else:
        ends = (
            [0.0, CLOSES, CLOSES + LASTS, T1] if load == "steps" else [0.0, CLOSES - 8 * LASTS, CLOSES + 8 * LASTS, T1]
        )
    state = np.zeros(3)
    for first, last in itertools.pairwise(ends):
        step = LASTS / 20 if last - first < 1 else math.inf
        inside = (first + 1e-9, last - 1e-9)  # a jump is not asked for from its other side
        run = solve_ivp(rates, inside, state, "Radau", rtol=1e-9, atol=1e-12, max_step=step)
        state = run.y[:, -1]
    assert abs(state[0]) > 1e-3
    found = np.array([float(value) for value in one.final_state[:2]])
    bound = {"exact": 1e-7 if x64 else 1e-5}.get(name, 0.01)
    assert np.max(np.abs(found - state[:2])) < bound * np.max(np.abs(state[:2]))


class Driven(ss.SwitchedSystem):
    """A mass on a spring of one's own."""

    pushed: bool = eqx.field(static=True, default=False)
    force: ss.Signal | None = None
    record: ss.Recorded | None = None
    state_names = ("position in m", "velocity in m/s")
    shortest_time = 3.0

    def rates(self, t, y, base, friction):
        push = jnp.exp(-(((t - 9.0) / 0.3) ** 2)) if self.pushed else 0.0
        push = push if self.record is None else push + self.record.value(t)
        push = push if self.force is None else push + self.force.value(t)
        return y[1], push - OMEGA2 * y[0] - MU * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity


class Nameless(Driven):
    """It does not tell its shortest time."""

    shortest_time = None


class Pressed(ss.SwitchedSystem):
    """A mass that its spring presses on a contact, in one direction."""

    contacts = 1
    state_names = ("position in m", "velocity in m/s", "height in m", "its rate in m/s")
    shortest_time = 2.0

    def rates(self, t, y, base, friction):
        return y[1], -OMEGA2 * y[0] - MU * friction[0], y[3], -y[2]

    def relative_velocity(self, t, y, base):
        return (y[1] - base.velocity,)

    def normal_forces(self, t, y, base):
        return (y[2],)


OSCILLATOR = ss.MassSpring(1.0, OMEGA2, NORMAL, ss.Coulomb(MU))
PULSE, TONE, RECORD = Pulse(5.0, 0.02, 1.0), ss.Harmonic(1.0, 5.0), ss.Recorded([0.0, 1.0, 50.0], [0.0, 1.0, 0.0])
STILL, OF_PULSE, OF_TONE = ss.Constant(0.0), 2.5 * 0.02, 2 * math.pi / 5
TWO = ss.block_row(2, mass=1.0, between=1.0, to_ground=1.0, normal_force=1.0, friction=ss.Coulomb(0.3))


@pytest.mark.parametrize(
    ("system", "base", "period"),
    [
        (OSCILLATOR, PULSE, OF_PULSE),
        (OSCILLATOR, ss.WithJumps(PULSE, ss.PoissonSwitching(1.0, 1.0)), OF_PULSE),
        (OSCILLATOR, ss.RandomPhase(TONE), OF_TONE),
        (dataclasses.replace(OSCILLATOR, force=PULSE), TONE, OF_PULSE),
        (
            dataclasses.replace(OSCILLATOR, mass=1e-9, force=RECORD),
            RECORD,
            math.inf,
        ),  # steps end at points; its own motion it sees
        (dataclasses.replace(OSCILLATOR, normal_force=ss.Harmonic(0.2, 5.0, offset=1.0)), STILL, OF_TONE),
        (dataclasses.replace(OSCILLATOR, friction=LAWS["LuGre"], force=TONE), PULSE, OF_PULSE),
        (TWO, PULSE, OF_PULSE),
        (ss.LinearStructure(TWO.mass, TWO.stiffness, None, TWO.contacts, force=(PULSE, None)), TONE, OF_PULSE),
        (ss.MotorCart(mu=0.2), ss.SourceVoltage(8.0, 4.0, 10.0), 2 * math.pi / 10),
        (Driven(), TONE, OF_TONE),
        (Driven(), STILL, math.inf),
        (Driven(record=RECORD), STILL, math.inf),
        (Nameless(record=RECORD), STILL, math.inf),
        (Driven(pushed=True), STILL, 3.0),
        (Driven(force=PULSE), STILL, OF_PULSE),
        (Pressed(), STILL, 2.0),
    ],
)
def test_what_bounds_adaptive_steps(system, base, period):
    assert float(longest_step(system, excitation_of(base))) == pytest.approx(period / 4, rel=1e-12)


def test_signals_in_fields_bound_exact_steps_too():
    assert step_for(Driven(force=PULSE), excitation_of(STILL), ss.Exact()) == pytest.approx(OF_PULSE / 48, rel=1e-12)


@pytest.mark.parametrize(
    ("system", "base", "what", "how"),
    [
        (OSCILLATOR, Unknown(), "base motion", ", or choose a fixed step, Regularized(width, step=...)."),
        (
            dataclasses.replace(OSCILLATOR, force=Unknown()),
            STILL,
            "force",
            ", or choose a fixed step, Regularized(width, step=...).",
        ),
        (dataclasses.replace(OSCILLATOR, friction=LAWS["Dahl"]), Unknown(), "base motion", "."),
        (Nameless(pushed=True), STILL, "system", ", or choose a fixed step, Regularized(width, step=...)."),
    ],
)
def test_periods_that_are_not_known(system, base, what, how):
    name, prop = (
        ("shortest time of the", "shortest_time") if what == "system" else ("shortest period of the", "shortest_period")
    )
    with pytest.raises(
        ValueError, match=rf"\AArgument method must not .* while the {name} {what} is not known"
    ) as caught:
        longest_step(system, excitation_of(base))
    assert str(caught.value).endswith(f"give what you wrote a property {prop} (s){how}")
