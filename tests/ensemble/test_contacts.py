"""Ensembles of systems with several contacts: the sticks of each contact, and of all at once."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

KEY = jax.random.key(3)
LAW = ss.PoissonSwitching(speed=0.3, rate=1.0)
RUN = {"t1": 20.0, "samples": 60, "key": KEY}
BLOCKS = ss.LinearStructure(
    (1.0, 1.0), ((2.2, -1.2), (-1.2, 2.2)), contacts=[ss.Contact.of_mass(i, 2, 1.0, ss.Coulomb(0.3)) for i in range(2)]
)
UNCERTAIN_STACK = ss.LinearStructure(
    (1.0, 0.8), (2.0, 0.0),
    contacts=[
        ss.Contact.of_mass(0, 2, 1.0, ss.Coulomb(ss.Uniform(0.1, 0.4))),
        ss.Contact.between(0, 1, 2, ss.Uniform(0.5, 1.0), ss.Coulomb(0.2, 0.3)),
    ],
)  # fmt: skip
CLUTCHED = ss.LinearStructure(
    ((2.0, 0.3), (0.3, 1.0)), ((2.2, -1.2), (-1.2, 2.2)), (0.1, 0.1),
    contacts=[
        ss.Contact.of_mass(0, 2, ss.ForceSteps((0.0, 3.0, 5.0, 12.0), (1.0, 0.0, 2.0, -1.0)), ss.Coulomb(0.4)),
        ss.Contact.of_mass(1, 2, 1.0, ss.Coulomb(0.3, 0.4)),
    ],
)  # fmt: skip


class Users(ss.SwitchedSystem):
    """Two blocks on the base, written by a user."""

    mu: float
    contacts = 2

    @property
    def state_names(self):
        return "position 1 in m", "position 2 in m", "velocity 1 in m/s", "velocity 2 in m/s"

    def rates(self, t, y, base, friction):
        x1, x2, v1, v2 = y
        return v1, v2, 1.2 * x2 - 2.2 * x1 - self.mu * friction[0], 1.2 * x1 - 2.2 * x2 - self.mu * friction[1]

    def relative_velocity(self, t, y, base):
        return y[2] - base.velocity, y[3] - base.velocity

    @property
    def shortest_time(self):
        return 3.4


def parts_of(many):
    return [*(many.of_contact(number) for number in range(many.contacts)), many.of_all_contacts()]


def counted_of(system):
    return [*(system.of_contact(number) for number in range(system.tracks.contacts)), system.of_all_contacts()]


@pytest.fixture(scope="module")
def many():
    return ss.simulate_contacts(BLOCKS, LAW, keep="sticks", **RUN)


def assert_as_simulated(many, samples):
    """Against `simulate` of each realisation, whose loop is another one."""
    for sample in range(samples):
        system, base, y0 = many.realization(sample)
        one = ss.simulate(system, base, t1=many.t1, y0=y0)
        assert int(one.status) == ss.Status.FINISHED
        singles = [*(one.of_contact(number) for number in range(many.contacts)), one.of_all_contacts()]
        for ensemble, single in zip(parts_of(many), singles, strict=True):
            count = int(ensemble.flat_sticks.count[sample])
            assert count == int(single.sticks.count) == int(single.totals.sticks)
            for name in ("start", "end", "position", "slip_displacement"):
                found, expected = getattr(ensemble.sticks, name)[sample, :count], getattr(single.sticks, name)[:count]
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
            np.testing.assert_array_equal(ensemble.sticks.ending[sample, :count], single.sticks.ending[:count])
            assert ensemble.totals.stick_time[sample] == pytest.approx(float(single.stick_time), abs=1e-9)
            assert ensemble.totals.slips[sample] == int(single.slips.count)


@pytest.mark.slow
def test_two_blocks(many):
    assert_as_simulated(many, 8)
    assert "of the contacts" in repr(many)
    assert many.samples == sum(many.status_counts.values()) == 60


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "y0"),
    [
        pytest.param(UNCERTAIN_STACK, None, id="stack, uncertain"),
        pytest.param(CLUTCHED, (1.0, 0.0, 0.0, 0.0), id="clutch"),
        pytest.param(Users(0.3), (ss.Normal(0.0, 0.1), 0.0, 0.0, 0.0), id="a user's"),
    ],
)
def test_samples_are_those_of_simulate(system, y0):
    many = ss.simulate_contacts(system, LAW, keep="sticks", y0=y0, **RUN)
    assert_as_simulated(many, 8)
    assert all(part.moments.mean[1] > 0 for part in parts_of(many)[:-1])


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("keep", ["sticks", pytest.param("totals", marks=pytest.mark.slow)])
def test_one_contact_alone_is_the_same_to_the_last_bit(many, number, keep):
    alone, part = ss.simulate_ensemble(counted_of(BLOCKS)[number], LAW, keep=keep, **RUN), parts_of(many)[number]
    for one, other in zip(alone.totals, part.totals, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(alone.moments.mean, part.moments.mean)
    if keep == "sticks":
        np.testing.assert_array_equal(alone.flat_sticks.numbers, part.flat_sticks.numbers)
        assert ss.mean_stick_duration(alone).value == ss.mean_stick_duration(part).value


@pytest.mark.slow
def test_all_at_once_is_when_each_sticks(many):
    """No contact opens: the times are the intersections of those of the contacts, found here by sweeping over them."""
    each = [part.flat_sticks for part in parts_of(many)]
    for sample in range(many.samples):
        first, second, both = ([(s, e) for s, e, of in zip(one.start, one.end, one.sample, strict=True) if of == sample]
                               for one in each)  # fmt: skip
        meet = [(max(a, c), min(b, d)) for a, b in first for c, d in second if max(a, c) < min(b, d)]
        np.testing.assert_allclose(np.reshape(both, (-1, 2)), np.reshape(sorted(meet), (-1, 2)), rtol=0, atol=1e-12)
    assert parts_of(many)[-1].moments.mean[1] > 1


@pytest.mark.slow
def test_open_contacts_do_not_count():
    """A block alone on its closed contact: while the other one is open, all that are closed stick with it."""
    lifted = ss.Contact.of_mass(0, 2, ss.ForceSteps((0.0, 2.0), (1.0, -1.0)), ss.Coulomb(0.5))
    held = ss.Contact.of_mass(1, 2, ss.ForceSteps((0.0, 6.0), (1.0, 0.0)), ss.Coulomb(0.9))
    one = ss.simulate(ss.LinearStructure((1.0, 1.0), (1.0, 1.0), contacts=[lifted, held]), ss.Constant(0.0), t1=8.0)
    # At rest without a force: both stick, then the second alone; from 6 s on both are open, and nothing sticks.
    for part, end in ((one.of_contact(0), 2.0), (one.of_contact(1), 6.0), (one.of_all_contacts(), 6.0)):
        assert part.sticks.start[part.sticks.mask].tolist() == [0.0]
        assert part.sticks.end[part.sticks.mask].tolist() == [end]
        assert float(part.stick_time) == end


@pytest.mark.slow
@pytest.mark.parametrize("way", [jax.jacfwd, jax.grad])
def test_the_arrest_of_a_chain_has_its_derivative(way):
    """When three blocks on the floor come to rest: contacts.md's number, and its derivative by mu by differences."""
    chain = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])

    def arrest(mu):
        contacts = [ss.Contact.of_mass(i, 3, 1.0, ss.Coulomb(mu)) for i in range(3)]
        system = ss.LinearStructure(np.ones(3), chain, chain / 10, contacts).of_all_contacts()
        one = ss.simulate(system, ss.Constant(0.0), t1=12.0, y0=(-1, 1, -1, -1, 1, 1), method=ss.Exact(max_steps=800))
        return one.sticks.start[0]

    assert float(arrest(0.3)) == pytest.approx(8.37062952656, abs=1e-10)
    small = 1e-5
    slope = (arrest(0.3 + small) - arrest(0.3 - small)) / (2 * small)
    assert float(jax.jit(way(arrest))(0.3)) == pytest.approx(float(slope), rel=1e-6)


