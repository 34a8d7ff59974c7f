"""What a `LinearStructure` refuses, and what it tells of itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._numerics.matrices import Banded

DRY = ss.Coulomb(0.3)
PAIR = np.array([[2.0, -1.0], [-1.0, 2.0]])


def contact(*direction, **other):
    return ss.Contact(direction, 1.0, DRY, **other)


def pair(**changed):
    given = {"mass": [1.0, 1.0], "stiffness": PAIR, "contacts": (contact(1.0, 0.0), contact(0.0, 1.0))}
    return ss.LinearStructure(**(given | changed))


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"mass": [1.0, 0.0]}, "Argument mass must be positive definite, but its smallest eigenvalue is 0"),
        ({"mass": [[1.0, 2.0], [2.0, 1.0]]}, "Argument mass must be positive definite"),
        ({"mass": [1.0, -1.0]}, "Argument mass must be positive definite"),
        ({"mass": 1.0}, r"Argument mass must be a symmetric matrix \(d, d\) or its diagonal"),
        ({"stiffness": [[2.0, -1.0], [0.0, 2.0]]}, r"Argument stiffness must be symmetric, but its entries \[0, 1\]"),
        ({"stiffness": [1.0, 2.0, 3.0]}, r"Argument stiffness must be a symmetric matrix \(2, 2\)"),
        ({"stiffness": [1.0, np.nan]}, "Argument stiffness must hold finite numbers"),
        ({"damping": np.ones((2, 3))}, r"Argument damping must be a symmetric matrix \(2, 2\)"),
        ({"mass": [ss.Uniform(1.0, 2.0), 1.0]}, "Argument mass must hold real numbers, no distributions"),
        ({"mass": np.eye(2) * (1 + 1j)}, "Argument mass must hold real numbers"),
        ({"stiffness": jnp.eye(2) * (1 + 1j)}, "Argument stiffness must hold real numbers"),
        (
            {"mass": np.ma.array(np.eye(2), mask=[[0, 1], [1, 0]])},
            "Argument mass must hold real numbers, .*nothing masked",
        ),
        ({"mass": [["1.0", 0.0], [0.0, "1.0"]]}, "Argument mass must hold real numbers"),
        ({"stiffness": [1e308, 1.0]}, "Argument stiffness must hold finite numbers of a size up to"),
        ({"rotates": "no"}, "Argument rotates must be True or False, but 'no' was given"),
        ({"uncoupled": 0}, "Argument uncoupled must be True or False"),
        ({"counted_contact": "both"}, "Argument counted_contact must be a whole number"),
        ({"contacts": ()}, "Argument contacts must be a tuple of one Contact or more"),
        ({"contacts": contact(1.0, 0.0)}, "Argument contacts must be a tuple of one Contact or more"),
        ({"contacts": (contact(1.0, 0.0, 0.0),)}, "Argument direction of contact 0 must hold 2 numbers"),
        ({"contacts": (contact(0.0, 0.0),)}, "Argument direction of contact 0 must not be zero"),
        ({"contacts": (contact(1.0, 0.0), contact(2.0, 0.0))}, "Argument contacts must be independent of each other"),
        ({"contacts": (contact(1.0, 0.0),) * 1001}, "Argument contacts must hold at most 1000, but 1001 were given"),
        ({"force": (1.0,)}, "Argument force must be a tuple of 2 forces"),
        ({"force": (1.0, "2")}, r"Argument force\[1\] must be a number, a Signal, a Recorded, a ForceSteps or None"),
    ],
)
def test_what_a_structure_refuses(changed, message):
    with pytest.raises(ValueError, match=message):
        pair(**changed)


@pytest.mark.slow
def test_redundant_contacts_are_told_under_transformations():
    """Of given directions at once, whatever the masses are; of traced ones by a status."""

    def of_mass(mass):
        contacts = contact(1.0, 0.0), contact(2.0, 0.0)
        return ss.LinearStructure(mass * np.ones(2), PAIR, None, contacts).redundant

    with pytest.raises(ValueError, match="Argument contacts must be independent of each other"):
        jax.jit(of_mass)(1.0)

    def status(second):
        contacts = contact(1.0, 0.0), ss.Contact(jnp.stack([jnp.ones(()), second]), 1.0, DRY)
        structure = ss.LinearStructure([1.0, 1.0], PAIR, None, contacts)
        method = ss.Exact(step=0.1, max_steps=64)
        return ss.simulate(structure, ss.Constant(0.0), t1=1.0, y0=(0.1, 0.2, 0.5, 0.9), method=method).status

    found = jax.jit(jax.vmap(status))(jnp.array([0.0, 1.0, 1e-17]))
    assert [ss.Status(int(code)).name for code in found] == ["REDUNDANT_CONTACTS", "FINISHED", "REDUNDANT_CONTACTS"]


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1.0], -1.0, DRY), "Argument normal_force must be positive"),
        ((1.0, 1.0, DRY), "Argument direction must be a one-dimensional sequence of real numbers"),
        (([1.0, np.nan], 1.0, DRY), "Argument direction must be finite"),
        (([1.0, None], 1.0, DRY), "Argument direction must be a one-dimensional sequence of real numbers"),
        (([1.0, 1e308], 1.0, DRY), "Argument direction must be between"),
    ],
)
def test_what_a_contact_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        ss.Contact(*arguments)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: contact_under("20 N"), "Argument normal_force must be a single real number"),
        (lambda: contact_under(0.0), "Argument normal_force must be positive .*; a contact that opens has a function"),
        (lambda: ss.ForceSteps([0.0, 1.0], [1.0]), "Arguments times and values must have the same length"),
        (lambda: ss.ForceSteps([0.5, 1.0], [1.0, 2.0]), "Argument times must begin with 0"),
        (lambda: run_on(ss.ForceSteps([0.0, 1.0], [0.0, 1.0])), "a ForceSteps was given, which is a force"),
        (lambda: run_under(ss.Recorded([0.0, 1.0], [2.0, 1.0])), "Argument normal_force must last until t1 = 2 s"),
        (lambda: run_under(Unknown()), "shortest period of normal force 0"),
    ],
)
def test_what_a_normal_force_refuses(make, message):
    with pytest.raises(ValueError, match=message):
        make()


class Unknown(ss.Signal):
    """A normal force of unknown shortest period."""

    def value(self, t):
        return 2.0 + jnp.sin(t)


def contact_under(normal_force):
    return ss.Contact((1.0, 0.0), normal_force, DRY)


def run_under(normal_force):
    return ss.simulate(pair(contacts=(contact_under(normal_force),)), ss.Constant(0.1), t1=2.0)


def run_on(base):
    return ss.simulate(pair(), base, t1=2.0)


def test_static_friction_below_kinetic_is_refused():
    with pytest.raises(ValueError, match="mu_static"):
        ss.Contact([1.0], 1.0, ss.Coulomb(0.3, 0.2))


def test_shorthands():
    assert np.array_equal(ss.Contact.of_mass(1, 3, 1.0, DRY).direction, [0, 1, 0])
    between = ss.Contact.between(2, 0, 3, 1.0, DRY)
    assert np.array_equal(between.direction, [-1, 0, 1])
    assert between.on_base == 0
    with pytest.raises(ValueError, match="Argument index must be"):
        ss.Contact.of_mass(3, 3, 1.0, DRY)


def test_lists_are_as_good_as_tuples():
    system = pair(contacts=[contact(1.0, 0.0)], force=[1.0, None])
    assert (type(system.contacts), type(system.force)) == (tuple, tuple)


def test_contacts_that_share_no_mass_are_uncoupled():
    assert pair().uncoupled
    assert not pair(mass=[[2.0, 0.5], [0.5, 1.0]]).uncoupled
    assert not pair(contacts=(contact(1.0, 0.0), contact(1.0, -1.0))).uncoupled


def test_the_fastest_motion():
    """The highest natural frequency, by NumPy; or the decay rate of strong damping."""
    mass = np.array([[2.0, 0.5], [0.5, 1.0]])
    highest = np.sqrt(np.max(np.linalg.eigvals(np.linalg.solve(mass, PAIR))))
    assert float(pair(mass=mass).fastest) == pytest.approx(highest, rel=1e-12)
    assert float(pair(damping=[100.0, 1.0]).fastest) == pytest.approx(100.0, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stiffness", "damping", "rates"),
    [
        ([-4.0], None, (2.0, -2.0)),
        pytest.param([0.0], [-3.0], (3.0, 0.0), marks=pytest.mark.slow),
        pytest.param([-4.0], [-3.0], (4.0, -1.0), marks=pytest.mark.slow),
        pytest.param([-4.0], [3.0], (1, -4), marks=pytest.mark.slow),
    ],
)
def test_a_motion_that_grows(stiffness, damping, rates):
    """Negative springs and dampers: against the two exponentials, by their largest size, over 20 s."""
    system = ss.LinearStructure([1.0], stiffness, damping, (ss.Contact.of_mass(0, 1, 1.0, ss.Coulomb(0.3)),))
    assert float(system.fastest) == pytest.approx(max(np.sqrt(-stiffness[0]), abs((damping or [0.0])[0])), rel=1e-12)
    one = ss.simulate(system, ss.Constant(0.0), t1=20.0, y0=(0.5, 1.0))
    fast, slow = rates
    # x'' = (fast + slow) x' - fast slow x - 0.3: beside its fixed point, or without a spring beside a steady drift.
    start = [0.5 + 0.3 / (fast * slow), 1.0] if stiffness[0] else [0.0, 1.0 - 0.3 / fast]
    of_fast, of_slow = np.linalg.solve([[1.0, 1.0], rates], start)
    expected = of_fast * fast * np.exp(20 * fast) + of_slow * slow * np.exp(20 * slow)
    assert float(one.final_state[1]) == pytest.approx(expected, rel=1e-12)


LAW = ss.PoissonSwitching(1.0, 1.0)
SMOOTHED = ss.Regularized(1e-3, step=0.01, threshold=1e-3, minimum_duration=0.01)
ONE = {"base": ss.Constant(0.2), "t1": 1.0}


def held(system):
    """The same masses with static friction above kinetic friction."""
    one = ss.Contact.of_mass(0, 2, 1.0, ss.Coulomb(0.3, 0.4))
    return ss.LinearStructure(system.mass, system.stiffness, contacts=(one,))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: ss.simulate(held(s), **ONE, method=SMOOTHED), "static friction exceeds kinetic"),
        (lambda s: ss.simulate_ensemble(s, LAW, t1=1.0, samples=2, key=jax.random.key(0)), "whose sticks are counted"),
        (lambda s: ss.simulate(s, **ONE).slips, "of_contact"),
        (lambda s: ss.simulate(s, **ONE).friction_force(0.5), "must have one contact"),
        (lambda s: ss.simulate(s, **ONE).energies(0.5), "must have one contact"),
        (lambda s: ss.simulate(s, **ONE).of_contact(2), "Argument number must be"),
        (lambda s: ss.simulate(s, **ONE, y0=(1.0, 2.0)), "Argument y0 must"),
    ],
)
def test_what_is_not_there_for_several_contacts_is_told(call, message):
    with pytest.raises(ValueError, match=message):
        call(pair())


def test_of_contact_needs_several_contacts():
    one = ss.simulate(ss.MassSpring(1.0, 1.0, 1.0, DRY), **ONE)
    with pytest.raises(ValueError, match="This system has one contact"):
        one.of_contact(0)


@pytest.mark.slow
def test_numbers_that_jax_traces():
    """Masses, directions and normal forces may be arguments of a function under jax.jit and jax.vmap."""

    def end(mass, normal_force):
        system = ss.LinearStructure(
            jnp.stack([mass, 2 * mass]), PAIR, contacts=(ss.Contact([1.0, 0.0], normal_force, DRY),)
        )
        return ss.simulate(system, ss.Constant(0.2), t1=2.0, method=ss.Exact(step=0.05, max_steps=200)).final_state[0]

    many = jax.jit(jax.vmap(end))(jnp.array([1.0, 2.0]), jnp.array([1.0, 3.0]))
    alone = [float(end(1.0, 1.0)), float(end(2.0, 3.0))]
    assert np.allclose(many, alone, rtol=1e-12, atol=0)


def test_a_structure_enclosed_in_a_function_needs_no_number_of_steps():
    """What follows from no traced number is known under jax.jit, as the shortest natural period is."""

    def end(x, mu):
        system = ss.LinearStructure([1.0, 1.0], PAIR, None, (ss.Contact([1.0, 0.0], 1.0, ss.Coulomb(mu)),))
        return ss.simulate(system, ss.Constant(0.2), t1=2.0, y0=(x, 0.0, 0.0, 0.0)).final_state[0]

    np.testing.assert_allclose(jax.jit(end)(0.1, 0.3), end(0.1, 0.3), rtol=1e-12)
    assert np.isfinite(jax.jit(jax.grad(end, 1))(0.1, 0.3))


@pytest.mark.slow
def test_ensembles_of_a_chain_move_it_by_bands():
    """As single trajectories, which use whole matrices; with dampers between the blocks, too."""
    blocks = 12
    row = ss.block_row(
        blocks, mass=1.0, between=2.0, to_ground=1.0, normal_force=1.0, friction=ss.Coulomb(0.4, mu_static=0.5)
    )
    damped = ss.LinearStructure(row.mass, row.stiffness, 0.05 * row.stiffness, row.contacts)
    starts = np.random.default_rng(0).uniform(-1, 1, (20, blocks))
    for chain in (row, damped):
        assert isinstance(chain.ready().matrices.stiffness, Banded)
        y0 = (*starts.T, *np.zeros(blocks))
        many = ss.simulate_contacts(
            chain, ss.Constant(0.2), t1=10.0, samples=20, key=jax.random.key(0), y0=y0, keep="totals"
        )

        def times(start, chain=chain):
            y0 = (*start, *np.zeros(blocks))
            return ss.simulate(chain, ss.Constant(0.2), t1=10.0, y0=y0).stick_time

        found = np.stack([many.of_contact(i).totals.stick_time for i in range(blocks)], axis=1)
        np.testing.assert_allclose(found, jax.vmap(times)(starts), atol=1e-9)
