"""Blocks that slide under earthquakes, rigid and of soil that vibrates: closed forms, events found without the package,
derivatives, and tables.
"""

import itertools
import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from support.scripts import loaded

import stickslip_jax as ss

G = 9.80665  # m/s^2
W = 2 * math.pi  # rad/s, of the harmonic ground motion
METHOD = ss.Exact(max_steps=8192)


def shaking():
    """Times of a record, and accelerations up the slope, m/s^2, that stand for recorded ones."""
    times = 0.02 * np.arange(251)
    source = np.random.default_rng(3)
    tones = source.normal(size=12) * np.sin(times[:, None] * source.uniform(3, 40, 12) + np.arange(12))
    return times, np.sum(tones, axis=1) * np.exp(-(((times - 2) / 1.5) ** 2))


@jax.jit
def slid(block, times, ground):
    """Displacement down the slope, m, under accelerations up the slope."""
    one = ss.simulate(block, ss.GroundAcceleration(times, -ground), t1=5.0, method=METHOD)
    return jnp.where(one.status == ss.Status.FINISHED, one.final_state[0], jnp.nan)


def pulses(*heights):
    """Rectangular pulses of 0.2 s, one a second, as a record with edges of 1e-12 s: times and accelerations."""
    edges = [0.5 + i + part for i in range(len(heights)) for part in (-1e-12, 1e-12, 0.2 - 1e-12, 0.2 + 1e-12)]
    values = [value for height in heights for value in (0.0, height, height, 0.0)]
    return np.array([0.0, *edges, 5.0]), np.array([0.0, *values, 0.0])


def newmark(height, above, duration=0.2):
    """``V^2 / (2 a_y) (1 - a_y / A)``: N. M. Newmark (1965), eq. for one rectangular pulse A of the velocity V."""
    return (height * duration) ** 2 / (2 * above) * (1 - above / height) if height > above else 0.0


@pytest.mark.parametrize("uphill", [None, pytest.param(0.15, marks=pytest.mark.slow)])
def test_rectangular_pulses(uphill):
    """Each moves the block as far as Newmark says, down or up, for it comes to rest before the next."""
    heights, down = (3.0, -4.0, 2.5, 0.5), 0.1 * G
    expected = sum(newmark(height, down) for height in heights)
    expected -= 0 if uphill is None else sum(newmark(-height, uphill * G) for height in heights)
    assert float(slid(ss.rigid_block(0.1, uphill=uphill), *pulses(*heights))) == pytest.approx(expected, abs=1e-10)


@pytest.mark.slow
def test_friction_on_a_slope_is_two_yields():
    """``mu cos(slope) -+ sin(slope)``."""
    slope, mu, heights = math.radians(10), 0.4, (5.0, -8.0, 4.0)
    yields = [G * (mu * math.cos(slope) + sign * math.sin(slope)) for sign in (-1, 1)]
    expected = sum(newmark(height, yields[0]) - newmark(-height, yields[1]) for height in heights)
    block = ss.rigid_block(friction=ss.Coulomb(mu), slope=slope, mass=3.0)
    assert float(slid(block, *pulses(*heights))) == pytest.approx(expected, abs=1e-10)
    level = ss.rigid_block(friction=ss.Coulomb(mu))
    assert (level.force, level.normal_force) == (None, G)


def half_sine(above):
    """How far a block slides under the ground acceleration ``g sin(W t)`` until it rests, m, and when it stops, s."""
    start = math.asin(above / G) / W
    lag = lambda t: G / W * (math.cos(W * start) - math.cos(W * t)) - above * (t - start)  # noqa: E731
    stop = brentq(lag, 0.25, 1, xtol=1e-15)
    area = G / W * (math.cos(W * start) * (stop - start) - (math.sin(W * stop) - math.sin(W * start)) / W)
    return area - above * (stop - start) ** 2 / 2, stop


