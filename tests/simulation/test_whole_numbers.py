"""Parameters that are whole numbers of Python are numbers like others: derivatives beside them, in every engine."""

import jax
import pytest

import stickslip_jax as ss

STEPS = {
    "time steps": (ss.Harmonic(1, 1.3, 0), ss.Exact()),
    "closed form": (ss.SquareWave(1, 3), ss.Exact()),
    "fixed steps": (ss.Harmonic(1, 1.3, 0), ss.Regularized(1e-2, step=2e-2)),
}


def end(mu, base, method, whole=int):
    system = ss.MassSpring(whole(1), whole(4), whole(1), ss.Coulomb(mu))
    return ss.simulate(system, base, t1=6, y0=(0, 1), method=method).final_state[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "engine", [pytest.param(name, marks=pytest.mark.slow) if name != "closed form" else name for name in STEPS]
)
def test_derivative_beside_whole_numbers(engine):
    base, method = STEPS[engine]
    h = 1e-6
    expected = (end(0.5 + h, base, method, float) - end(0.5 - h, base, method, float)) / (2 * h)
    assert float(jax.grad(end)(0.5, base, method)) == pytest.approx(float(expected), rel=1e-6)


@pytest.mark.slow
def test_derivative_of_a_cart_beside_whole_numbers():
    def end(mu, y0=(1, 0, 0), t1=1):
        return ss.simulate(ss.MotorCart(mu=mu), ss.SourceVoltage(), t1=t1, y0=y0).final_state[0]

    h = 1e-6
    expected = (end(0.2 + h, (1.0, 0.0, 0.0), 1.0) - end(0.2 - h, (1.0, 0.0, 0.0), 1.0)) / (2 * h)
    assert float(jax.grad(end)(0.2)) == pytest.approx(float(expected), rel=1e-6)