@pytest.mark.slow
def test_a_contact_is_a_system_like_others(many, tmp_path):
    """Files and joining."""
    part = many.of_contact(1)
    back = ss.load(part.save(tmp_path / "part.nc"))
    assert back.system.counted_contact == 1
    np.testing.assert_array_equal(back.flat_sticks.numbers, part.flat_sticks.numbers)
    with pytest.raises(ValueError, match="same contact whose sticks are counted"):
        ss.concatenate([part, many.of_contact(0)])


@pytest.mark.slow
def test_batches_of_simulations(many):
    keys = jax.vmap(lambda i: jax.random.fold_in(KEY, i))(jnp.arange(6))

    def one(key):
        base = LAW.sample(key, 20.0, capacity=64)
        return ss.simulate(BLOCKS, base, t1=20.0, method=ss.Exact(max_steps=3000))

    batch = jax.vmap(one)(keys)
    found = ss.Ensemble.from_simulations(batch.of_contact(1)).flat_sticks
    np.testing.assert_allclose(found.start, many.of_contact(1).flat_sticks.head(6).start, rtol=0, atol=1e-9)
    together = ss.Ensemble.from_simulations(batch.of_all_contacts()).flat_sticks
    np.testing.assert_allclose(together.start, many.of_all_contacts().flat_sticks.head(6).start, rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match="sticks of one contact"):
        ss.Ensemble.from_simulations(batch)


