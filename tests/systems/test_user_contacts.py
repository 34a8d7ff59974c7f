"""Systems of the user's own with several contacts, and with normal forces that depend on time or state."""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss
from stickslip_jax._systems.switched_system import check_motion

COUPLING = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])


class Blocks(ss.SwitchedSystem):
    """Three blocks in a row on the base. `static`: by how much static friction exceeds kinetic friction."""

    mu: float = 0.3
    weakening: float = 0.0
    static: float = 0.0
    contacts = 3

    @property
    def state_names(self):
        return (*(f"position {i} in m" for i in range(3)), *(f"velocity {i} in m/s" for i in range(3)))

    def rates(self, t, y, base, friction):
        x, v = jnp.stack(y[:3]), jnp.stack(y[3:])
        speed = jnp.abs(v - base.velocity)
        force = self.mu * friction / (1 + self.weakening * speed)
        return (*y[3:], *(-COUPLING @ x - COUPLING @ v / 10 - force))

    def relative_velocity(self, t, y, base):
        return tuple(v - base.velocity for v in y[3:])

    @property
    def static_ratio(self):
        return 1 + self.static * jnp.array([1.0, 1.1, 1.2])

    @property
    def shortest_time(self):
        return 2 * math.pi / 1.8


class Pressed(Blocks):
    """The normal force of each block; `law` makes it of the velocities of the blocks."""

    law: object = eqx.field(static=True, default=None)

    def normal_forces(self, t, y, base):
        return self.law(jnp.stack(y[3:]) - base.velocity)

    def rates(self, t, y, base, friction):
        return (*y[3:], *(-COUPLING @ jnp.stack(y[:3]) - self.mu * friction))


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [
        lambda v: 1 + 0.2 * jnp.sign(v),
        lambda v: jnp.where(v > 0, 1.2, 0.8),
        lambda v: 1 + 0.2 * (v[0] > v[1]) * jnp.ones(3),
    ],
)
def test_normal_forces_that_jump_with_the_direction_are_refused(law):
    """At once, as rates are: they would chatter there without an end."""
    with pytest.raises(
        ValueError, match=r"normal_forces of a Pressed must be smooth .* normal force number 0 jumps .* Directional"
    ):
        ss.simulate(Pressed(law=law), ss.Constant(0.0), t1=1.0, y0=START)


@pytest.mark.parametrize(
    "law",
    [lambda v: 1 + 0.2 * jnp.tanh(v), lambda v: 1 + 0.2 * jnp.abs(v), lambda v: jnp.maximum(0.5 + v, 0.0)],
)
def test_normal_forces_with_kinks_are_not_refused(law):
    check_motion(Pressed(law=law), START)


@pytest.mark.slow
def test_normal_forces_that_jump_where_a_contact_between_blocks_stops_are_refused():
    """At a velocity that is no number of the state: that of the other block, times the ratio of a gear."""

    class Geared(Pressed):
        def relative_velocity(self, t, y, base):
            return y[3] - 0.7 * y[4], y[4] - base.velocity, y[5] - base.velocity

        def normal_forces(self, t, y, base):
            return jnp.stack([1 + 0.2 * jnp.sign(y[3] - 0.7 * y[4]), 1.0, 1.0])

        def rates(self, t, y, base, friction):
            push = self.mu * jnp.stack([friction[0], friction[1] - 0.7 * friction[0], friction[2]])
            return (*y[3:], *(-COUPLING @ jnp.stack(y[:3]) - push))

    with pytest.raises(ValueError, match="normal_forces of a Geared must be smooth"):
        check_motion(Geared(), START)


START = (-1.0, 1.0, -1.0, -1.0, 1.0, 1.0)


def listed(one):
    mask = np.asarray(one.sticks.mask)
    contact = np.zeros(mask.shape) if one.sticks.contact is None else np.asarray(one.sticks.contact)
    columns = contact, np.asarray(one.sticks.start), np.asarray(one.sticks.end)
    return [column[mask] for column in columns]


@pytest.fixture(scope="module")
def one():
    return ss.simulate(Blocks(), ss.Constant(0.0), t1=12.0, y0=START)


