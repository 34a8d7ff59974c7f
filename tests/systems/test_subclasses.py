"""What a subclass of a public class gets that overrides a method: its own motion, or a sentence; never its parent's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

POISSON = ss.PoissonSwitching(1.3, 0.8)


class Weakening(ss.Coulomb):
    def kinetic(self, speed):
        return self.mu / (1 + 0.5 * speed)


class Falling:
    def kinetic(self, speed):
        return self.mu / (1 + 0.5 * speed)


class Mixed(Falling, ss.Coulomb):
    """The method from elsewhere."""


class Later(Weakening):
    """Two steps away from `Coulomb`."""


class Sticky(ss.Coulomb):
    @property
    def static(self):
        return 1.5 * self.mu


class Halved(ss.Coulomb):
    """Says anew what holds for its method, too."""

    constant = True

    @property
    def static_exceeds_kinetic(self):
        return False

    @property
    def static(self):
        return 0.5 * self.mu

    def kinetic(self, speed):
        return 0.5 * self.mu


def motion(friction, base=None, **options):
    system = ss.MassSpring(1.0, 4.0, 1.0, friction, **options)
    base = POISSON.sample(jax.random.key(3), 20.0) if base is None else base
    one = ss.simulate(system, base, t1=20.0, y0=(0.1, 1.0), method=ss.Exact(step=0.02))
    return np.array([*one.final_state, one.stick_time, one.sticks.count])


def test_friction():
    """A closed form only where the methods are those that it is of."""
    for own in (Weakening(0.6), Mixed(0.6), Later(0.6)):
        assert not own.constant
        assert own.static_exceeds_kinetic
        assert own.speed_scale is None
        assert not ss.MassSpring(1.0, 4.0, 1.0, own)._has_closed_form
    sticky = ss.MassSpring(1.0, 4.0, 1.0, Sticky(0.4))
    assert (sticky._has_closed_form, sticky.static_exceeds_kinetic) == (True, True)
    assert not sticky.traits.has_interval_form
    halved = ss.MassSpring(1.0, 4.0, 1.0, Halved(0.8))
    assert halved.traits.has_interval_form
    assert halved.stick_half_width == ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.4)).stick_half_width


@pytest.mark.slow
def test_motions_under_friction():
    """Against the laws of the package that are the same functions of speed."""
    np.testing.assert_allclose(motion(Weakening(0.6)), motion(ss.VelocityWeakening(0.6, 0.5)), rtol=0, atol=1e-9)
    np.testing.assert_allclose(motion(Sticky(0.4)), motion(ss.Coulomb(0.4, 0.6)), rtol=0, atol=1e-12)


@pytest.mark.slow
class Slippery(ss.Coulomb):
    @property
    def static(self):
        return 0.5 * self.mu


class Rising(ss.FrictionLaw):
    @property
    def static(self):
        return 0.3

    def kinetic(self, speed):
        return 0.4 + 0.1 * speed


def test_static_friction_that_holds_less_than_a_slip():
    message = r"static friction coefficient of \w+ must be at least kinetic\(0\) = 0\.4\d*, but "
    for make in (lambda: Slippery(0.4), Rising):
        with pytest.raises(ValueError, match=message):
            make()
    assert float(Sticky(0.4).static) == pytest.approx(0.6)


class Ratchet(ss.FrictionLaw):
    """Another coefficient in each direction of slip."""

    forward: float
    backward: float

    @property
    def static(self):
        return jnp.maximum(self.forward, self.backward)

    def kinetic(self, speed):
        return self.static

    def in_direction(self, velocity):
        return ss.Coulomb(jnp.where(velocity < 0, self.backward, self.forward))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "error"),
    [(ss.Exact(), 1e-7), pytest.param(ss.Regularized(1e-4, step=1e-3), 1e-2, marks=pytest.mark.slow)],
)
def test_friction_that_depends_on_the_direction(method, error):
    """Free vibration: each half of a period takes ``2 mu n / k`` of the amplitude, until friction holds the spring."""
    system = ss.MassSpring(1.0, 4.0, 1.0, Ratchet(forward=0.3, backward=1.0))
    assert not system.traits.has_interval_form
    one = ss.simulate(system, ss.Constant(0.0), t1=12.0, y0=(2.0, 0.0), method=method)
    turns = np.array([-1.5, 1.35, -0.85, 0.7, -0.2, 0.05])
    positions = one.evaluate(np.pi / 2 * np.arange(1, 7))[0]
    np.testing.assert_allclose(positions, turns, rtol=0, atol=error)
    np.testing.assert_allclose(one.final_state, (0.05, 0.0), rtol=0, atol=error)
    np.testing.assert_allclose(one.friction_force(np.array([1.0, 2.0, 11.0])), [1.0, -0.3, 0.2], rtol=0, atol=4 * error)


@pytest.mark.slow
def test_statements_made_anew_hold():
    halved, plain = (ss.MassSpring(1.0, 4.0, 1.0, friction) for friction in (Halved(0.8), ss.Coulomb(0.4)))
    base = POISSON.sample(jax.random.key(0), 20.0)
    one, other = (ss.simulate(system, base, t1=20.0, y0=(0.1, 1.0)) for system in (halved, plain))
    np.testing.assert_allclose(one.final_state, other.final_state, rtol=0, atol=1e-13)
    assert one.sticks.count == other.sticks.count > 3


class Fading(ss.Harmonic):
    def value(self, t):
        return jnp.exp(-0.1 * t) * super().value(t)


class Written(ss.Signal):
    """The same, from nothing."""

    def value(self, t):
        return jnp.exp(-0.1 * t) * 1.4 * jnp.cos(1.3 * t + 0.4)


@pytest.mark.slow
def test_signals():
    """Rates and integrals are those of the value, and the shortest period is not known."""
    fading, written = Fading(1.4, 1.3, 0.4), Written()
    t, h = jnp.asarray(0.7), jnp.asarray(0.2)
    for name, arguments in {"rate": (t,), "curvature": (t,), "integral": (t, h)}.items():
        assert float(getattr(fading, name)(*arguments)) == pytest.approx(float(getattr(written, name)(*arguments)))
    assert not fading.is_harmonic
    assert not ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.4), force=fading)._has_closed_form
    with pytest.raises(ValueError, match="step"):
        ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.4)), fading, t1=1.0)


@pytest.mark.slow
def test_motions_under_signals():
    """A base and a force."""
    fading, written = Fading(1.4, 1.3, 0.4), Written()
    friction, still = ss.Coulomb(0.4), ss.Constant(0.0)
    np.testing.assert_allclose(motion(friction, fading), motion(friction, written), rtol=0, atol=1e-10)
    forced = [motion(friction, still, force=force, damping=0.1) for force in (fading, written)]
    np.testing.assert_allclose(*forced, rtol=0, atol=1e-10)


def test_voltages():
    class Steps(ss.SourceVoltage):
        def value(self, t):
            return jnp.sign(super().value(t))

    with pytest.raises(ValueError, match=r"sine about its mean.*overrides SourceVoltage.value"):
        ss.simulate(ss.MotorCart(), Steps(), t1=0.1, y0=(0.3, 0.0, 0.0))
    with pytest.raises(ValueError, match="Arguments system and voltage"):
        ss.stick_duration_bound(ss.MotorCart(), Steps(), 1.0)


class DeadTime(ss.PoissonSwitching):
    """After each switch none for half a second."""

    def next_interval(self, memory, drawn, dtype):
        return 0.5 + drawn * (1 / self.rate), memory * self.speed, -memory


@pytest.mark.slow
def test_realisations_of_a_law():
    """Those of `sample` are those that an ensemble draws."""
    law = DeadTime(1.3, 2.0)
    steps = law.sample(jax.random.key(1), 30.0)
    plain = ss.PoissonSwitching(1.3, 2.0).sample(jax.random.key(1), 30.0)
    np.testing.assert_allclose(steps.durations, 0.5 + np.asarray(plain.durations), rtol=1e-14)
    assert not law.has_exponential_gaps


class Rests(ss.PoissonSwitching):
    """Every other interval the base is at rest."""

    def next_interval(self, memory, drawn, dtype):
        return drawn * (1 / self.rate), jnp.where(memory > 0, memory * self.speed, 0), -memory


def test_a_base_that_rests():
    """Laws whose base never rests say so, and an ensemble does without what holds a mass on a base at rest. A class
    of one's own that changes the intervals does not say it any more. Here the base rests first, and the mass inside the
    stick band with it.
    """
    law, system = Rests(1.0, 1.0, first_sign="negative"), ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))
    assert ss.PoissonSwitching(1.0, 1.0).is_never_at_rest
    assert not law.is_never_at_rest
    many = ss.simulate_ensemble(
        system, law, t1=10.0, samples=64, key=jax.random.key(0), y0=(0.1, 0.0), keep="sticks", progress=False
    )
    first = ss.first_stick(many, count_initial_rest=True)
    assert np.all(first.start == 0)
    one = ss.simulate(system, many.realization(3)[1], t1=10.0, y0=(0.1, 0.0))
    assert float(one.stick_time) == pytest.approx(float(many.totals.stick_time[3]), abs=1e-13)


@pytest.mark.slow
def test_derivative_by_the_rate_of_a_law():
    """Exponential gaps have a rule of their own, of no use to others: differences are the reference."""
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))
    corrected, differences = (
        ss.sensitivity(
            ss.mean_stick_count,
            system,
            DeadTime(1.3, 1.5),
            wrt=("rate", "speed"),
            t1=30.0,
            samples=8000,
            key=jax.random.key(0),
            estimator=estimator,
        )
        for estimator in ("corrected", "finite-difference")
    )
    for name in ("rate", "speed"):
        one, other = corrected[name], differences[name]
        error = np.hypot(one.standard_error, other.standard_error)
        assert abs(one.derivative - other.derivative) < 4 * error
        assert error < 0.15 * max(abs(other.derivative), 5)


def test_what_must_be_overridden_together():
    """Where one method only shows what others do, or is found from them, a class of its own would say two things."""
    with pytest.raises(TypeError, match="must override draw or next_segment too where it overrides value"):

        class Spline(ss.Recorded):
            def value(self, t):
                return t

    with pytest.raises(TypeError, match="must override draw or next_segment too where it overrides value"):

        class Ramp(ss.ForceSteps):
            def value(self, t):
                return t

    with pytest.raises(TypeError, match="must override next_interval too where it overrides next_segment"):

        class Ramps(ss.PoissonSwitching):
            def next_segment(self, memory, drawn, dtype):
                return 1.0, 0.0, 1.0, memory

    with pytest.raises(TypeError, match="must override cdf too where it overrides icdf"):

        class Shifted(ss.Uniform):
            def icdf(self, u):
                return super().icdf(u) + 1


def test_random_numbers():
    class Squared(ss.Uniform):
        def icdf(self, u):
            return super().icdf(u) ** 2

        def cdf(self, x):
            return super().cdf(jnp.sqrt(x))

    assert Squared(1.0, 2.0).support == (-np.inf, np.inf)

    class Doubled(ss.Discrete):
        def icdf(self, u):
            return 2 * super().icdf(u)

        def cdf(self, x):
            return super().cdf(x / 2)

    with pytest.raises(ValueError, match="continuous or a Discrete, and no other distribution of single values"):
        ss.SemiMarkovSwitching(ss.Exponential(1.0), Doubled([-1.0, 1.0]), alternating=False)


def test_random_phases():
    class Squared(ss.SumOfHarmonics):
        def value(self, t):
            return super().value(t) ** 2

    law = ss.RandomPhase(Squared([1.0, 0.5], [1.0, 2.2]))
    one = law.sample(jax.random.key(0))
    assert isinstance(one, Squared)
    assert law.shortest_period is None
    assert np.ptp(np.asarray(one.phases)) > 0

    class Louder(ss.RandomPhase):
        def realized(self, key_data, dtype):
            return ss.Harmonic(2.0, 7.0)

    assert Louder(ss.Harmonic(1.0, 1.0)).shortest_period is None


@pytest.mark.slow
def test_records_that_go_on():
    """A record that repeats itself has no end, and is simulated beyond that of the plain one."""

    class Periodic(ss.Recorded):
        def draw(self, key_data, number, dtype):
            return super().draw(key_data, number % np.uint32(len(self.times) - 1), dtype)

        def segments(self, t1):
            return int(t1 / float(self.times[-1]) + 1) * len(self.times)

    times, values = np.array([0.0, 0.5, 1.5, 2.0]), np.array([0.0, 1.0, -1.0, 0.0])
    system = ss.MassSpring(1.0, 4.0, 3.0, ss.Coulomb(0.9))
    again = (times[:-1] + 2 * np.arange(5)[:, None]).reshape(-1)
    longer = ss.Recorded(np.append(again, 10.0), np.append(np.tile(values[:-1], 5), 0.0))
    one, other = (ss.simulate(system, base, t1=10.0) for base in (Periodic(times, values), longer))
    np.testing.assert_allclose(one.final_state, other.final_state, rtol=0, atol=1e-12)
    assert one.sticks.count == other.sticks.count > 2


def test_statistics_of_ones_own():
    class Total(ss.StickStatistic):
        name, unit, is_of_totals = "total", "s", True

        def parts(self, sticks, t1):
            return jnp.sum(sticks.duration), jnp.ones(())

    with pytest.raises(ValueError, match="is_of_totals = False"):
        ss.sensitivity(Total(), ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0)), POISSON, wrt="mu", t1=5.0, samples=4,
                       key=jax.random.key(0))  # fmt: skip
