"""How far the mass moves in the slip before a stick: from the end of the stick before, found from the base's motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.interval import padded

import stickslip_jax as ss

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1 / 1.1))
LAW = ss.PoissonSwitching(speed=1.0, rate=1.0)
T1, Y0 = 60.0, (0.1, 0.3)
STEPS = ss.Exact(step=0.05, max_steps=4096)


def columns(sticks) -> list[np.ndarray]:
    """Start, end, position and displacement of each stick."""
    mask = np.asarray(sticks.mask)
    return [np.asarray(getattr(sticks, name))[mask] for name in ("start", "end", "position", "slip_displacement")]


def displaced(base: ss.VelocitySteps, times: np.ndarray) -> np.ndarray:
    """How far the base has moved by then."""
    switches = np.concatenate([[0.0], np.cumsum(base.durations, dtype=float)])
    way = np.concatenate([[0.0], np.cumsum(np.asarray(base.durations, float) * base.velocities)])
    return np.interp(times, switches, way)


def expected(start, end, position, carried, x0: float) -> np.ndarray:
    """In a stick the mass goes with the base, `carried` so far; from its end to the next it slips."""
    assert len(start) > 10
    left_at = position + carried
    return position - np.concatenate([[x0], left_at[:-1]])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
@pytest.mark.parametrize(("dtype", "close"), [("float64", 1e-12), ("float32", 2e-5)])
def test_it_is_what_the_base_has_not_carried(dtype, close):
    with jax.enable_x64(dtype == "float64"):
        base = LAW.sample(jax.random.key(3), T1)
        start, end, position, got = columns(ss.simulate(SYSTEM, base, t1=T1, y0=Y0).sticks)
        carried = displaced(base, end) - displaced(base, start)
    assert got.dtype == dtype
    np.testing.assert_allclose(got, expected(start, end, position, carried, Y0[0]), rtol=0, atol=close * T1)


@pytest.mark.slow
def test_time_steps_find_the_same():
    base = LAW.sample(jax.random.key(3), T1)
    # Both coefficients given, as where friction drops below: compiled once for both.
    holding = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1 / 1.1, mu_static=1 / 1.1))
    whole, stepped = (
        columns(ss.simulate(system, base, t1=T1, y0=Y0, method=method).sticks)
        for system, method in ((SYSTEM, ss.Exact()), (holding, STEPS))
    )
    np.testing.assert_allclose(stepped, whole, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_force_drop_in_closed_form():
    """On a belt the slip arc is a circle about mu N / k, symmetric between its two points at the belt's velocity."""
    mu, mu_static, speed = 0.5, 0.8, 0.3
    system = ss.MassSpring(1.0, 4.0, 2.0, ss.Coulomb(mu, mu_static=mu_static))
    slots = len(LAW.sample(jax.random.key(3), T1).durations)
    one = ss.simulate(system, padded((T1,), (speed,), slots), t1=20.0, y0=(0.0, speed), method=STEPS)
    got = columns(one.sticks)[3]
    assert len(got) > 4
    np.testing.assert_allclose(got[1:], -2 * (mu_static - mu) * 2.0 / 4.0, rtol=1e-9)
    assert got[0] == 0  # it begins in a stick


@pytest.mark.slow
def test_regularized_dynamics_come_close():
    """Like ``w log(1/w)`` in the width: by 7.5 from one of these widths to the other, but for parts of order 1."""
    base = LAW.sample(jax.random.key(3), T1)
    exact, *smooth = (
        columns(ss.simulate(SYSTEM, base, t1=T1, y0=Y0, method=method).sticks)
        for method in (ss.Exact(), *(ss.Regularized(width, rtol=1e-9, max_steps=100_000) for width in (1e-3, 1e-4)))
    )
    assert len(exact[0]) == len(smooth[0][0]) == len(smooth[1][0]) > 3
    wide, narrow = (np.max(np.abs(found[3] - exact[3])) for found in smooth)
    assert 6 < wide / narrow < 10
    assert narrow < 5e-3


@pytest.mark.slow
def test_a_motor_turns_by_the_difference_of_its_angles():
    one = ss.simulate(ss.MotorCart(mu=0.5), ss.SourceVoltage(), t1=10.0, y0=(0.3, 0.0, 0.0))
    start, end, angle, got = columns(one.sticks)
    assert len(start) > 3
    left_at = np.asarray(one.evaluate(end)[0])
    np.testing.assert_allclose(got, angle - np.concatenate([[0.3], left_at[:-1]]), rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("method", [ss.Exact(), STEPS])
def test_derivatives_are_those_of_the_ends(method):
    """D displacement = d position - d (end of the stick before): the mass goes with a base that does not change."""
    base = LAW.sample(jax.random.key(3), T1)

    def found(mu):
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
        return ss.simulate(system, base, t1=T1, y0=Y0, method=method).sticks

    sticks, slopes = jax.jvp(found, (1 / 1.1,), (1.0,))
    mask = np.asarray(sticks.mask)
    start, end, position, got = (
        np.asarray(getattr(slopes, name))[mask] for name in ("start", "end", "position", "slip_displacement")
    )
    middle = (np.asarray(sticks.start) + np.asarray(sticks.end))[mask] / 2
    velocity = (displaced(base, middle + 1e-6) - displaced(base, middle - 1e-6)) / 2e-6
    left_at = position + velocity * (end - start)
    np.testing.assert_allclose(got, position - np.concatenate([[0.0], left_at[:-1]]), rtol=1e-6, atol=1e-6)
    back = jax.grad(lambda mu: jnp.nansum(found(mu).slip_displacement))(1 / 1.1)
    assert float(back) == pytest.approx(got.sum(), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"step": 4e-3}, {"rtol": 1e-6}])
def test_regularised_ensembles_hold_it(options):
    """In a stick the error of adaptive steps is round-off, and so is the choice of the next: programs that are compiled
    apart take other steps. They agree as well as the steps are asked to be exact.
    """
    method = ss.Regularized(1e-2, max_steps=16_384, **options)
    how = {"t1": 40.0, "y0": Y0, "method": method}
    many = ss.simulate_ensemble(SYSTEM, LAW, samples=3, key=jax.random.key(1), keep="sticks", **how)
    _, base, y0 = many.realization(2)
    one = ss.simulate(SYSTEM, base, **how | {"y0": y0})
    own = many.flat_sticks.sample == 2
    assert own.sum() > 3
    close = {"rtol": 0, "atol": options.get("rtol", 1e-8)}
    np.testing.assert_allclose(many.flat_sticks.slip_displacement[own], columns(one.sticks)[3], **close)


@pytest.mark.slow
def test_ensembles_and_their_tables_hold_it(tmp_path):
    many = ss.simulate_ensemble(SYSTEM, LAW, t1=T1, samples=300, key=jax.random.key(1), y0=Y0, keep="sticks")
    _, base, y0 = many.realization(17)
    one = ss.simulate(SYSTEM, base, t1=T1, y0=y0)
    own = many.flat_sticks.sample == 17
    np.testing.assert_allclose(many.flat_sticks.slip_displacement[own], columns(one.sticks)[3], rtol=0, atol=1e-11)
    dataset = many.to_xarray()
    assert dataset["stick_slip_displacement"].attrs["units"] == "m"
    np.testing.assert_array_equal(dataset["stick_slip_displacement"], many.flat_sticks.slip_displacement)
    lines = many.write_sticks(tmp_path / "sticks.csv").read_text().splitlines()
    at = lines[0].split(",").index("slip_displacement_m")
    assert float(lines[1].split(",")[at]) == many.flat_sticks.slip_displacement[0]
