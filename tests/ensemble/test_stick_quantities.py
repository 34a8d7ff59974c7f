"""Quantities of each stick are computed where sticks are recorded, and nowhere else."""

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._dynamics.sticks import QUANTITIES, SlipDisplacement

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.8))
SWITCHES = ss.PoissonSwitching(1.0, 1.0)
METHODS = {
    "closed form": None,
    "time steps": ss.Exact(step=0.1),
    "fixed steps": ss.Regularized(0.01, step=0.01),
    "adaptive steps": ss.Regularized(0.01),
}
COMPILED_LONGEST = "adaptive steps"
QUICK = [pytest.param(name, marks=pytest.mark.slow) if name == COMPILED_LONGEST else name for name in METHODS]


class Refusing(SlipDisplacement):
    """A quantity that must not be computed."""

    def at_end(self, remembered, stick):
        raise AssertionError("computed")


def ensemble(method, keep, t1):
    """Each call with a `t1` of its own: nothing compiled before serves it."""
    options = {} if method is None else {"method": method}
    return ss.simulate_ensemble(
        SYSTEM, SWITCHES, t1=t1, y0=(0.3, 0.2), samples=8, key=jax.random.key(2), keep=keep, progress=False, **options
    )


@pytest.mark.slow
@pytest.mark.parametrize("method", QUICK)
def test_totals_compute_no_quantity(monkeypatch, method):
    monkeypatch.setitem(QUANTITIES, "slip_displacement", Refusing())
    jax.clear_caches()
    assert ensemble(METHODS[method], "totals", 3.0).status_counts[ss.Status.FINISHED] == 8
    with pytest.raises(AssertionError, match="computed"):
        ensemble(METHODS[method], "sticks", 3.0)
    jax.clear_caches()


@pytest.mark.slow
@pytest.mark.parametrize("method", QUICK)
def test_a_displacement_is_from_stick_to_stick(method):
    """The first one is from the start; each later one from where the mass was released, found from its path."""
    many = ensemble(METHODS[method], "sticks", 12.0)
    sticks = many.flat_sticks
    for number in range(8):
        system, base, y0 = many.realization(number)
        one = ss.simulate(system, base, t1=12.0, y0=y0, method=many.method)
        of_sample = sticks.sample == number
        ends = sticks.end[of_sample]
        left_at = np.asarray(one.evaluate(ends)[0])
        left = np.concatenate([[0.3], left_at])[: len(ends)]
        bound = 2e-5 if isinstance(many.method, ss.Regularized) else 1e-9  # the path's cubics
        assert sticks.slip_displacement[of_sample] == pytest.approx(
            sticks.position[of_sample] - left[: len(ends)], abs=bound
        )
    assert len(sticks.end) > 12