@jax.jit
def slid_on_sine(block, t1):
    """Displacement down the slope, m, on a base that accelerates up it by ``g sin(W t)``."""
    base = ss.Harmonic(G / W, W, 0.0, offset=-G / W)
    one = ss.simulate(block, base, t1=t1, y0=(0.0, 0.0), method=ss.Exact(max_steps=2048, step=0.02))
    return one.final_state[0] + G / W * t1


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.6, 0.8])
def test_a_half_sine_and_many(share):
    """Of one direction; at these yields the block rests before the next half-sine begins to move it."""
    expected, stop = half_sine(share * G)
    assert stop < 1
    block = ss.rigid_block(share)
    assert float(slid_on_sine(block, 1.0)) == pytest.approx(expected, abs=1e-10)
    assert float(slid_on_sine(block, 4.0)) == pytest.approx(4 * expected, abs=1e-10)


@pytest.mark.slow
def test_harmonic_ground_with_two_yields():
    """In each period it slides down by the half-sine above one yield, and up by that above the other."""
    down, up = half_sine(0.6 * G)[0], half_sine(0.85 * G)[0]
    found = slid_on_sine(ss.rigid_block(0.6, uphill=0.85), 4.0)
    assert float(found) == pytest.approx(4 * (down - up), abs=1e-10)


@pytest.mark.parametrize(("period", "damping"), [(0.4, 0.15), pytest.param(0.1, 0.05, marks=pytest.mark.slow)])
def test_coupled_blocks_slide_as_events_say(period, damping):
    """The generalised mass and participation of Rathje and Bray, in matrix exponentials, without the package."""
    times, ground = shaking()
    expected = loaded("docs/validation_blocks.py").slide_coupled_by_events(times, ground, 0.05 * G, period, damping)
    found = slid(ss.coupled_block(0.05, period=period, damping_ratio=damping), times, ground)
    assert float(found) == pytest.approx(expected, abs=1e-9)
    assert expected > 0.01


def test_the_matrices_are_those_of_the_modes():
    """``x_i = s + M_i / L_i u_i`` makes the generalised masses, ``L_i`` beside M, diagonal."""
    block = ss.coupled_block(0.1, period=0.5, damping_ratio=0.1, modes=3, mass=2.0)
    odd = np.array([1, 3, 5])
    own, joint, w = np.full(3, 2.0 / 2), 2 * 2.0 / (odd * math.pi), 2 * math.pi * odd / 0.5
    generalised = np.block([[np.full((1, 1), 2.0), joint[None]], [joint[:, None], np.diag(own)]])
    to_positions = np.block([[np.ones((1, 1)), np.zeros((1, 3))], [np.ones((3, 1)), np.diag(own / joint)]])
    for matrix, of_modes in (
        (np.diag(block.mass), generalised),
        (block.stiffness, np.diag([0, *(own * w**2)])),
        (block.damping, np.diag([0, *(0.2 * own * w)])),
    ):
        np.testing.assert_allclose(to_positions.T @ matrix @ to_positions, of_modes, rtol=1e-13, atol=1e-12)
    np.testing.assert_allclose(to_positions @ [1, 0, 0, 0], np.ones(4))  # so that the ground pushes each by its mass


@pytest.mark.slow
def test_a_column_that_sticks_vibrates_freely():
    """``exp(-zeta w t)``, under no earthquake."""
    zeta, w, t1 = 0.08, 2 * math.pi / 0.5, 1.3
    block = ss.coupled_block(0.1, period=0.5, damping_ratio=zeta)
    one = ss.simulate(block, ss.Constant(0.0), t1=t1, y0=(0.0, 0.004, 0.0, 0.0), method=METHOD)
    damped = w * math.sqrt(1 - zeta**2)
    decay = math.exp(-zeta * w * t1)
    expected = 0.004 * decay * (math.cos(damped * t1) + zeta * w / damped * math.sin(damped * t1))
    assert float(one.final_state[1]) == pytest.approx(expected, abs=1e-12)
    assert abs(float(one.final_state[0])) < 1e-18


