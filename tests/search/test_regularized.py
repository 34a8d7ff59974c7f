"""The random search over regularised motion: at a small width, sticks and states are those of exact dynamics.

The width is 1e-4 of the speed that friction gives, the error of order one in it ("linear" shape). Set-ups whose exact
motion is near another outcome at ten times this width, or holds sticks or slips shorter than regularisation resolves,
are not compared; of the others the bound is the width times what the reference amplifies, and what a step may do: it
lands past the band by up to the change of speed in it, from where the force that is left takes the mass back.
"""

import math

import numpy as np
import pytest
from reference import compiled
from support.search import amplification, deviation, follow, numbers_of
from support.search_cases import drawn
from support.switched import Case, coulomb

import stickslip_jax as ss

WIDTH, STEP, TURNS, NUMBER = 1e-4, 2e-3, 15.0, 80  # in units of friction and 1 / omega


def _plain(case: Case, static: bool) -> Case:
    """In units of friction and of the period, so that one width and one step suit all."""
    mu = float(case.rub.law.mu)
    rub = coulomb(mu, float(case.rub.law.mu_static) if static else None)
    return case._replace(t1=TURNS / case.omega, rub=rub)


def _clear(case: Case, found: compiled.Found) -> bool:
    """Whether nothing that a width ten times as large could change decides about the sticks."""
    moments = np.concatenate([[0.0], found.sticks[:, :2].ravel(), [case.t1]])
    gaps = np.diff(moments)
    shortest = np.min(gaps[gaps > 0], initial=math.inf) * case.omega
    numbers, sequences = numbers_of(case), set()
    for nudge in (-10 * WIDTH, 0.0, 10 * WIDTH):
        moved = numbers._replace(
            normal_force=numbers.normal_force * (1 + nudge), v=numbers.v + nudge * case.half_width * case.omega
        )
        other = compiled.run(moved)
        sequences.add((other.crossings, *other.sticks[:, 3].tolist()))
    return shortest > 0.1 and found.close > 0.05 and len(sequences) == 1


@pytest.mark.slow
@pytest.mark.parametrize("static", [False, True], ids=["kinetic", "static"])
@pytest.mark.parametrize("kind", ["harmonic", "record"])
def test_fixed_steps(kind, static):
    cases, exact = [], []
    for case in drawn(kind, "everyday", NUMBER):
        plain = _plain(case, static)
        found = compiled.run(numbers_of(plain))
        if len(found.sticks) and _clear(plain, found):
            cases.append(plain)
            exact.append(found)
    assert len(cases) > NUMBER / 5
    wrong = []
    method = ss.Regularized(1.0, step=1.0, max_steps=2**14)
    scales = np.array([[WIDTH * float(c.rub.law.static) * c.normal_force / math.sqrt(c.mass * c.stiffness),
                        STEP / c.omega] for c in cases])  # fmt: skip
    batch = follow(cases, method, scales=scales)
    for i, (case, found) in enumerate(zip(cases, exact, strict=True)):
        error = deviation(case, batch.sticks(i), batch.state[i], found)
        bound = (50 * WIDTH + STEP / min(found.close, 1)) * amplification(case, found, 10 * WIDTH)
        if error > bound and not batch.tells(i):
            wrong.append((i, error, bound))
    assert not wrong
