"""`calibrate`: numbers of a system from a record of motion, against linear regression, known truths and repeats."""

import math
import re
from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy import stats

import stickslip_jax as ss

TIMES = np.linspace(0, 20, 401)
BASE = ss.SquareWave(0.5, 5.0)


def oscillator(mu=0.7, stiffness=4.0, **numbers):
    return ss.MassSpring(1.0, stiffness, 1.0, ss.Coulomb(mu, **numbers))


def record(system, base, times=TIMES, y0=(0.3, 0.1), share=0.01, seed=0, method=None):
    """Positions with noise of a `share` of their standard deviation, and that of the noise."""
    one = ss.simulate(system, base, t1=float(times[-1]), y0=y0, method=method or ss.Exact())
    assert int(one.status) == ss.Status.FINISHED
    position = np.asarray(one.evaluate(times)[0])
    noise = share * position.std()
    return position + noise * np.random.default_rng(seed).normal(size=len(times)), noise


@pytest.fixture(scope="module")
def found():
    seen, noise = record(oscillator(), BASE)
    return ss.calibrate(oscillator(0.6, 3.6), BASE, TIMES, {"position": seen}, wrt=("mu", "stiffness")), noise


@pytest.mark.slow
def test_friction_of_a_slip_as_by_linear_regression():
    """A mass that slips in one direction: x = -mu n / k + a cos + b sin, linear in what is estimated."""
    true, fast = oscillator(0.7), ss.Constant(50.0)
    times = np.sort(np.random.default_rng(3).uniform(0, 15, 300))
    seen, _ = record(true, fast, times)
    found = ss.calibrate(oscillator(0.5), fast, times, {"position": seen}, wrt="mu")
    columns = np.stack([np.ones_like(times), np.cos(2 * times), np.sin(2 * times)], axis=1)
    best, squares, *_ = np.linalg.lstsq(columns, seen, rcond=None)
    variance = squares[0] / (len(times) - 3)
    error = np.sqrt(variance * np.linalg.inv(columns.T @ columns)[0, 0])
    assert found.windows == 1
    clean = ss.calibrate(oscillator(0.5), fast, times, {"position": columns @ best}, wrt="mu")
    assert not clean.remarks  # what is left without noise is not white
    np.testing.assert_allclose(clean["mu"].value, best[0] * 4.0, rtol=1e-5)
    np.testing.assert_allclose(found["mu"].value, best[0] * 4.0, rtol=1e-7)
    np.testing.assert_allclose(found["mu"].standard_error, error * 4.0, rtol=1e-6)
    np.testing.assert_allclose(found.noise["position"], math.sqrt(variance), rtol=1e-6)
    assert found.degrees_of_freedom == len(times) - 3
    # The state at the first measurement, and its error.
    at = np.stack([np.ones(1), np.cos(2 * times[:1]), np.sin(2 * times[:1])], axis=1)[0]
    np.testing.assert_allclose(found.start["position"].value, at @ best, rtol=1e-6)
    spread = np.sqrt(variance * at @ np.linalg.inv(columns.T @ columns) @ at)
    np.testing.assert_allclose(found.start["position"].standard_error, spread, rtol=1e-5)


@pytest.mark.slow
def test_twenty_seconds_with_one_per_cent_of_noise(found):
    found, noise = found
    assert found.converged
    assert found.windows == 1
    assert not found.remarks
    for name, truth in (("mu", 0.7), ("stiffness", 4.0)):
        assert abs(found[name].value - truth) < 3 * found[name].standard_error < 0.02 * truth
    assert found["stiffness"].unit == "N/m"
    # The variance of the residuals over that of the noise: chi-squared over its degrees of freedom.
    ratio = (found.noise["position"] / noise) ** 2
    assert abs(ratio - 1) < 4 * math.sqrt(2 / found.degrees_of_freedom)
    assert found.whiteness["position"].p_value > 0.01
    np.testing.assert_allclose(found.residuals, found.measured - found.fitted)


