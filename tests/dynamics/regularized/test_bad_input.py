"""What regularised dynamics refuses: one clear sentence each, that begins with the argument."""

import math

import diffrax
import jax
import jax.numpy as jnp
import pytest

import stickslip_jax as ss

pytestmark = pytest.mark.usefixtures("annotations_unchecked")
NAN = float("nan")
SYSTEM = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5))
BASE = ss.PiecewiseConstant([0.0, 1.0], [0.5, -0.5])


class Plain(ss.SwitchedSystem):
    """A mass and spring that does not tell its scales."""

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        return y[1], -4.0 * y[0] - 0.5 * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity


class WithSpeed(Plain):
    """It tells the velocity, and not the time."""

    speed_scale: float = 0.25


def run(method, system=SYSTEM, base=BASE, t1=2.0):
    return ss.simulate(system, base, t1=t1, method=method)


def many(method, system=SYSTEM, t1=2.0):
    return ss.simulate_ensemble(system, BASE, t1=t1, samples=2, method=method)


POSITIVE = {
    "width": ss.Regularized,
    "step": lambda value: ss.Regularized(0.1, step=value),
    "rtol": lambda value: ss.Regularized(0.1, rtol=value),
    "threshold": lambda value: ss.Regularized(0.1, threshold=value),
}


@pytest.mark.parametrize("name", POSITIVE)
@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (0.0, r"must be positive.*, but 0\.0 was given"),
        (-1e-3, r"must be positive.*, but -0\.001 was given"),
        (NAN, r"must be finite, but nan was given"),
        (math.inf, r"must be finite, but inf was given"),
        ("wide", r"must be a single real number, but 'wide' was given"),
        (True, r"must be a single real number, but True was given"),
        (1j, r"must be a single real number, but 1j was given"),
        ([0.1, 0.2], r"must be a single real number, but an array of shape \(2,\) was given"),
    ],
)
def test_numbers_that_must_be_positive(name, value, reason):
    with pytest.raises(ValueError, match=rf"\AArgument {name} {reason}\.\Z"):
        POSITIVE[name](value)


def test_none_is_no_width():
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.3))
    with pytest.raises(ValueError, match=r"\AArgument width must be positive \(in m/s\), but None was given; only "):
        ss.simulate(system, ss.Constant(0.1), t1=1.0, method=ss.Regularized(None))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ss.Regularized(0.1, "tahn"), r"shape must be one of .*, but 'tahn' was given; did you mean 'tanh'\?"),
        (lambda: ss.Regularized(0.1, "atan"), r"shape must .*, but 'atan' was given; did you mean 'arctan'\?"),
        (lambda: ss.Regularized(0.1, "xyz"), r"shape .*'tanh', 'linear', 'arctan', 'rational', but 'xyz' was given\."),
        (lambda: ss.Regularized(0.1, 3), r"shape must be one of .*, but 3 was given\."),
        (lambda: ss.Regularized(0.1, None), r"shape must be one of .*, but None was given"),
        (
            lambda: ss.Regularized(0.1, minimum_duration=-1.0),
            r"minimum_duration must be zero or positive \(in s\), but -1\.0 was given\.",
        ),
        (lambda: ss.Regularized(0.1, minimum_duration=NAN), r"minimum_duration must be finite, but nan was given\."),
        (lambda: ss.Regularized(0.1, max_steps=0), r"max_steps must be a whole number of at least 1, but 0 was given"),
        (lambda: ss.Regularized(0.1, max_steps=1e3), r"max_steps must be a whole number .*, but 1000\.0 was given"),
        (lambda: ss.Regularized(0.1, atol="tiny"), r"atol must be real numbers, but 'tiny' was given"),
        (lambda: ss.Regularized(0.1, atol=NAN), r"atol must be finite, but nan was given"),
        (
            lambda: ss.Regularized(0.1, step=0.01, solver=diffrax.Tsit5()),
            r"solver and adjoint must be None with a fixed step, but step = 0\.01 was given; leave the step out",
        ),
        (
            lambda: ss.Regularized(0.1, step=0.01, adjoint=diffrax.ForwardMode()),
            r"solver and adjoint must be None with a fixed step, but step = 0\.01 was given",
        ),
        (
            lambda: ss.Regularized(0.1, solver=diffrax.Euler()),
            r"solver must be a solver of diffrax with an error estimate, such as diffrax\.Kvaerno3\(\).*Euler",
        ),
        (lambda: ss.Regularized(0.1, solver="Tsit5"), r"solver must be a solver of diffrax .*, but 'Tsit5' was given"),
        (lambda: ss.Regularized(0.1, solver=diffrax.Tsit5), r"solver must be a solver of diffrax .*Tsit5.* was given"),
        (lambda: ss.Regularized(0.1, adjoint="forward"), r"adjoint must be one of diffrax's, .*but 'forward' was"),
        (lambda: ss.Regularized(0.1, adjoint=diffrax.Tsit5()), r"adjoint must be one of diffrax's, .*, but Tsit5"),
        (lambda: run("regularized"), r"method must be Exact\(\.\.\.\) or Regularized\(width\), but 'regularized' was"),
        (
            lambda: run(ss.Regularized),
            r"method must be Exact\(\.\.\.\) or Regularized\(width\), but the class Regularized",
        ),
    ],
)
def test_refused(call, message):
    with pytest.raises(ValueError, match=rf"\AArguments? {message}") as caught:
        call()
    assert "\n" not in str(caught.value)
    assert str(caught.value)[-1] in ".?"