@pytest.mark.slow
def test_extended_sweeps_and_sensitivities():
    """What takes a system with one contact takes one of several: a sweep's points, differences with common numbers."""
    system = BLOCKS.of_contact(0)
    whole = ss.simulate_ensemble(system, LAW, t1=20.0, samples=400, key=KEY)
    part = ss.simulate_ensemble(system, LAW, t1=20.0, samples=100, key=KEY).extended(samples=300)
    assert part.moments.number == whole.moments.number
    np.testing.assert_allclose(part.moments.mean, whole.moments.mean, rtol=1e-12)
    mu = "contacts[0].friction.mu"
    results = ss.Sweep(system, LAW, over={mu: [0.28, 0.3, 0.32]}, t1=20.0, samples=400, key=KEY).run()
    values = results["stick_fraction"].to_numpy()
    assert values[1] == pytest.approx(ss.stick_fraction(whole).value, rel=1e-12)
    slope = ss.sensitivity("stick_fraction", system, LAW, wrt=mu, t1=20.0, samples=400, key=KEY, step=0.02 / 0.3)
    assert slope.derivative == pytest.approx((values[2] - values[0]) / 0.04, rel=1e-6)
    with pytest.raises(ValueError, match="finite-difference"):
        ss.sensitivity("stick_fraction", system, LAW, wrt=mu, t1=20.0, samples=400, key=KEY, estimator="corrected")


@pytest.mark.slow
def test_matrices_follow_what_is_varied():
    """The engine of an ensemble holds its matrices; a difference by the mass must not use those of the first mass."""

    def one(stiffness):
        contacts = [ss.Contact.of_mass(i, 2, 1.0, ss.Coulomb(0.3)) for i in range(2)]
        return ss.LinearStructure((1.0, 1.0), ((stiffness, -1.2), (-1.2, 2.2)), contacts=contacts).of_contact(0)

    def fraction(stiffness):
        return ss.stick_fraction(ss.simulate_ensemble(one(stiffness), LAW, **RUN)).value

    assert abs(fraction(2.2) - fraction(4.4)) > 0.01


@pytest.mark.slow
def test_bad_arguments(many):
    with pytest.raises(ValueError, match=r"must say whose sticks are counted, but a system with 2 contacts"):
        ss.simulate_ensemble(BLOCKS, LAW, **RUN)
    with pytest.raises(ValueError, match="must have a list of contacts, of which all are counted"):
        ss.simulate_contacts(BLOCKS.of_contact(0), LAW, **RUN)
    with pytest.raises(ValueError, match="must have a list of contacts"):
        ss.simulate_contacts(ss.papers.belt_oscillator(1.0), LAW, **RUN)
    for number in (2, -1):
        with pytest.raises(ValueError, match="Argument number"):
            BLOCKS.of_contact(number)
        with pytest.raises(ValueError, match="Argument number"):
            many.of_contact(number)
    with pytest.raises(ValueError, match="must say whose sticks are counted"):
        ss.Sweep(BLOCKS, LAW, over={"contacts[0].friction.mu": [0.2, 0.3]}, t1=20.0, samples=10, key=KEY)
    with pytest.raises(ValueError, match="must say whose sticks are counted"):
        ss.sensitivity("stick_fraction", BLOCKS, LAW, wrt="speed", t1=20.0, samples=10, key=KEY)