@pytest.mark.slow
def test_result_knows_its_system_and_correlations(found):
    found, _ = found
    again = ss.simulate(found.system, found.base, t1=20.0, y0=tuple(found.start_states[0]))
    np.testing.assert_allclose(again.evaluate(TIMES)[0], found.fitted[0], atol=1e-9)
    sizes = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(sizes, [one.standard_error for one in found.estimates.values()])
    ratio = found["mu"] / found["stiffness"]
    slope = np.array([1 / found["stiffness"].value, -found["mu"].value / found["stiffness"].value ** 2])
    np.testing.assert_allclose(ratio.standard_error, math.sqrt(slope @ found.covariance @ slope), rtol=1e-10)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance_by_blocks)), sizes, rtol=0.6)


@pytest.mark.slow
def test_windows_and_one_motion_agree(found):
    found, noise = found
    seen, _ = record(oscillator(), BASE)
    parts = ss.calibrate(
        oscillator(0.6, 3.6), BASE, TIMES, {"position": seen}, wrt=("mu", "stiffness"), windows=4,
        noise={"position": noise},
    )  # fmt: skip
    assert parts.windows == 4
    assert parts.start is None
    for name in ("mu", "stiffness"):
        # Windows know less: their error contains that of one motion.
        spread = math.sqrt(parts[name].standard_error ** 2 - found[name].standard_error ** 2)
        assert abs(parts[name].value - found[name].value) < 4 * spread
    assert abs(parts.chi_squared - parts.degrees_of_freedom) < 4 * math.sqrt(2 * parts.degrees_of_freedom)


@pytest.mark.slow
def test_gaps_several_channels_and_their_noise():
    times = np.sort(np.random.default_rng(5).uniform(0.5, 20, 600))
    times = times[(times < 6) | (times > 9)]
    one = ss.simulate(oscillator(), BASE, t1=float(times[-1]), y0=(0.3, 0.1))
    rng = np.random.default_rng(8)
    position, velocity = (np.array(values) for values in one.evaluate(times))
    force = np.array(one.friction_force(times))
    sizes = {"position": 0.003, "velocity": 0.02, "friction force": 0.05}
    clean = {"position": position, "velocity": velocity, "friction force": force}
    seen = {name: values + sizes[name] * rng.normal(size=len(times)) for name, values in clean.items()}
    seen["position"][::3] = np.nan
    seen["velocity"][100:200] = np.nan
    jumps = np.append(one.sticks.start[one.sticks.mask], one.sticks.end[one.sticks.mask])
    jumps = np.concatenate([jumps, times[1:][np.abs(np.diff(force)) > 0.5]])
    seen["friction force"][np.min(np.abs(times[:, None] - jumps), axis=1) < 0.05] = np.nan
    found = ss.calibrate(
        oscillator(0.6, 3.6), BASE, times, seen, wrt=("mu", "stiffness", "mass"), noise={"velocity": 0.02}
    )
    for name, truth in (("mu", 0.7), ("stiffness", 4.0), ("mass", 1.0)):
        assert abs(found[name].value - truth) < 4 * found[name].standard_error < 0.05 * truth
    assert found.noise["velocity"] == 0.02
    assert found.noise_is_known == {"position": False, "velocity": True, "friction force": False}
    for name in ("position", "friction force"):
        number = np.count_nonzero(np.isfinite(seen[name])) - 5
        assert abs((found.noise[name] / sizes[name]) ** 2 - 1) < 4 * math.sqrt(2 / number)
    whole = np.stack(list(seen.values()))
    assert np.array_equal(np.isnan(found.fitted), np.isnan(whole[:, np.isin(times, found.times)]))


@pytest.mark.slow
def test_asymmetric_friction():
    both = ss.Directional(ss.Coulomb(0.7), ss.Coulomb(0.5))
    seen, _ = record(ss.MassSpring(1.0, 4.0, 1.0, both), BASE)
    guess = ss.MassSpring(1.0, 4.0, 1.0, ss.Directional(ss.Coulomb(0.6), ss.Coulomb(0.6)))
    found = ss.calibrate(guess, BASE, TIMES, {"position": seen}, wrt=("forward.mu", "backward.mu"))
    for name, truth in (("forward.mu", 0.7), ("backward.mu", 0.5)):
        assert abs(found[name].value - truth) < 4 * found[name].standard_error < 0.01