@pytest.mark.parametrize("simulate", [run, many])
def test_a_step_too_long_for_the_natural_period(simulate):
    """The period is pi: no step may be longer than a tenth of it."""
    message = (
        r"\AArgument step must be at most 0\.3142 s, .* the natural period of 3\.142 s, but 0\.6 was given; .*\.\Z"
    )
    with pytest.raises(ValueError, match=message):
        simulate(ss.Regularized(0.1, step=0.6))


@pytest.mark.parametrize("frequency", [20.0])
def test_a_step_too_long_for_the_base(frequency):
    with pytest.raises(ValueError, match=r"\AArgument step must be at most .* shortest period of the base motion"):
        run(ss.Regularized(0.1, step=0.3), base=ss.Harmonic(1.0, frequency))


def test_a_step_too_long_is_refused_with_max_steps_too():
    """The number of steps is then given, and the length must be looked at all the same."""
    with pytest.raises(ValueError, match=r"\AArgument step must be at most 0\.3142 s, .* natural period"):
        run(ss.Regularized(0.1, step=0.6, max_steps=100))


def test_a_step_too_long_for_a_fast_motor():
    """At 8 V a step of 1 ms was off by 0.67 rad/s, twenty times as much as at half the length."""
    cart, voltage = ss.MotorCart(mu=0.2), ss.SourceVoltage(8.0, 4.0, 10.0)
    with pytest.raises(ValueError, match=r"\AArgument step must be at most 0\.0002542 s, .* of the fastest motion"):
        ss.simulate(cart, voltage, t1=1.0, y0=(0.7, 0.0, 0.0), method=ss.Regularized(1e-2, step=1e-3))


def test_traced_lengths_need_max_steps():
    message = (
        r"\AArgument method must give max_steps, Regularized\(\.\.\., max_steps=\.\.\.\), when t1 or the step is an "
    )
    with pytest.raises(ValueError, match=message):
        jax.jit(lambda t1: run(ss.Regularized(0.1, step=0.01), t1=t1).stick_time)(2.0)
    with pytest.raises(ValueError, match=message):
        jax.jit(lambda step: run(ss.Regularized(0.1, step=step)).stick_time)(0.01)


def test_an_ensemble_is_not_traced():
    with pytest.raises(ValueError, match=r"\AArguments of simulate_ensemble must be numbers, but JAX is tracing"):
        jax.jit(lambda width: many(ss.Regularized(width)).moments.mean)(0.1)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"step": 0.01}])
@pytest.mark.parametrize("simulate", [run, many])
@pytest.mark.parametrize(
    ("system", "given", "name"),
    [
        (Plain(), {}, "threshold"),
        (Plain(), {"minimum_duration": 0.01}, "threshold"),
        (Plain(), {"threshold": 0.1}, "minimum_duration"),
        (WithSpeed(), {}, "minimum_duration"),
    ],
)
def test_a_system_that_does_not_tell_its_scales(simulate, system, given, name, options):
    kind = type(system).__name__
    message = rf"Argument method must give the {name}, Regularized\(\.\.\., {name}=\.\.\.\), .* of a {kind} are not "
    with pytest.raises(ValueError, match=rf"\A{message}") as caught:
        simulate(ss.Regularized(0.1, **given, **options), system=system)
    assert str(caught.value).endswith(".")


@pytest.mark.parametrize("atol", [[1e-6, 1e-6, 1e-6], -1e-6, [1e-6, -1.0]])
def test_tolerances_of_another_number_or_sign(atol):
    """One number, or one for each of the two states; none of them negative."""
    with pytest.raises(ValueError, match=r"\AArgument atol "):
        run(ss.Regularized(0.1, atol=jnp.asarray(atol)))


def test_numbers_of_every_kind_are_allowed():
    for number in (1, jnp.asarray(1.0), jnp.float32(1.0)):
        method = ss.Regularized(number, "linear", step=number, threshold=number, minimum_duration=number, atol=number)
        assert method.width == method.minimum_duration == 1
    assert ss.Regularized(0.1, minimum_duration=0.0).minimum_duration == 0


@pytest.mark.slow
def test_nothing_sticks_without_friction():
    """Although a mass that starts with the base's velocity leaves it slowly."""
    base, system = ss.PiecewiseConstant([0.0, 2.0], [1.0, -1.0]), ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.0))
    one = ss.simulate(system, base, t1=5.0, y0=(0.0, 1.0), method=ss.Regularized(1e-3, step=0.01))
    assert int(one.status) == ss.Status.FINISHED
    assert int(one.sticks.count) == 0
    assert float(one.stick_time) == 0


@pytest.mark.slow
def test_a_given_step_where_a_time_scale_is_traced():
    """It counts the steps; where it is too long, it is shortened, and the status tells if they were too few."""
    method = ss.Regularized(0.01, step=0.005)

    @jax.jit
    def status(tone):
        return ss.simulate(SYSTEM, ss.Harmonic(0.5, tone, 0.4), t1=2.0, method=method).status

    assert status(1.3) == ss.Status.FINISHED
    assert status(2000.0) == ss.Status.OUT_OF_STEPS
