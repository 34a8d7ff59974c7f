"""The random search over ensembles whose numbers differ: sample i is what the reference makes of its numbers."""

import jax
import numpy as np
import pytest
from support.search import compared, stacked, system_of
from support.search_cases import drawn
from support.switched import Case, Steps, Tones, coulomb

import stickslip_jax as ss

T1, SAMPLES, KEY = 40.0, 300, jax.random.key(25)
CLOSED, INTEGRATED = 1e-10, 1e-7


def wrong_samples(many: ss.Ensemble, cases: list[Case], least: float, sticks: float = 1.0) -> list[int]:
    """The samples that differ from the reference without being told; there must be `sticks` in each on average."""
    flat, totals = many.flat_sticks, many.totals
    assert flat is not None
    ends = np.cumsum(flat.count)
    columns = np.stack([flat.start, flat.end, flat.position, flat.ending], axis=1)
    assert ends[-1] > sticks * len(cases)
    wrong = []
    for i, case in enumerate(cases):
        told = int(totals.status[i]) != ss.Status.FINISHED or int(totals.near_grazing_count[i]) > 0
        if compared(case, columns[ends[i] - flat.count[i] : ends[i]], None, told, least).wrong:
            wrong.append(i)
    return wrong


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "family"),
    [*(("harmonic", name) for name in ("everyday", "damped", "clinging", "frictionless")), ("weakening", "everyday")],
)
def test_arrays_of_numbers(kind, family):
    """One array for every number; the zeros of frictionless and undamped samples among them."""
    cases = [case._replace(t1=T1) for case in drawn(kind, family, SAMPLES)]
    system, base, y0 = stacked([(system_of(case), case.base.package, case.y0) for case in cases])
    start = np.stack(y0, axis=1)
    many = ss.simulate_ensemble(system, base, t1=T1, samples=SAMPLES, key=KEY, y0=start, keep="sticks")
    # In most frictionless samples nothing sticks.
    sticks = 0.5 if family == "frictionless" else 1.0
    assert wrong_samples(many, cases, CLOSED if kind == "harmonic" else INTEGRATED, sticks) == []


def case_of(many: ss.Ensemble, i: int, base: Tones | Steps) -> Case:
    system, _, y0 = many.realization(i)
    law, force, damping = system.friction, system.force, system.damping
    push = force and Tones((float(force.amplitude),), (float(force.angular_frequency),), (float(force.phase),))
    static = None if law.mu_static is None else float(law.mu_static)
    numbers = map(float, (system.mass, system.stiffness, system.normal_force))
    rub, start = coulomb(float(law.mu), static), tuple(map(float, y0))
    return Case(*numbers, rub, base, many.t1, start, None if damping is None else float(damping), push)


@pytest.mark.slow
def test_distributions_in_time_steps():
    """The numbers that `realization` says are those that were simulated; draws reach far into the tails."""
    system = ss.MassSpring(
        ss.LogNormal(1.0, 0.5),
        ss.LogNormal(1.6, 1.0),
        ss.Uniform(0.5, 2.0),
        ss.Coulomb(ss.Uniform(0.0, 0.6), ss.Uniform(0.6, 3.0)),
        ss.LogNormal(1.0, 3.0),
        ss.Harmonic(ss.Uniform(0.0, 1.5), ss.Uniform(0.2, 2.0), ss.Uniform(0.0, 6.0)),
    )
    base = ss.Harmonic(ss.Uniform(0.1, 1.0), ss.Uniform(0.2, 2.0), ss.Uniform(0.0, 6.0), ss.Normal(0.0, 0.5))
    many = ss.simulate_ensemble(
        system, base, t1=T1, samples=SAMPLES, key=KEY, y0=(ss.Normal(0.0, 1.0), ss.Normal(0.0, 1.0)), keep="sticks"
    )
    cases = []
    for i in range(SAMPLES):
        tone = many.realization(i).base
        numbers = [float(value) for value in (tone.amplitude, tone.angular_frequency, tone.phase, tone.offset)]
        cases.append(case_of(many, i, Tones((numbers[0],), (numbers[1],), (numbers[2],), numbers[3])))
    assert len({case.mass for case in cases}) == SAMPLES
    assert wrong_samples(many, cases, CLOSED) == []


@pytest.mark.slow
def test_distributions_over_whole_intervals():
    system = ss.MassSpring(
        ss.LogNormal(1.0, 0.5), ss.LogNormal(1.6, 1.0), ss.Uniform(0.5, 2.0), ss.Coulomb(ss.Uniform(0.0, 2.0))
    )
    law = ss.PoissonSwitching(speed=ss.Uniform(0.05, 2.0), rate=ss.Uniform(0.2, 2.0))
    many = ss.simulate_ensemble(
        system, law, t1=T1, samples=SAMPLES, key=KEY, y0=(ss.Normal(0.0, 1.0), ss.Normal(0.0, 1.0)), keep="sticks"
    )
    cases = []
    for i in range(SAMPLES):
        base = many.realization(i).base
        lasting = np.asarray(base.durations) > 0
        durations, velocities = np.asarray(base.durations)[lasting], np.asarray(base.velocities)[lasting]
        cases.append(case_of(many, i, Steps(tuple(durations.tolist()), tuple(velocities.tolist()))))
    assert wrong_samples(many, cases, CLOSED) == []
