"""The C programs that the benchmarks compare with do the same work: same sticks, same states, on the same gaps."""

import jax
import numpy as np
import pytest
from support import simulate_compiled

import stickslip_jax as ss
from benchmarks.baselines import c_yardstick

SLOTS, LANES = 400, 6


@pytest.mark.parametrize("program", ["events", "intervals"])
@pytest.mark.parametrize("w", [0.4, 2.0, 6.0])
def test_c_programs_agree_with_the_engine(program, w):
    law = ss.PoissonSwitching(speed=w, rate=0.5, first_sign="positive")
    system = ss.MassSpring(mass=1.0, stiffness=1.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
    bases = [law.sample(jax.random.key(lane), 300.0, capacity=SLOTS) for lane in range(LANES)]
    gaps = np.array([base.durations for base in bases])
    c = c_yardstick.given_gaps(program, w=w, t1=300.0, gaps=gaps, y0=(0.3, 0.1))
    for lane, base in enumerate(bases):
        one = simulate_compiled(system, base, 300.0, (0.3, 0.1))
        assert c.sticks[lane] == int(one.sticks.count)
        # 150 switches multiply the programs' own last-place differences by far less than 10^4.
        assert c.stick_time[lane] == pytest.approx(float(one.stick_time), abs=1e-9)
        assert c.z[lane] == pytest.approx(float(one.final_state[0]), abs=1e-9)
        assert c.u[lane] == pytest.approx(float(one.final_state[1]), abs=1e-9)