@pytest.mark.slow
def test_stiff_soil_slides_as_a_rigid_block():
    """The difference falls with the square of the period, by which the column gives way."""
    times = np.linspace(0, 5, 251)
    ground = 3.0 * np.sin(2 * np.pi * times) * np.exp(-(((times - 2) / 1) ** 2))
    rigid = float(slid(ss.rigid_block(0.1), times, ground))
    found = [slid(ss.coupled_block(0.1, period=T, damping_ratio=0.5), times, ground) for T in (0.4, 0.2, 0.1)]
    away = np.abs(np.array(found) - rigid)
    np.testing.assert_allclose(away[:-1] / away[1:], 4, atol=0.1)
    assert away[2] < 2e-2 * rigid


@pytest.mark.slow
def test_derivatives():
    """By the yield coefficient and the period of the soil, under jit, against central differences."""
    times, ground = shaking()

    @jax.jit
    def found(numbers):
        return slid(ss.coupled_block(numbers[0], period=numbers[1], damping_ratio=0.1), times, ground)

    at, h = jnp.array([0.05, 0.4]), 1e-6
    gradient = jax.jit(jax.jacfwd(found))(at)
    for number in range(2):
        step = h * np.eye(2)[number]
        difference = (found(at + step) - found(at - step)) / (2 * h)
        assert float(gradient[number]) == pytest.approx(float(difference), rel=1e-6)


@pytest.mark.slow
def test_the_equivalent_acceleration():
    """Base shear over mass of two modes, against SciPy; and its derivative by the period."""
    times, ground = shaking()
    period, zeta, shares = 0.3, 0.1, 8 / (math.pi * np.array([1.0, 3.0])) ** 2
    w = 2 * math.pi * np.array([1.0, 3.0]) / period

    def rates(t, y):
        a = np.interp(t, times, ground)
        return np.concatenate([y[2:], -a - 2 * zeta * w * y[2:] - w**2 * y[:2]])

    y = [np.zeros(4)]
    for begin, end in itertools.pairwise(times[:101]):  # between the corners of the record
        y.append(solve_ivp(rates, (begin, end), y[-1], method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1])
    y = np.array(y)
    total = -2 * zeta * w * y[:, 2:] - w**2 * y[:, :2]
    expected = (1 - np.sum(shares)) * ground[:101] + total @ shares

    def at(T, parts=1):
        record = ss.GroundAcceleration(times, ground)
        return ss.equivalent_acceleration(record, period=T, damping_ratio=zeta, modes=2, parts=parts)

    np.testing.assert_allclose(at(period).accelerations[:101], expected, atol=1e-10)
    finer = at(period, parts=3)
    np.testing.assert_allclose(finer.accelerations[::3], at(period).accelerations, atol=1e-12)
    np.testing.assert_allclose(finer.times[::3], times, atol=1e-14)
    slope = jax.jacfwd(lambda T: at(T).accelerations[100])(period)
    difference = (at(period + 1e-6).accelerations[100] - at(period - 1e-6).accelerations[100]) / 2e-6
    assert float(slope) == pytest.approx(float(difference), rel=1e-6)


@pytest.mark.slow
def test_decoupled_blocks_take_the_equivalent_acceleration():
    times, ground = shaking()
    record = ss.GroundAcceleration(times, ground)
    above = ss.equivalent_acceleration(record, period=0.02, damping_ratio=0.5)
    rigid, stiff = (ss.newmark_displacements([one], 0.05).values.item() for one in (record, above))
    assert stiff == pytest.approx(rigid, rel=2e-2)
    assert stiff != rigid