@pytest.mark.slow
def test_three_blocks_on_the_floor(one):
    """Against an event-by-event integration at a relative tolerance of 1e-12."""
    contact, start, end = listed(one)
    np.testing.assert_array_equal(contact, [0, 2, 1, 0, 2])
    expected = [4.63544896516, 4.96043120202, 6.78298795467, 7.34343581525, 8.37062952656]
    np.testing.assert_allclose(start, expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(end[:2], [4.82994374361, 5.08551319834], rtol=0, atol=1e-10)
    expected = [0.202558662099, 0.412765621355, 0.531438212051]
    np.testing.assert_allclose(one.final_state[:3], expected, rtol=0, atol=1e-11)
    assert int(one.near_grazing_count) == 0
    assert one.of_contact(1).totals.sticks == 1


@pytest.mark.slow
def test_a_static_ratio_of_fields_under_smoothed_friction(one):
    """It is a number that JAX traces there. What sticks creeps by at most a width, 1e-3 m/s, for 12 s."""
    method = ss.Regularized(1e-3, step=0.02, threshold=2e-3, minimum_duration=0.05)
    smoothed = ss.simulate(one.system, one.base, t1=one.t1, y0=START, method=method)
    np.testing.assert_allclose(smoothed.final_state, one.final_state, rtol=0, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("weakening", [0.0, 0.8])
def test_as_a_linear_structure(weakening):
    """States, sticks and derivatives, on a moving base: static friction above kinetic, or friction that weakens."""

    def structure(mu):
        laws = [
            ss.VelocityWeakening(mu, weakening) if weakening else ss.Coulomb(mu, ratio * mu)
            for ratio in (1.3, 1.33, 1.36)
        ]
        contacts = tuple(ss.Contact.of_mass(i, 3, 1.0, law) for i, law in enumerate(laws))
        return ss.LinearStructure(np.ones(3), COUPLING, COUPLING / 10, contacts)

    def users(mu):
        return Blocks(mu=mu, weakening=weakening, static=0.0 if weakening else 0.3)

    def outcome(make, mu):
        method = ss.Exact(max_steps=2048)
        one = ss.simulate(make(mu), ss.Harmonic(0.4, 1.1), t1=15.0, y0=START, method=method)
        times = [jnp.where(one.sticks.mask, times, 0.0)[:6] for times in (one.sticks.start, one.sticks.end)]
        return jnp.concatenate([jnp.stack(one.final_state), *times])

    both = [jax.jvp(lambda mu, make=make: outcome(make, mu), (0.3,), (1.0,)) for make in (structure, users)]
    np.testing.assert_allclose(both[1][0], both[0][0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(both[1][1], both[0][1], rtol=1e-6, atol=1e-6)
    assert np.max(np.abs(both[0][1][:6])) > 0.1
    assert np.sum(both[0][0][6:12] > 0) >= 4


class Pad(ss.SwitchedSystem):
    """A mass on a belt under a spring-loaded pad, whose normal force ``load + slope position`` may lift it off."""

    load: float = 1.0
    slope: float = 0.6
    mu: float = 0.6
    static: float = 1.6
    contacts = 1

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        return y[1], -y[0] - self.mu * friction[0]

    def relative_velocity(self, t, y, base):
        return (y[1] - base.velocity,)

    def normal_forces(self, t, y, base):
        return (self.load + self.slope * y[0],)

    @property
    def static_ratio(self):
        return self.static

    @property
    def shortest_time(self):
        return 2 * math.pi


def pad_by_events(load, slope, mu, static, belt, start, t1):
    """Sticks and end state of a `Pad`, integrated by scipy from event to event."""
    t, y, sticks = 0.0, np.array(start, float), []
    mode = "open" if load + slope * y[0] <= 0 else np.sign(y[1] - belt)
    while t < t1:
        at_t, at_y, at_mode = t, y.copy(), mode

        def normal(x):
            return load + slope * x

        def rates(_, y, mode=at_mode):
            if mode == "stick":
                return [belt, 0.0]
            friction = 0.0 if mode == "open" else mode * mu * normal(y[0])
            return [y[1], -y[0] - friction]

        events = {
            "normal": lambda _, y: normal(y[0]),
            "velocity": lambda _, y, mode=at_mode: 1.0 if isinstance(mode, str) else mode * (y[1] - belt),
            "limit": lambda _, y, mode=at_mode: static * mu * normal(y[0]) - abs(y[0]) if mode == "stick" else 1.0,
        }
        for event, direction in zip(events.values(), (1.0 if mode == "open" else -1.0, -1.0, -1.0), strict=True):
            event.terminal, event.direction = True, direction
        done = solve_ivp(rates, (t, t1), y, method="DOP853", rtol=1e-12, atol=1e-13, events=list(events.values()))
        t, y = done.t[-1], done.y[:, -1]
        if mode == "stick":
            sticks.append((at_t, t))
            y[1] = belt
        found = [name for name, times in zip(events, done.t_events, strict=True) if len(times)]
        if not found:
            break
        if found[0] == "normal":
            mode = "open" if mode != "open" else float(np.sign(y[1] - belt))
        elif found[0] == "limit":
            mode = -float(np.sign(y[0]))
        else:
            holds = abs(y[0]) <= static * mu * normal(y[0])
            y[1] = belt
            mode = "stick" if holds else -float(np.sign(y[0]))
        assert (at_t, at_mode) != (t, mode), at_y
    return np.array(sticks), y


@pytest.mark.slow
@pytest.mark.parametrize("start", [(-4.0, 0.0), pytest.param((3.0, -1.5), marks=pytest.mark.slow)])
def test_a_pad_that_lifts_off(start):
    one = ss.simulate(Pad(), ss.Constant(0.3), t1=20.0, y0=start)
    expected, state = pad_by_events(1.0, 0.6, 0.6, 1.6, 0.3, start, 20.0)
    _, begin, end = listed(one)
    np.testing.assert_allclose(np.stack([begin, end], axis=-1), expected, rtol=0, atol=1e-8)
    np.testing.assert_allclose(one.final_state, state, rtol=0, atol=1e-8)
    assert len(expected) >= 1
    assert 1.0 + 0.6 * float(one.minimum("position")) < 0  # it does lift off


class AgeingPad(Pad):
    """A `Pad` whose sticks grow stronger, on a block without a spring."""

    grow: float = 0.2

    def rates(self, t, y, base, friction):
        return y[1], -self.mu * friction[0]

    def static_ratio_after(self, age):
        return 1.6 + self.grow * (1 - jnp.exp(-age))

    @property
    def static_ratio(self):
        return 1.0


@pytest.mark.parametrize(
    ("kind", "path"), [*itertools.product((Pad, AgeingPad), ("load", "slope", "start")), (AgeingPad, "grow")]
)
def test_what_depends_on_it_need_not_be_the_rates(kind, path):
    """The methods are tried before they are traced: also those that a number alone changes by which one differentiates.

    Under jit all is traced, and nothing tried: so it is differentiated without.
    """

    def tried(number):
        system = kind(**({} if path == "start" else {path: number}))
        system.check_code()
        system.check_code((number if path == "start" else -0.5, 0.0, *(0.0 for _ in system.memory.ages)))
        return number

    assert jax.jvp(tried, (0.3,), (1.0,)) == (0.3, 1.0)


@pytest.mark.slow
def test_derivative_of_a_pad_that_lifts_off():
    def end(slope):
        method = ss.Exact(max_steps=2048)
        one = ss.simulate(Pad(slope=slope), ss.Constant(0.3), t1=8.0, y0=(-4.0, 0.0), method=method)
        return jnp.stack(one.final_state)

    h = 1e-6
    expected = (end(0.6 + h) - end(0.6 - h)) / (2 * h)
    assert np.max(np.abs(expected)) > 1e-3
    np.testing.assert_allclose(jax.jacfwd(end)(0.6), expected, rtol=1e-6, atol=1e-7)


class Clamp(ss.SwitchedSystem):
    """A free block at rest on a floor at rest, clamped by an oscillator that lifts off."""

    contacts = 1

    @property
    def state_names(self):
        return "position in m", "velocity in m/s", "clamp in m", "clamp velocity in m/s"

    def rates(self, t, y, base, friction):
        return y[1], -0.3 * friction[0], y[3], -y[2]

    def relative_velocity(self, t, y, base):
        return (y[1] - base.velocity,)

    def normal_forces(self, t, y, base):
        return (y[2],)

    @property
    def shortest_time(self):
        return 2 * math.pi


@pytest.mark.slow
@pytest.mark.parametrize("phase", [0.0, math.pi])
def test_what_rests_sticks_while_it_is_clamped(phase):
    """No force is needed: a stick begins and ends with the normal force, which depends on the state, or on time."""
    users = ss.simulate(Clamp(), ss.Constant(0.0), t1=20.0, y0=(0.0, 0.0, math.cos(phase), 0.0))
    contact = ss.Contact((1.0,), ss.Harmonic(1.0, 1.0, phase), ss.Coulomb(0.3))
    built_in = ss.simulate(
        ss.LinearStructure((1.0,), (0.0,), contacts=(contact,)), ss.Constant(0.0), t1=20.0, y0=(0.0, 0.0)
    )
    closes, opens = (1.5, 0.5) if phase == 0 else (0.5, 1.5)
    turns = math.pi * 2 * np.arange(4)
    begin, end = turns + closes * math.pi, np.minimum(turns + opens * math.pi, 20.0)
    if phase == 0:
        begin = np.append(0.0, begin)[: len(end)]
    expected = np.stack([begin, end], axis=-1)[begin < 20.0]
    for one in (users, built_in):
        _, begin, end = listed(one)
        np.testing.assert_allclose(np.stack([begin, end], axis=-1), expected, rtol=0, atol=1e-8)
        np.testing.assert_allclose(one.final_state[:2], 0.0, rtol=0, atol=1e-20)
        assert int(one.status) == ss.Status.FINISHED


def bad(**methods):
    return type("Bad", (Blocks,), methods)()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: bad(contacts=0), "Argument contacts must be"),
        (
            lambda: bad(contacts=None, static_ratio=1.0, normal_forces=lambda *_: jnp.ones(1)),
            "normal_forces of a Bad must come with the number of its contacts",
        ),
        (lambda: bad(contacts=65), "Argument contacts must be"),
        (lambda: bad(contacts=2), r"Argument static_ratio must be one number or an array \(2,\)"),
        (
            lambda: bad(contacts=2, static_ratio=1.1),
            "relative_velocity of a Bad must return 2 numbers, one for each of its contacts",
        ),
        (
            lambda: bad(normal_forces=lambda *_: jnp.ones(2)),
            "normal_forces of a Bad must return 3 numbers, one for each of its contacts",
        ),
        (
            lambda: bad(rates=lambda self, t, y, base, f: (*y[3:], *(-(f**2)))),
            r"rates of a Bad must be affine in friction, a \+ b_0 friction\[0\]",
        ),
        (
            lambda: bad(rates=lambda self, t, y, base, f: (*y[3:], f[0], -f[1], -f[2])),
            r"friction\[0\] = 1 changes the rate of relative velocity number 0 by 1; turn its sign round",
        ),
        (
            lambda: bad(
                rates=lambda self, t, y, base, f: (*y[3:], -f[0] - f[2], -f[1] - f[2], -f[2]),
                relative_velocity=lambda self, t, y, base: (y[3], y[4], y[3] + y[4]),
            ),
            "no positive definite matrix",
        ),
        (lambda: bad(rates=lambda self, t, y, base, f: (*y[3:], *(-f), 0.0)), "must return a tuple of 6 numbers"),
        (lambda: bad(static_ratio=jnp.array([1.0, 0.5, 1.0])), "Argument static_ratio must be at least 1"),
    ],
)
@pytest.mark.usefixtures("annotations_unchecked")
def test_what_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        ss.simulate(make(), ss.Constant(0.1), t1=1.0, y0=START)


@pytest.mark.slow
def test_motion_that_ceases_to_be_unique_is_told():
    """Friction that drives itself more and more: the matrix of its effects is no longer positive definite after 1 s."""
    one = ss.simulate(
        bad(rates=lambda self, t, y, base, f: (*y[3:], *(-jnp.stack(y[:3]) - (1 - t) * f))),
        ss.Harmonic(0.3, 4.0), t1=5.0, y0=START,
    )  # fmt: skip
    assert int(one.status) == ss.Status.NOT_FINITE
    assert 1 <= float(one.time_reached) < 1 + Blocks().shortest_time / 48  # a step


@pytest.mark.slow
def test_what_is_not_there_for_several_contacts_is_told(one):
    with pytest.raises(ValueError, match="must have one contact"):
        one.energies(0.5)
    with pytest.raises(ValueError, match="must say whose sticks are counted"):
        ss.simulate_ensemble(
            Blocks(), ss.PoissonSwitching(1.0, 1.0), t1=1.0, y0=START, samples=2, key=jax.random.key(1)
        )