@pytest.mark.slow
def test_acceleration_from_a_known_start():
    """A mass that slips in one direction, so that no acceleration jumps; it starts 0.3 m + mu n / k from its rest."""
    fast = ss.Constant(50.0)
    position = np.asarray(ss.simulate(oscillator(), fast, t1=20.0, y0=(0.3, 0.1)).evaluate(TIMES)[0])
    seen = 0.7 - 4.0 * position + 0.02 * np.random.default_rng(2).normal(size=len(TIMES))
    found = ss.calibrate(
        oscillator(0.6, 3.8), fast, TIMES, {"acceleration": seen}, wrt=("mu", "stiffness"), y0=(0.3, 0.1), windows=1
    )
    for name, truth in (("mu", 0.7), ("stiffness", 4.0)):
        assert abs(found[name].value - truth) < 4 * found[name].standard_error < 0.02
    assert abs(found.noise["acceleration"] / 0.02 - 1) < 4 / math.sqrt(2 * 400)


@pytest.mark.slow
def test_a_mass_that_never_slips_tells_a_bound():
    """It needs the friction coefficient |m a + k x| / n, at most 0.3 (4 - 1.3^2) / 1.3 = 0.5331."""
    base = ss.Harmonic(0.3, 1.3)
    seen, noise = record(oscillator(5.0), base, y0=(0.0, 0.3))
    with pytest.warns(RuntimeWarning, match="so the record does not tell it: it is at least 0.5"):
        found = ss.calibrate(
            oscillator(3.0), base, TIMES, {"position": seen}, wrt="mu", y0=(0.0, 0.3), noise={"position": noise}
        )
    needed = 0.3 * (4 - 1.3**2) / 1.3
    low, high = found.bounds["mu"]
    assert high is None
    assert 0.97 * needed < low < needed
    assert math.isinf(found["mu"].standard_error)
    assert found["mu"].interval() == (-math.inf, math.inf)
    assert re.search(r"\n  mu = 3(\.\d+)? \(not determined\)\n", repr(found))
    assert len(found.remarks) == 1
    # There the record is contradicted as much as the level says: chi-squared has grown by 2.706.
    errors = [
        np.sum(((seen - np.asarray(ss.simulate(oscillator(mu), base, t1=20.0, y0=(0.0, 0.3)).evaluate(TIMES)[0]))
                / noise) ** 2)
        for mu in (1.0, low)
    ]  # fmt: skip
    assert abs(errors[1] - errors[0] - stats.chi2.ppf(0.9, 1)) < 0.1


@pytest.mark.slow
def test_numbers_that_act_together_are_told(found):
    seen, _ = record(oscillator(), BASE)
    with pytest.warns(RuntimeWarning, match="The record does not tell these apart"):
        both = ss.calibrate(oscillator(0.6), BASE, TIMES, {"position": seen}, wrt=("mu", "normal_force"))
    (remark,) = both.remarks
    assert re.search(r"apart: changing mu by [+-]100 %, normal_force by [+-]100 %", remark)
    assert math.isinf(both["mu"].standard_error)
    assert math.isinf((2 * both["mu"]).standard_error)
    assert math.isnan((both["mu"] * both["normal_force"]).standard_error)  # which may well be determined
    assert not both.bounds
    np.testing.assert_allclose(both["mu"].value * both["normal_force"].value, 0.7, rtol=0.01)


@pytest.mark.slow
def test_static_friction_in_windows_that_begin_in_sticks():
    """A motion that starts in a stick must start there exactly, or static friction would not hold it."""
    true, belt = oscillator(0.4, mu_static=1.7), ss.Constant(0.3)
    times = np.linspace(0, 30, 601)
    seen, _ = record(true, belt, times, y0=(0.0, 0.3))
    guess = oscillator(0.45, mu_static=1.5)
    found = ss.calibrate(guess, ss.Constant(0.35), times, {"position": seen}, wrt=("mu", "mu_static", "speed"))
    for name, truth in (("mu", 0.4), ("mu_static", 1.7), ("speed", 0.3)):
        assert abs(found[name].value - truth) < 4 * found[name].standard_error < 0.05
    assert found.windows == 1


