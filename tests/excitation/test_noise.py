"""Noise in recorded velocities: told where it is, not told where it is not, and smoothed with the bandwidth stated."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

import stickslip_jax as ss

MASS = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(1.2))
TIMES = np.arange(2001) * 0.01
SMOOTH = 0.5 * np.sin(1.3 * TIMES)
RNG = np.random.default_rng(3)
NOISE = RNG.normal(size=TIMES.size)


def is_told(times, values):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        ss.Recorded(times, values)
    assert len(told) <= 1
    return bool(told)


def steps(every, size=2001):
    """Random levels, each for as many points."""
    return np.repeat(np.random.default_rng(7).normal(size=size // every + 1), every)[:size]


QUIET = {
    "smooth": SMOOTH,
    "constant": np.full(TIMES.size, 0.1),
    "square wave": signal.square(2.3 * TIMES),
    "fast square wave": np.where(np.arange(TIMES.size) % 6 < 3, 1.0, -1.0),
    "every point switches": (-1.0) ** np.arange(TIMES.size),
    "triangles": signal.sawtooth(2.3 * TIMES, 0.5),
    "random steps": steps(10),
    "fast random steps": steps(2),
    "a random level at each point": steps(1),
    "random walk": 0.05 * np.cumsum(NOISE),
    "random slopes": 0.001 * np.cumsum(np.cumsum(NOISE)),
    "smooth with jumps": SMOOTH + 0.2 * signal.square(0.9 * TIMES),
    "six points a period": np.sin(2 * np.pi * np.arange(TIMES.size) / 6.1),
    "beats": np.sin(7.0 * TIMES) + 0.2 * np.cos(31.0 * TIMES),
    "six decimals": np.round(SMOOTH, 6),
    "in single precision": SMOOTH.astype(np.float32),
    "noise far below the motion": SMOOTH + 1e-4 * NOISE,
}
NOISY = {
    "0.01 m/s on a smooth motion": SMOOTH + 0.01 * NOISE,
    "0.01 m/s on a constant belt": 0.1 + 0.01 * NOISE,
    "0.01 m/s on a square wave": signal.square(2.3 * TIMES) + 0.01 * NOISE,
    "0.01 m/s on triangles": signal.sawtooth(2.3 * TIMES, 0.5) + 0.01 * NOISE,
    "uniform": SMOOTH + 0.01 * np.random.default_rng(5).uniform(-1, 1, TIMES.size),
    "two decimals": np.round(SMOOTH + 0.003 * NOISE, 2),
    "of large steps of a converter": np.round(SMOOTH / 0.02 + RNG.uniform(-0.5, 0.5, TIMES.size)) * 0.02,
}


@pytest.mark.parametrize("name", QUIET)
def test_what_is_no_noise_is_not_told(name):
    for number in (2001, 500, 60):
        assert not is_told(TIMES[:number], QUIET[name][:number])
    # Points that are not equally far apart.
    kept = np.flatnonzero(np.random.default_rng(1).uniform(size=TIMES.size) < 0.8)[1:]
    if name != "six points a period":  # of which five are left, some 40 degrees apart
        kept = np.concatenate([[0], kept])
        assert not is_told(TIMES[kept], QUIET[name][kept])


@pytest.mark.parametrize("name", NOISY)
def test_noise_is_told(name):
    for number in (2001, 500):
        assert is_told(TIMES[:number], NOISY[name][:number])
    kept = np.concatenate([[0], np.flatnonzero(np.random.default_rng(1).uniform(size=TIMES.size) < 0.8)[1:]])
    assert is_told(TIMES[kept], NOISY[name][kept])
    assert is_told(TIMES * 1e-3, NOISY[name] * 1e6)  # whatever the units are


@pytest.mark.slow
@pytest.mark.parametrize("number", [64, 256, 1024])
def test_false_alarms(number):
    """Of random walks, the roughest of what is no noise, at most 1 in 1000: `bound` is exceeded with chance 1e-4.

    Walks stay far from zero, so that their size does not hide them.
    """
    draw, told, walks, bound = np.random.default_rng(number), 0, 3000, 12
    for _ in range(walks):
        told += is_told(np.arange(float(number)), 50.0 + np.cumsum(draw.normal(size=number)))
    assert told <= bound


def test_the_sentence(tmp_path):
    path = tmp_path / "belt.csv"
    np.savetxt(path, np.column_stack([TIMES, NOISY["0.01 m/s on a smooth motion"]]), delimiter=",")
    makers = (lambda: ss.Recorded(TIMES, NOISY["0.01 m/s on a smooth motion"]), lambda: ss.read_recorded_csv(path))
    for make in makers:
        with pytest.warns(
            RuntimeWarning, match=r"The record of 2001 points looks noisy: .* about 0\.0097 .* 1\.4 m/s"
        ) as told:
            make()
        assert [one.filename for one in told] == [__file__]
        assert "Recorded.smoothed(times, values, cutoff_hz=...)" in str(told[0].message)
        with warnings.catch_warnings():  # what the sentence advises where every point is meant
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", message="The record of")
            make()
    record = ss.read_recorded_csv(path, cutoff_hz=2.0)
    values = np.loadtxt(path, delimiter=",")[:, 1]
    np.testing.assert_array_equal(record.values, ss.Recorded.smoothed(TIMES, values, cutoff_hz=2.0).values)
    assert "half of the amplitude at 2 Hz" in repr(record)


def test_traced_records_are_not_looked_at():
    """Under jit, vmap and grad nothing is asked of the numbers, and the derivative is that of the clean record."""
    noisy = jnp.asarray(NOISY["0.01 m/s on a smooth motion"][:64])
    times = jnp.asarray(TIMES[:64])

    def last(values):
        return ss.Recorded(times, values).value(0.6)

    assert float(jax.jit(last)(noisy)) == pytest.approx(float(np.interp(0.6, times, noisy)), rel=1e-12)
    np.testing.assert_array_equal(jax.vmap(last)(jnp.stack([noisy, noisy])), np.full(2, last_of(noisy)))
    assert float(jax.grad(last)(noisy).sum()) == pytest.approx(1.0, rel=1e-12)


def last_of(values):
    return float(jax.jit(lambda v: ss.Recorded(jnp.asarray(TIMES[:64]), v).value(0.6))(values))


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("even", [True, False])
def test_the_bandwidth_is_the_one_stated(share, even):
    """A harmonic keeps ``1 / (1 + share^4)`` of its amplitude, and its phase."""
    cutoff, times = 2.0, np.arange(8001) * 0.0025
    if not even:
        kept = np.flatnonzero(np.random.default_rng(4).uniform(size=times.size) < 0.5)
        times = np.concatenate([[0.0], times[kept[kept > 0]]])
    angle = 2 * np.pi * share * cutoff * times
    smooth = np.asarray(ss.Recorded.smoothed(times, np.sin(angle), cutoff_hz=cutoff).values)
    inside = (times > 5) & (times < 15)
    waves = np.column_stack([np.sin(angle[inside]), np.cos(angle[inside])])
    kept, turned = np.linalg.lstsq(waves, smooth[inside], rcond=None)[0]
    assert kept == pytest.approx(1 / (1 + share**4), abs=1e-4 if even else 3e-3)
    assert turned == pytest.approx(0.0, abs=1e-4 if even else 3e-3)


@pytest.mark.slow
def test_smoothing_brings_the_sticks_back():
    def count(record):
        return int(ss.simulate(MASS, record, t1=20.0).sticks.count)

    noisy = NOISY["0.01 m/s on a smooth motion"]
    with pytest.warns(RuntimeWarning, match="looks noisy"):
        record = ss.Recorded(TIMES, noisy)
    clean = count(ss.Recorded(TIMES, SMOOTH))
    assert count(record) > 100
    assert count(ss.Recorded.smoothed(TIMES, noisy, cutoff_hz=1.0)) == clean == 1


@pytest.mark.slow
def test_smoothed_records_are_stored(tmp_path):
    smooth = ss.Recorded.smoothed(TIMES, NOISY["uniform"], cutoff_hz=2.0)
    many = ss.simulate_ensemble(MASS, smooth, t1=5.0, samples=2, keep="totals")
    many.save(tmp_path / "many.nc")
    back = ss.load(tmp_path / "many.nc").law
    assert back.smoothing == smooth.smoothing
    np.testing.assert_array_equal(back.values, smooth.values)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: ss.Recorded(TIMES, SMOOTH, smoothing=0.1),
            r"Argument smoothing must be words .* call Recorded\.smoothed",
        ),
        (lambda: ss.Recorded.smoothed(TIMES, SMOOTH, cutoff_hz=0.0), "Argument cutoff_hz must be positive"),
        (
            lambda: ss.Recorded.smoothed(TIMES, SMOOTH, cutoff_hz=60.0),
            r"between 0\.05 and 50 Hz .* but 60\.0 was given",
        ),
        (lambda: ss.Recorded.smoothed(TIMES, SMOOTH, cutoff_hz=0.01), "every tenth point"),
        (lambda: ss.Recorded.smoothed(TIMES, SMOOTH[1:], cutoff_hz=1.0), "same length of at least 5"),
        (lambda: ss.Recorded.smoothed(TIMES[::-1], SMOOTH, cutoff_hz=1.0), "Argument times must begin with 0"),
        (lambda: ss.Recorded.smoothed(TIMES, np.full(2001, np.nan), cutoff_hz=1.0), "Argument values must be finite"),
        (
            lambda: jax.jit(lambda v: ss.Recorded.smoothed(TIMES, v, cutoff_hz=1.0).values)(SMOOTH),
            "Recorded.smoothed needs numbers, but JAX is tracing them; smooth the record outside",
        ),
    ],
)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()
