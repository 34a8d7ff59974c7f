"""The programs that the benchmarks compare with do the same work: same sticks, same states, on the same gaps."""

import math
import re
import time
from functools import partial
from pathlib import Path

import diffrax
import jax
import numpy as np
import pytest
from support.interval import simulate_compiled

import benchmarks
import stickslip_jax as ss
from benchmarks.baselines import (
    c_yardstick,
    diffrax_events,
    numba_chain,
    numba_regularized,
    numba_scalar,
    numba_two_blocks,
    scipy_chain,
    scipy_events,
    scipy_harmonic,
    scipy_lugre,
)
from benchmarks.baselines.event_driver import switching_velocities
from benchmarks.lock import held_share

SLOTS, LANES = 400, 6


PROGRAMS = {
    "C, events": partial(c_yardstick.given_gaps, "events"),
    "C, intervals": partial(c_yardstick.given_gaps, "intervals"),
    "numba": numba_scalar.given_gaps,
}


@pytest.mark.slow
@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize("w", [0.4, 2.0, 6.0])
def test_compiled_programs_agree_with_the_engine(program, w):
    law = ss.PoissonSwitching(speed=w, rate=0.5, first_sign="positive")
    system = ss.MassSpring(mass=1.0, stiffness=1.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
    bases = [law.sample(jax.random.key(lane), 300.0, capacity=SLOTS) for lane in range(LANES)]
    gaps = np.array([base.durations for base in bases])
    c = PROGRAMS[program](w=w, t1=300.0, gaps=gaps, y0=(0.3, 0.1))
    for lane, base in enumerate(bases):
        one = simulate_compiled(system, base, 300.0, (0.3, 0.1))
        assert c.sticks[lane] == int(one.sticks.count)
        # 150 switches multiply the programs' own last-place differences by far less than 10^4.
        assert c.stick_time[lane] == pytest.approx(float(one.stick_time), abs=1e-9)
        assert c.z[lane] == pytest.approx(float(one.final_state[0]), abs=1e-9)
        assert c.u[lane] == pytest.approx(float(one.final_state[1]), abs=1e-9)


@pytest.mark.slow
def test_scalar_loop_of_regularised_dynamics_takes_the_same_steps():
    law = ss.PoissonSwitching(speed=2.0, rate=0.5, first_sign="positive")
    system = ss.MassSpring(mass=1.0, stiffness=1.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
    base = law.sample(jax.random.key(3), 60.0, capacity=SLOTS)
    found = numba_regularized.follow(w=2.0, t1=60.0, gaps=base.durations, width=1e-2, step=0.02, y0=(0.3, 0.1))
    method = ss.Regularized(1e-2, step=0.02, threshold=1e-2)
    one = ss.simulate(system, base, t1=60.0, y0=(0.3, 0.1), method=method)
    assert found.steps == int(np.sum(np.asarray(one.step_starts) < 60.0))
    np.testing.assert_allclose((found.z, found.u), one.final_state, atol=1e-9)
    # Each stick is measured in whole steps.
    assert abs(found.slow_time - float(one.stick_time)) <= 2 * 0.02 * int(one.sticks.count)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("program", [scipy_events, diffrax_events], ids=["scipy", "diffrax"])
def test_general_solvers_agree_with_the_engine(program):
    law = ss.PoissonSwitching(speed=2.0, rate=0.5, first_sign="positive")
    system = ss.MassSpring(mass=1.0, stiffness=1.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
    base = law.sample(jax.random.key(5), 30.0, capacity=SLOTS)
    gaps = np.asarray(base.durations)[:60]
    found = program.simulate(gaps=gaps, velocities=switching_velocities(2.0, gaps), t1=30.0, y0=(0.3, 0.1))
    one = simulate_compiled(system, base, 30.0, (0.3, 0.1))
    count = int(one.sticks.count)
    assert len(found.start) == count > 2
    # Their tolerance is 1e-8 a step; arrivals at a small angle magnify it a hundredfold.
    np.testing.assert_allclose(found.start, np.asarray(one.sticks.start)[:count], atol=1e-5)
    np.testing.assert_allclose(found.end, np.asarray(one.sticks.end)[:count], atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("program", ["events", "intervals"])
@pytest.mark.parametrize("chain", [0, 1])
def test_c_statistics_agree_with_the_engine(program, chain):
    """Other random numbers, the same law: z-scores of the means (4.5 sd: eight checks, false alarm 5e-5)."""
    n = 20_000
    c = c_yardstick.simulate(program, w=2.0, rate=0.5, t1=100.0, samples=n, y0=(0.0, 2.0), seed=3, chain=chain)
    system = ss.MassSpring(mass=1.0, stiffness=1.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
    law = ss.PoissonSwitching(speed=2.0, rate=0.5)
    many = ss.simulate_ensemble(system, law, t1=100.0, samples=n, key=jax.random.key(8), y0=(0.0, 2.0))
    pairs = [
        (c.sticks, c.sticks_squared, ss.mean_stick_count(many), 1.0),
        (c.stick_time, c.stick_time_squared, ss.stick_fraction(many), 100.0),
    ]
    for total, squares, estimate, scale in pairs:
        mean = total / n
        error = math.hypot(math.sqrt((squares / n - mean**2) / n), scale * estimate.standard_error)
        assert abs(mean - scale * estimate.value) < 4.5 * error


def test_the_yardsticks_own_mathematics():
    x = np.linspace(-300.0, 300.0, 10_001)
    sine, cosine, angle = c_yardstick.probe_math(x)
    np.testing.assert_allclose(sine, np.sin(x), atol=1e-13)
    np.testing.assert_allclose(cosine, np.cos(x), atol=1e-13)
    np.testing.assert_allclose(np.exp(1j * angle), np.exp(1j * x), atol=1e-12)


@pytest.mark.slow
def test_two_blocks_on_a_belt():
    """2,000 starts, 60 s; a difference must be one that the engine says the last digits decided."""
    friction = ss.Coulomb(0.8, 1.0), ss.Coulomb(1.0, 1.3)
    contacts = tuple(ss.Contact.of_mass(i, 2, 1.0, friction[i]) for i in range(2))
    system = ss.LinearStructure((1.0, 1.0), ((2.2, -1.2), (-1.2, 2.2)), contacts=contacts)
    x1, x2 = np.random.default_rng(1).uniform(-1, 1, (2, 2000))
    many = ss.simulate_contacts(system, ss.Constant(0.2), t1=60.0, samples=2000, y0=(x1, x2, 0.0, 0.0), keep="totals")
    expected = numba_two_blocks.given(x1, x2, t1=60.0)
    flagged = np.asarray(many.of_contact(0).totals.near_grazing_count) > 0
    assert np.mean(flagged) < 0.01
    for contact in range(2):
        totals = many.of_contact(contact).totals
        same = np.abs(totals.stick_time - expected.time[:, contact]) < 1e-6
        assert np.all(same | flagged)
        assert np.array_equal(totals.sticks[same], expected.count[same, contact])
        assert np.median(np.abs(totals.stick_time - expected.time[:, contact])) < 1e-11


@pytest.mark.slow
def test_a_chain_by_scipy():
    x = np.random.default_rng(1).uniform(-1, 1, (10, 4))
    chain = ss.block_row(10, mass=1.0, between=1.0, to_ground=0.2, normal_force=1.0, friction=ss.Coulomb(0.3))
    y0 = (*x, *np.zeros(10))
    many = ss.simulate_contacts(chain, ss.Constant(0.2), t1=20.0, samples=4, y0=y0, keep="totals")
    totals = [many.of_contact(contact).totals for contact in range(10)]
    for sample in range(4):
        found = scipy_chain.simulate(x[:, sample], t1=20.0)
        assert found.count.sum() > 10
        np.testing.assert_array_equal([each.sticks[sample] for each in totals], found.count)
        np.testing.assert_allclose([each.stick_time[sample] for each in totals], found.time, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("blocks", "t1"), [(10, 60.0), (100, 10.0), (1000, 2.0)])
def test_a_chain_by_numba(blocks, t1):
    """8 starts; every stick of every block."""
    x = np.random.default_rng(2).uniform(-1, 1, (blocks, 8))
    chain = ss.block_row(blocks, mass=1.0, between=1.0, to_ground=0.2, normal_force=1.0, friction=ss.Coulomb(0.3))
    y0 = (*x, *np.zeros(blocks))
    many = ss.simulate_contacts(chain, ss.Constant(0.2), t1=t1, samples=8, y0=y0, keep="totals")
    expected = numba_chain.given(x, t1=t1)
    assert expected.count.sum() > 100
    totals = [many.of_contact(contact).totals for contact in range(blocks)]
    clear = totals[0].near_grazing_count == 0  # in the others the last digits decided
    assert np.sum(clear) > 2
    sticks, time = (np.stack([getattr(each, name) for each in totals], 1)[clear] for name in ("sticks", "stick_time"))
    np.testing.assert_array_equal(sticks, expected.count[clear])
    np.testing.assert_allclose(time, expected.time[clear], rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("mu", [0.2, 0.5])
def test_mass_on_a_harmonic_base_by_scipy(mu):
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(mu), damping=scipy_harmonic.DAMPING)
    base = ss.Harmonic(scipy_harmonic.AMPLITUDE, scipy_harmonic.FREQUENCY)
    section = ss.nonlinear.stroboscopic_section(system, base, transient=0, kept=12, progress=False)
    states = scipy_harmonic.simulate(mu, periods=12, tolerance=1e-10)
    np.testing.assert_allclose(section.position, states[:, 0], atol=1e-7)
    np.testing.assert_allclose(section.velocity, states[:, 1], atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["LSODA", "Radau"])
def test_mass_on_bristles_by_scipy(method):
    friction = ss.LuGre(0.3, 0.4, stribeck_speed=0.01, stiffness=1e4, damping=100.0)
    system, belt = ss.MassSpring(1.0, scipy_lugre.STIFFNESS, 1.0, friction), ss.Constant(scipy_lugre.BELT)
    accurate = ss.Regularized(rtol=1e-9, solver=diffrax.Kvaerno5(), max_steps=20_000)
    one = ss.simulate(system, belt, t1=8.0, y0=(0.15, -0.1), method=accurate)
    state = scipy_lugre.simulate(0.15, -0.1, t1=8.0, method=method, tolerance=1e-9)
    np.testing.assert_allclose(one.final_state[:2], state, rtol=0, atol=1e-7)


def test_prose_of_the_benchmarks_takes_its_numbers_from_the_tables():
    """No result stands outside what `make bench` writes: it would stay as it is when the tables are written again."""
    text = (Path(benchmarks.__file__).parent / "README.md").read_text()
    prose = re.sub(r"<!-- ([\w ]+): written by `make bench` -->.*?<!-- end of \1 -->", "", text, flags=re.DOTALL)
    assert len(prose) < 0.6 * len(text)
    result = r"\d[\d.,]*\s+(?:times (?:here|as fast|faster)|minutes|ns\b|us\b|ms\b)|(?:reach(?:es|ed)|took) \d"
    # Not measured here: the time constant of a motor, and what JAX takes to hand over an array.
    assert re.findall(result, prose) == ["0.6 ms", "5 us"]


def test_share_of_the_time_under_the_lock():
    """Python that counts holds it, and one that sleeps does not."""
    counting, sleeping = held_share(lambda: sum(range(20_000_000))), held_share(lambda: time.sleep(0.3))
    if math.isnan(counting):
        pytest.skip("the lock of this Python is not where it is looked for")
    assert counting > 0.5 > sleeping