@pytest.mark.slow
@pytest.mark.slow
def test_one_contact_alone_is_counted():
    """There is nothing to say of a structure that has one."""
    one = ss.LinearStructure([1.0], [4.0], contacts=(ss.Contact.of_mass(0, 1, 1.0, ss.Coulomb(0.6, 0.8)),))
    law, run = ss.PoissonSwitching(1.0, 1.0), {"t1": 10.0, "samples": 30, "key": jax.random.key(2), "y0": (0.1, 0.0)}
    as_it_is, counted = (ss.simulate_ensemble(system, law, keep="totals", **run) for system in (one, one.of_contact(0)))
    np.testing.assert_array_equal(as_it_is.totals.stick_time, counted.totals.stick_time)
    assert as_it_is.totals.sticks.shape == (30,)
    found = ss.sensitivity("stick_fraction", one, law, wrt="speed", **run)
    assert found.value == ss.sensitivity("stick_fraction", one.of_contact(0), law, wrt="speed", **run).value


def test_one_contact_alone_needs_no_choice_in_simulate():
    """Sticks and totals are those of the same mass without a list of contacts, at each place that asks for them."""
    mass = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.6, 0.8))
    listed = ss.LinearStructure([1.0], [4.0], contacts=(ss.Contact.of_mass(0, 1, 1.0, ss.Coulomb(0.6, 0.8)),))
    base = ss.Constant(0.2)
    one, right = (ss.simulate(system, base, t1=10.0, y0=(0.1, 0.0)) for system in (listed, mass))
    for found in (one, one.of_contact(0), one.of_all_contacts()):
        assert (found.stick_time.shape, int(found.sticks.count)) == ((), int(right.sticks.count))
        assert float(found.stick_time) == pytest.approx(float(right.stick_time), abs=1e-12)
        assert int(found.slips.count) == int(right.slips.count)
        assert float(found.stick_time_between(0.0, 5.0)) == pytest.approx(float(right.stick_time_between(0.0, 5.0)))
    assert repr(one) == repr(right).replace("MassSpring", "LinearStructure")
    with pytest.raises(ValueError, match="Argument number must be at most 0, but 1 was given"):
        one.of_contact(1)
    run = {"t1": 10.0, "samples": 8, "key": jax.random.key(2), "keep": "totals"}
    outputs = {"time": lambda one: one.stick_time}
    many = ss.simulate_contacts(listed, ss.PoissonSwitching(1.0, 1.0), outputs=outputs, **run).of_contact(0)
    np.testing.assert_array_equal(many.output_values["time"], many.totals.stick_time)


@pytest.mark.slow
def test_peaks_are_those_of_the_coordinate():
    """The state of a structure is an array of positions and one of velocities; a coordinate is one number of these."""
    one = ss.simulate(BLOCKS, LAW.sample(KEY, 20.0), t1=20.0)
    times = np.linspace(0, 20, 200_001)
    _, position, velocity, _ = map(np.asarray, one.evaluate(times))
    assert float(one.maximum("position 1")) == pytest.approx(position.max(), abs=1e-6)
    assert float(one.minimum("velocity 0")) == pytest.approx(velocity.min(), abs=1e-6)


class Stiffer(ss.LinearStructure):
    """A subclass that moves otherwise than its fields say."""

    def switched_model(self, smooth, solver):
        model = super().switched_model(smooth, solver)
        return eqx.tree_at(lambda one: one.matrices.stiffness, model, replace_fn=lambda matrix: 2 * matrix)


@pytest.mark.slow
def test_a_subclass_keeps_its_own_methods():
    """In ensembles too, where the matrices of the package's own structures are found before the loop."""
    system = Stiffer(BLOCKS.mass, BLOCKS.stiffness, contacts=BLOCKS.contacts)
    assert_as_simulated(ss.simulate_contacts(system, LAW, keep="sticks", **RUN), 4)


class Tracked(Users):
    """A user's fields may have any name that the package does not use itself."""

    track: int = 0
    counted: int = 5


@pytest.mark.slow
def test_fields_of_a_user_hide_nothing():
    plain, named = (
        ss.simulate(system.of_contact(1), LAW.sample(KEY, 10.0), t1=10.0) for system in (Users(0.3), Tracked(0.3))
    )
    assert int(named.sticks.count) == int(plain.sticks.count) >= 1
    np.testing.assert_array_equal(named.sticks.start, plain.sticks.start)