@pytest.mark.slow
def test_own_channels_and_residuals_that_are_not_white():
    """What a sensor with a lag sees, fitted as if it had none, and with it."""
    one = ss.simulate(oscillator(), BASE, t1=20.0, y0=(0.3, 0.1))
    times, lag = TIMES[10:], 0.05
    seen = np.asarray(one.evaluate(times - lag)[0]) + 0.002 * np.random.default_rng(4).normal(size=len(times))
    known = {"wrt": "mu", "y0": (0.3, 0.1), "windows": 1}
    with pytest.warns(RuntimeWarning):
        plain = ss.calibrate(oscillator(0.6), BASE, times, {"position": seen}, noise={"position": 0.002}, **known)
    assert plain.whiteness["position"].p_value < 1e-6
    assert any("not white" in remark for remark in plain.remarks)
    assert any("larger than the given noise" in remark for remark in plain.remarks)
    assert any("clock.delay, about 0.049 s, would lower chi-squared" in remark for remark in plain.remarks)
    found = ss.calibrate(
        oscillator(0.6), BASE, times, {"late": seen}, noise={"late": 0.002},
        observe={"late": lambda one, t: one.evaluate(t - lag)[0]}, **known,
    )  # fmt: skip
    assert abs(found["mu"].value - 0.7) < 4 * found["mu"].standard_error < 0.01
    assert found.whiteness["late"].p_value > 0.01


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # remarks of a few of so many records
@pytest.mark.parametrize("kind", ["one friction coefficient", "asymmetric friction"])
def test_coverage(kind):
    """Of 200 data sets each, the 95 % intervals hold the truth in 92 to 98 %."""
    if kind == "asymmetric friction":
        pair = lambda a, b, k: ss.MassSpring(1.0, k, 1.0, ss.Directional(ss.Coulomb(a), ss.Coulomb(b)))  # noqa: E731
        true, guess = pair(0.7, 0.5, 4.0), pair(0.6, 0.6, 3.6)
        truth = {"forward.mu": 0.7, "backward.mu": 0.5, "stiffness": 4.0}
    else:
        true, guess, truth = oscillator(), oscillator(0.6, 3.6), {"mu": 0.7, "stiffness": 4.0}
    position = np.asarray(ss.simulate(true, BASE, t1=20.0, y0=(0.3, 0.1)).evaluate(TIMES)[0])
    rng, held, whole = np.random.default_rng(1), dict.fromkeys(truth, 0), 0
    for _ in range(200):
        seen = position + 0.01 * position.std() * rng.normal(size=len(TIMES))
        found = ss.calibrate(guess, BASE, TIMES, {"position": seen}, wrt=tuple(truth))
        whole += found.windows == 1
        for name, value in truth.items():
            low, high = found[name].interval()
            held[name] += low <= value <= high
    assert whole >= 198
    assert all(184 <= number <= 196 for number in held.values()), held


@pytest.mark.slow
def test_motor_and_cart_from_its_current():
    times = np.linspace(0, 2, 1001)
    true, guess, voltage = ss.MotorCart(mu=0.3), ss.MotorCart(mu=0.2, resistance=0.4), ss.SourceVoltage()
    one = ss.simulate(true, voltage, t1=2.0)
    rng = np.random.default_rng(0)
    clean = {"angle": np.array(one.evaluate(times)[0]), "current": np.array(one.evaluate(times)[2])}
    seen = {name: values + 0.01 * values.std() * rng.normal(size=len(times)) for name, values in clean.items()}
    found = ss.calibrate(guess, voltage, times, seen, wrt=("mu", "resistance"))
    assert found.windows == 1
    for name, truth in (("mu", 0.3), ("resistance", 0.307)):
        assert abs(found[name].value - truth) < 4 * found[name].standard_error < 0.01 * truth