BLOCKS = {
    "rigid": ss.rigid_block,
    "both ways": partial(ss.rigid_block, uphill=0.08),
    "coupled": partial(ss.coupled_block, period=0.3, damping_ratio=0.1),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rigid", "both ways", "coupled"])
def test_tables_are_single_runs(kind):
    """Records of two lengths, scaled and turned round."""
    times, ground = shaking()
    rests = np.append(ground[:150], 0.0)  # after the end of a record the ground is at rest at once
    records = {
        "long": ss.GroundAcceleration(times, [*ground[:-1], 0.0]),
        "short": ss.GroundAcceleration(times[:151], rests),
    }
    scales, yields = [0.5, -1.0], [0.03, 0.06]
    table = ss.newmark_displacements(records, yields, scales=scales, block=BLOCKS[kind], rest=3.0)
    assert table.values.shape == (2, 2, 2)
    assert table.records == ("long", "short")
    for i, one in enumerate(records.values()):
        end = float(one.times[-1])
        padded = np.append(one.times, [end + 0.02, 9.0]), -np.append(one.accelerations, [0.0, 0.0])
        for j, scale in enumerate(scales):
            for k, above in enumerate(yields):
                motion = ss.GroundAcceleration(padded[0], scale * padded[1])
                alone = ss.simulate(BLOCKS[kind](above), motion, t1=8.0, method=METHOD)
                assert table.values[i, j, k] == pytest.approx(float(alone.final_state[0]), abs=1e-12)
    np.testing.assert_array_equal(table.median, np.median(table.values, axis=0))


@pytest.mark.slow
def test_tables_for_pandas():
    record = ss.GroundAcceleration([0.0, 0.3, 0.4], [3.0, 3.0, 0.0])
    table = ss.newmark_displacements({"pulse": record}, [0.1, 0.2, 0.5], scales=2.0).to_pandas()
    assert list(table.columns) == ["record", "scale", "yield_coefficient", "displacement_m"]
    assert table["record"].unique().tolist() == ["pulse"]
    assert np.all(np.diff(table["displacement_m"]) < 0)


COLUMN = {"period": 0.3, "damping_ratio": 0.1}
RECORD = ss.GroundAcceleration([0.0, 1.0], [1.0, 1.0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (ss.rigid_block, "Argument yield_coefficient or friction must say what the block holds, but neither was given"),
        (partial(ss.rigid_block, 0.1, friction=ss.Coulomb(0.1)), "both were given"),
        (partial(ss.rigid_block, -0.1), "Argument yield_coefficient must be positive"),
        (partial(ss.rigid_block, 0.1, slope=0.2), "Argument slope must be 0 beside a yield_coefficient"),
        (partial(ss.rigid_block, friction=ss.Coulomb(0.1), uphill=0.2), "Argument uphill must be None beside friction"),
        (partial(ss.rigid_block, friction=ss.Coulomb(0.1), slope=2.0), "Argument slope must be"),
        (partial(ss.rigid_block, 0.1, mass=0.0), "Argument mass must be positive"),
        (partial(ss.rigid_block, 0.1, gravity=0.0), "Argument gravity must be positive"),
        (partial(ss.coupled_block, 0.1, **COLUMN | {"period": 0.0}), "Argument period must be positive"),
        (partial(ss.coupled_block, 0.1, **COLUMN | {"damping_ratio": -0.1}), "Argument damping_ratio must be"),
        (partial(ss.coupled_block, 0.1, **COLUMN, modes=0), "Argument modes must be a whole number"),
        (partial(ss.equivalent_acceleration, RECORD, **COLUMN, parts=0), "Argument parts must be a whole number"),
        (partial(ss.newmark_displacements, [], 0.1), "Argument records must be a list of GroundAccelerations"),
        (partial(ss.newmark_displacements, [RECORD], 0.0), "Argument yield_coefficients must"),
        (partial(ss.newmark_displacements, [RECORD], 0.1, scales=np.nan), "Argument scales must"),
        (partial(ss.newmark_displacements, [RECORD], 0.1, rest=-1.0), "Argument rest must be zero or positive"),
    ],
)
def test_what_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