@pytest.mark.slow
def test_two_coupled_blocks_whose_motion_depends_on_everything():
    def blocks(first, second, static):
        row = ss.block_row(
            2, mass=1.0, between=1.2, to_ground=1.0, normal_force=1.0, friction=ss.Coulomb(0.5, mu_static=static)
        )
        contacts = row.contacts
        laws = [ss.Coulomb(mu, mu_static=static) for mu in (first, second)]
        return replace(row, contacts=tuple(replace(c, friction=law) for c, law in zip(contacts, laws, strict=True)))

    times, belt = np.linspace(0, 60, 1201), ss.Constant(0.15)
    one = ss.simulate(blocks(0.5, 0.55, 1.0), belt, t1=60.0, y0=(0.3, 0.1, 0.0, 0.0))
    rng = np.random.default_rng(0)
    seen = {f"position {i}": np.asarray(one.evaluate(times)[i]) + 0.003 * rng.normal(size=len(times)) for i in (0, 1)}
    names = [f"contacts[{i}].friction.{kind}" for kind in ("mu", "mu_static") for i in (0, 1)]
    found = ss.calibrate(blocks(0.45, 0.45, 0.9), belt, times, seen, wrt=names)
    for name, truth in zip(names, (0.5, 0.55, 1.0, 1.0), strict=True):
        assert abs(found[name].value - truth) < 4 * found[name].standard_error < 0.02


@pytest.mark.slow
def test_law_with_an_inner_state():
    def bristles(mu):
        law = ss.LuGre(mu=mu, mu_static=0.84, stribeck_speed=0.1, stiffness=100.0, damping=1.0)
        return ss.MassSpring(1.0, 4.0, 1.0, law)

    times, base = np.linspace(0, 10, 301), ss.Harmonic(0.8, 1.3)
    seen, _ = record(bristles(0.6), base, times, method=ss.Regularized())
    found = ss.calibrate(
        bristles(0.5), base, times, {"position": seen}, wrt="mu", y0=(0.3, 0.1), method=ss.Regularized()
    )
    assert abs(found["mu"].value - 0.6) < 4 * found["mu"].standard_error < 0.02


GOOD = {"system": oscillator(), "base": BASE, "times": TIMES, "measured": {"position": TIMES}, "wrt": "mu"}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"times": TIMES[::-1]}, "Argument times must be"),
        ({"times": [0.0]}, "Argument times must be"),
        ({"times": TIMES - 1}, "Argument times must be"),
        ({"times": np.array([0.0, 1.0, np.inf])}, "Argument times must be finite"),
        ({"measured": {}}, "Argument measured must be a dict"),
        ({"measured": {"position": ["a"] * 401}}, r"Argument measured\['position'\] must be"),
        ({"measured": {"position": np.zeros(401, complex)}}, r"Argument measured\['position'\] must be"),
        ({"measured": {"position": np.zeros(7)}}, r"Argument measured\['position'\] must hold one number for each"),
        ({"measured": {"position": np.full(401, np.inf)}}, r"Argument measured\['position'\] must hold one number"),
        ({"measured": {"position": np.full(401, np.nan)}}, "must hold at least three numbers"),
        ({"measured": {"displacement": np.zeros(401)}}, "must have channels called 'position', 'velocity'"),
        ({"wrt": "nu"}, "Argument wrt must name one of"),
        ({"noise": {"position": 0.0}}, r"Argument noise\['position'\] must be positive"),
        ({"noise": {"velocity": 1.0}}, "Argument noise must name channels of measured"),
        ({"observe": {"late": lambda one, t: t}}, "Argument observe must name channels"),
        (
            {"measured": {"position": np.zeros(401)}},
            "Argument noise must give the standard deviation of 'position', whose",
        ),
        ({"windows": 0}, "Argument windows must be"),
        ({"windows": 402}, "Argument windows must be at most 401"),
        ({"windows": 2, "method": ss.Regularized(0.01)}, "Argument windows must be 1"),
        ({"y0": (0.0,)}, "Argument y0 must"),
        ({"base": ss.PoissonSwitching(1.0, 1.0)}, "Argument base must be a realisation"),
        ({"base": ss.Recorded([0.0, 1.0], [0.0, 1.0])}, "Argument base must last until"),
        (
            {"system": oscillator(0.0)},
            "first guess lies inside their bounds, above 0, but mu = 0 was given",
        ),
    ],
)
def test_bad_input(changed, message):
    arguments = GOOD | changed
    positional = [arguments.pop(name) for name in ("system", "base", "times", "measured")]
    with pytest.raises(ValueError, match=message):
        ss.calibrate(*positional, **arguments)


def test_numbers_that_jax_traces_are_refused():
    with pytest.raises((ValueError, TypeError)):
        jax.jit(lambda mu: ss.calibrate(oscillator(mu), BASE, TIMES, GOOD["measured"], wrt="mu")["mu"].value)(0.5)
