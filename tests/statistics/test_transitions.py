"""Transition kernels: by quadrature against numerical integration and against simulated sticks, and what follows."""

import math
from functools import partial

import jax
import numpy as np
import pytest
from scipy import integrate, stats
from support.statistics import chain

import stickslip_jax as ss
from stickslip_jax._statistics.quadrature import _DIMENSIONS, _Walk
from stickslip_jax._statistics.transitions import Cells

SYSTEM = ss.papers.belt_oscillator()
POISSON = ss.PoissonSwitching(speed=1.0, rate=1.0)
STEPS = ss.RandomSteps(speed=1.0, interval=0.7, levels=(-1.0, 0.0, 1.0, 2.0))
RELEASED, SWITCHED = float(ss.Ending.RELEASED), float(ss.Ending.BASE_SWITCHED)


def simulated(law, samples, t1=100.0, **options):
    many = ss.simulate_ensemble(SYSTEM, law, t1=t1, samples=samples, key=jax.random.key(3), keep="sticks")
    return ss.transition_kernel(many, **options)


@pytest.fixture(scope="module")
def kernels():
    """By quadrature, and from simulated sticks."""
    return ss.transition_kernel(SYSTEM, POISSON, transitions=2**15), simulated(POISSON, 4000)


def accelerated(by, _, y):
    """The derivative of position and velocity, by friction and a spring."""
    return y[1], by[0] - by[1] * y[0]


@pytest.mark.parametrize("place", [-0.2, -0.05, 0.1, 0.24])
def test_a_slip_without_a_jump_by_numerical_integration(kernels, place):
    """The base has jumped from -1 to 1 m/s with the mass at `place`: SciPy finds when and where it sticks next."""
    mass, stiffness, friction, base = 1.0, 4.0, 1.0, 1.0

    def meets(_, y):
        return y[1] - base

    meets.terminal = True
    y, time, side = np.array([place, -base]), 0.0, 1.0
    for _ in range(10):
        meets.direction = side
        right = partial(accelerated, (side * friction / mass, stiffness / mass))
        found = integrate.solve_ivp(right, (0, 50), y, events=meets, rtol=1e-11, atol=1e-12)
        y, time, side = found.y[:, -1], time + found.t[-1], -side
        if abs(y[0]) <= friction / stiffness:
            break
    quadrature, _ = kernels
    near = quadrature.like({"end_position": place, "base_velocity": -base, "ending": SWITCHED}, 800)
    slips, places = (quadrature.following[name][near] for name in ("slip_before", "position"))
    atom = np.abs(slips - time) < 0.05
    expected = math.exp(-float(POISSON.rate) * time)
    # Transitions from places within 1.3 % of the band about this one: the atom is as wide as that.
    assert abs(atom.mean() - expected) < 4 * math.sqrt(expected * (1 - expected) / 800) + 0.005
    assert abs(np.median(slips[atom]) - time) < 5e-3
    assert abs(np.median(places[atom]) - y[0]) < 5e-3


def deviations(exact, found, name, bins=12, parts=8):
    """Standardised differences between what follows a cell, by both kernels: in bins of a number, or the next cell.

    Within a cell states are not spread alike in both. So each is cut into `parts`, each of which has its share of the
    simulated states.
    """
    cells = Cells.of(found.state, 16)
    fine = Cells.of(found.state, 16 * parts)
    if name == "next cell":
        exact_place, found_place, bins = cells.cell_of(exact.next_state), cells.cell_of(found.next_state), cells.number
    else:
        edges = np.unique(np.quantile(found.following[name], np.arange(1, bins) / bins)) + 1e-9  # beside atoms
        exact_place, found_place = (np.searchsorted(edges, one.following[name]) for one in (exact, found))
        bins = len(edges) + 1
    whole, part = cells.cell_of(found.state), fine.cell_of(found.state)
    of_part, number = np.zeros(fine.number, int), np.bincount(part, minlength=fine.number)
    of_part[part] = whole
    shape = (fine.number, bins)
    table = np.bincount(fine.cell_of(exact.state) * bins + exact_place, minlength=math.prod(shape)).reshape(shape)
    points = np.maximum(table.sum(axis=1, keepdims=True), 1)
    p = table / points
    expected, variance = np.zeros((cells.number, bins)), np.zeros((cells.number, bins))
    np.add.at(expected, of_part, number[:, None] * p)
    np.add.at(variance, of_part, number[:, None] ** 2 * p * (1 - p) / points)  # of random points: more than there is
    counts = np.bincount(whole * bins + found_place, minlength=cells.number * bins).reshape(-1, bins)
    of_cell = counts.sum(axis=1, keepdims=True)
    assert np.all(np.bincount(of_part, weights=number, minlength=cells.number) == of_cell[:, 0])
    variance += expected * (1 - expected / np.maximum(of_cell, 1))
    many = (expected > 25) & (of_cell - expected > 25)
    assert many.sum() > 100
    return (counts - expected)[many] / np.sqrt(variance[many])


@pytest.mark.parametrize("name", ["slip_before", "position", "duration", "end_position", "next cell"])
def test_simulated_sticks_follow_the_quadrature(kernels, name):
    z = deviations(*kernels, name)
    assert np.max(np.abs(z)) < 5
    assert np.mean(z**2) < 1 + 5 * math.sqrt(2 / len(z))


def followed(law, kernel, after):
    """From each state of a kernel of simulated sticks on, what the quadrature's closed forms make follow, at random."""
    walk = _Walk(SYSTEM, law, 1)
    walk.used, walk.rest = _DIMENSIONS, np.random.default_rng(1)  # no point of the sequence
    state = kernel.state
    level = np.searchsorted(walk.levels, state["base_velocity"])
    np.testing.assert_array_equal(walk.levels[level], state["base_velocity"])
    phase, of = state.get("phase", np.zeros(kernel.number)), {}
    if after == "stick":
        released = state["ending"] == RELEASED
        of["slip_before"], of["position"], level, phase = walk.slip(state["end_position"], level, released, phase)
        of["duration"], of["end_position"], released, phase = walk.stick(of["position"], level, phase)
    else:
        of["duration"], of["end_position"], released, phase = walk.stick(state["position"], level, phase)
        of["slip_duration"], of["position"], level, phase = walk.slip(of["end_position"], level, released, phase)
    of["ending"] = np.where(released, RELEASED, SWITCHED)
    return of, of | {"base_velocity": walk.levels[level], "phase": phase}


def paired_deviations(law, found, after):
    """Of each number, the standardised differences of its counts in bins, cell by cell: from the same states, so that
    they differ by chance alone. An atom may stand on the edge of a cell or a bin: its round-off decides nothing here.
    """
    exact, next_state = followed(law, found, after)
    rounded = [
        {name: np.round(one[name], 7) for name in found.state} for one in (found.state, found.next_state, next_state)
    ]
    cells = Cells.of(rounded[0], 16)
    cell, *next_cells = map(cells.cell_of, rounded)
    for name in (*exact, "next cell"):
        if name == "next cell":
            places, bins = next_cells, cells.number
        else:
            both = [np.round(one[name], 7) for one in (found.following, exact)]
            edges = np.unique(np.quantile(both[0], np.arange(1, 12) / 12)) + 5e-8
            places, bins = [np.searchsorted(edges, one) for one in both], len(edges) + 1
        counted, closed = (np.bincount(cell * bins + one, minlength=cells.number * bins) for one in places)
        many = counted + closed > 50
        assert many.sum() > 20
        yield name, np.max(np.abs(counted - closed)[many] / np.sqrt((counted + closed)[many]))


@pytest.mark.slow
@pytest.mark.parametrize("after", ["stick", "slip"])
@pytest.mark.parametrize("law", [POISSON, STEPS], ids=["poisson", "steps"])
def test_ten_million_sticks_follow_the_quadrature(law, after):
    found = simulated(law, 90_000 if law is POISSON else 130_000, t1=400.0, after=after, ends_before=380.0)
    assert found.number > 9_000_000
    for name, deviation in paired_deviations(law, found, after):
        assert deviation < 5, name


def test_a_base_that_jumps_just_when_the_mass_meets_its_velocity():
    """Every half natural period: what meets the base as it jumps away does not stick, what it jumps to does."""
    law = ss.RandomSteps(speed=1.0, interval=math.pi / 2, levels=(-1.0, 0.0, 1.0))
    found = simulated(law, 500, t1=400.0, after="slip", ends_before=300.0)
    for name, deviation in paired_deviations(law, found, "slip"):
        assert deviation < 5, name


def test_a_mass_that_friction_holds_at_the_edge_sticks_to_a_base_at_rest():
    """It stands there while the base moves, as spring and friction balance; round-off must not free it."""
    edge = np.nextafter(0.25, [0, 1, 1])
    edge[2] += 1e-9
    walk = _Walk(SYSTEM, STEPS, 4)
    met, x, v = walk.arcs(edge, np.zeros(3), np.ones(3), np.full(3, 5.6))
    assert np.all(np.isinf(met))
    np.testing.assert_allclose(x, 0.25, atol=2e-9)
    met, _, _ = walk.arcs(x, v, np.zeros(3), np.full(3, 0.7))
    np.testing.assert_array_equal(met[:2], 0)
    assert met[2] > 0


def test_three_steps_by_chapman_and_kolmogorov(kernels):
    """Which cell comes three sticks later, counted, and by the third power of the transition matrix.

    Cells are not points: the power is right up to what a cell leaves open, which 64 cells make small.
    """
    _, kernel = kernels
    p = np.linalg.matrix_power(kernel.probabilities, 3)
    same = np.flatnonzero(kernel.owner[2:] == kernel.owner[:-2])
    size = kernel.cells.number
    counts = np.bincount(kernel.cell[same] * size + kernel.next_cell[same + 2], minlength=size**2).reshape(size, size)
    of_cell = counts.sum(axis=1, keepdims=True)
    expected = of_cell * p
    many = expected > 25
    z = (counts - expected)[many] / np.sqrt((expected * (1 - p))[many] * 2)  # both have errors
    assert many.sum() > 200
    assert np.max(np.abs(z)) < 5


def test_long_run_is_that_of_the_sticks(kernels):
    """The stationary distribution: of cells, compared with the shares in which ends of sticks fall."""
    exact, kernel = kernels
    late = kernel.owner[1:] == kernel.owner[:-1]
    shares = np.bincount(kernel.cell[1:][late], minlength=kernel.cells.number) / late.sum()
    z = (kernel.stationary - shares) / np.maximum(kernel.stationary_errors, 1e-6)
    assert kernel.stationary.sum() == pytest.approx(1)
    assert np.max(np.abs(z)) < 5
    difference = exact.second_eigenvalue - kernel.second_eigenvalue
    assert abs(difference.value) < 5 * difference.standard_error + 0.003  # and cells of another width
    assert kernel.steps_to_forget(0.01) == exact.steps_to_forget(0.01)


def test_joint_distributions_are_those_of_successive_sticks(kernels):
    """Composed over three sticks, against the histogram of three durations in a row."""
    _, kernel = kernels
    found = kernel.joint(("duration", 1), ("duration", 2), ("duration", 3), bins=4)
    same = np.flatnonzero(kernel.owner[2:] == kernel.owner[:-2])
    inside = [np.clip(np.searchsorted(found.edges[0], kernel.following["duration"][same + n], side="right") - 1, 0, 3)
              for n in range(3)]  # fmt: skip
    shares = np.bincount(np.ravel_multi_index(inside, (4, 4, 4)), minlength=64).reshape(4, 4, 4) / len(same)
    z = (found.probabilities - shares) / np.sqrt(shares / len(same) * 3)  # triples overlap
    assert found.probabilities.sum() == pytest.approx(1)
    assert np.max(np.abs(z[shares > 1e-3])) < 5
    alone = kernel.joint(("duration", 1), bins=4)
    np.testing.assert_allclose(found.probabilities.sum(axis=(1, 2)), alone.probabilities, rtol=1e-12)
    assert found.density.shape == (4, 4, 4)
    # From one cell on: the durations that followed it.
    here = kernel.cell == kernel.cell[100]
    begun = kernel.joint(("duration", 1), bins=4, start={name: own[100] for name, own in kernel.state.items()})
    counts, _ = np.histogram(kernel.following["duration"][here], found.edges[0])
    np.testing.assert_allclose(begun.probabilities, counts / here.sum(), rtol=1e-12)
    assert (found.density[0, 0, 0] * np.diff(found.edges[0])[0] ** 3) == pytest.approx(found.probabilities[0, 0, 0])


def test_information_is_that_of_the_statistics(kernels):
    """Mutual information of a stick's duration and the next, by composition and counted from pairs."""
    _, kernel = kernels
    many = ss.simulate_ensemble(SYSTEM, POISSON, t1=100.0, samples=4000, key=jax.random.key(3), keep="sticks")
    counted = many.statistics.joint(("duration", 5), ("duration", 6)).mutual_information(bins=8)
    composed = kernel.joint(("duration", 1), ("duration", 2), bins=8).mutual_information()
    assert composed.standard_error < counted.standard_error / 2
    assert abs(composed.value - counted.value) < 4 * math.hypot(composed.standard_error, counted.standard_error) + 1e-3
    same = kernel.joint(("position", 1), ("end_position", 1), bins=8).mutual_information()
    assert same.value > 10 * composed.value  # of one stick


def test_order_of_the_chain(kernels):
    """The sticks need no longer memory; where the position is kept from the kernel they do."""
    _, kernel = kernels
    assert not kernel.order_test().rejected
    blind = simulated(POISSON, 4000, given=("ending",))
    verdict = blind.order_test(0.001)
    assert verdict.rejected
    assert "ending" in verdict.question


def test_level_of_the_test_of_order():
    """Chains of two real numbers without longer memory: rejected as often as it should be."""
    rng, rejected = np.random.default_rng(1), 0
    for _ in range(60):
        state = [rng.normal(size=400)]
        for _ in range(12):
            state.append(0.7 * state[-1] + rng.exponential(size=400) * (1 + 0.3 * np.sin(state[-1])))
        x = np.stack(state, axis=1)
        rejected += bool(chain(x).order_test(0.1).rejected)
    assert rejected <= stats.binom.ppf(0.9999, 60, 0.1)


def followed_by_map(by_last, by_one_before):
    """Sequences of ``1 - by_last x^2 + by_one_before w``, where w came before x; from random first numbers."""
    rng = np.random.default_rng(0)
    x, before, found = rng.uniform(-0.1, 0.1, 400), rng.uniform(-0.1, 0.1, 400), []
    for _ in range(43):
        x, before = 1 - by_last * x**2 + by_one_before * before, x
        found.append(x)
    return chain(np.stack(found[30:], axis=1))


def test_what_nothing_but_the_state_determines_is_no_dependence():
    """Neighbours are followed by neighbours, and came from such: ranks among them would tell each other all."""
    verdict = followed_by_map(1.7, 0.0).order_test()
    assert verdict.rejected is None
    assert "what follows like states hardly differs" in repr(verdict)
    assert followed_by_map(1.4, 0.3).order_test(1e-6).rejected


@pytest.mark.slow
def test_sequence_of_a_motor_and_its_phase():
    """A stick ends when the current, steady by then, reaches what friction holds at this angle: so the phase of each
    sample's voltage is known. With it the next stick depends on the last end alone; a slip's end without it does not.
    """
    setup = ss.papers.motor_cart(0.5, t1=6.0)
    run = {"t1": setup.t1, "y0": setup.y0, "keep": "sticks", "progress": False}
    parts = [ss.simulate_ensemble(*setup[:2], samples=2000, key=jax.random.key(seed), **run) for seed in (0, 1)]
    many = ss.concatenate(parts)
    kernel, cart, voltage = ss.transition_kernel(many), setup.system, ss.SourceVoltage()
    impedance = cart.resistance + 1j * cart.inductance * voltage.angular_frequency
    angle = voltage.angular_frequency * kernel.state["phase"] - np.angle(impedance)
    current = voltage.mean / cart.resistance + voltage.amplitude / abs(impedance) * np.sin(angle)
    held = cart.largest_friction_torque * np.abs(np.sin(kernel.state["end_position"])) / cart.motor_constant
    assert np.quantile(np.abs(current - held), 0.9) < 1e-6 * np.ptp(current)
    assert not kernel.order_test(0.001).rejected
    assert not ss.transition_kernel(many, after="slip").order_test(0.001).rejected
    assert ss.transition_kernel(many, after="slip", given=("position",)).order_test(1e-20).rejected


def test_drawn_sequences_are_those_of_simulations(kernels):
    """Durations and positions of the first to fourth stick after a release, drawn and simulated."""
    exact, kernel = kernels
    sticks = exact.sample(3000, 4, seed=1, start={"end_position": 0.25, "base_velocity": 1.0, "ending": RELEASED})
    assert np.all(sticks.count == 4)
    drawn = sticks.padded()
    begins = np.flatnonzero((kernel.state["ending"] == RELEASED) & (kernel.state["base_velocity"] == 1.0))
    begins = begins[begins + 3 < kernel.number]
    begins = begins[kernel.owner[begins + 3] == kernel.owner[begins]][::4]
    for at in range(4):
        for name, column in (("duration", drawn.duration), ("position", drawn.position)):
            result = stats.ks_2samp(np.asarray(column)[:, at], kernel.following[name][begins + at])
            assert result.pvalue > 1e-5, (name, at)
    slips = np.diff(np.concatenate([np.zeros((3000, 1)), np.asarray(drawn.end)], axis=1)) - np.asarray(drawn.duration)
    assert np.all(slips > 0)
    assert ss.independent(sticks, "duration", starts_before=math.inf).samples == 3000


def test_sequences_after_slips_have_their_positions():
    kernel = ss.transition_kernel(SYSTEM, POISSON, after="slip", transitions=2**12)
    sticks = kernel.sample(50, 3, start={"position": 0.1, "base_velocity": 1.0})
    first = sticks.position.reshape(50, 3)[:, 0]
    np.testing.assert_array_equal(first, 0.1)
    assert np.all(sticks.duration.reshape(50, 3)[:, 0] <= 0.15 + 0.01)  # until the release at 0.25 m


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"source": 3}, "Argument ensemble must be the result of simulate_ensemble"),
        ({"after": "jump"}, "Argument after must be one of 'stick', 'slip'"),
        ({"law": None}, "must be a MassSpring with a spring, without damping"),
        ({"law": ss.Harmonic(1.0, 1.0)}, "must be a MassSpring with a spring, without damping"),
        ({"source": ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.3, mu_static=0.4))}, "without damping, force and static"),
        ({"law": ss.PoissonSwitching(ss.Uniform(1.0, 2.0), 1.0)}, "PoissonSwitching or RandomSteps"),
        ({"bins": 0}, "Argument bins must be"),
        ({"given": ("mass",)}, "Argument given must be one of"),
        ({"given": ()}, "Argument given must hold one or more"),
        ({"transitions": 1}, "Argument transitions must be"),
    ],
)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_arguments(change, message):
    arguments = {"source": SYSTEM, "law": POISSON, "transitions": 64} | change
    with pytest.raises(ValueError, match=message):
        ss.transition_kernel(arguments.pop("source"), arguments.pop("law"), **arguments)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"system": ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.0))}, "must let the mass stick again"),
        ({"law": ss.PoissonSwitching(50.0, 1.0)}, "must let the mass stick again"),
        ({"system": ss.MassSpring(1.0, 0.0, 1.0, ss.Coulomb(0.3))}, "a MassSpring with a spring"),
        ({"system": ss.MassSpring(ss.Uniform(1.0, 2.0), 4.0, 1.0, ss.Coulomb(0.3))}, "all its numbers certain"),
        ({"period": 2.0}, "Argument period must be left out with a system"),
        ({"ends_before": 2.0}, "Argument ends_before must be left out with a system"),
    ],
)
def test_motions_that_have_no_kernel_by_quadrature(change, message):
    given = {"system": SYSTEM, "law": POISSON, "transitions": 64} | change
    with pytest.raises(ValueError, match=message):
        ss.transition_kernel(given.pop("system"), given.pop("law"), **given)


@pytest.mark.filterwarnings("error")
def test_any_number_of_points_and_levels():
    """Sobol' sequences are balanced with powers of two only."""
    three = ss.RandomSteps(1.0, 0.7, levels=(-1.0, 0.0, 1.0))
    assert ss.transition_kernel(SYSTEM, three, transitions=1000).number == 5 * 1024


@pytest.mark.slow
def test_angles_of_a_motor_are_those_of_one_turn():
    """Positions are folded, displacements are not: where a stick ends is where it began, and nothing moves in it."""
    many = ss.simulate_ensemble(*ss.papers.motor_cart(0.5), samples=300, key=jax.random.key(0), keep="sticks")
    kernel = ss.transition_kernel(many)
    np.testing.assert_array_equal(kernel.state["base_velocity"], 0)
    assert np.all((kernel.state["end_position"] >= 0) & (kernel.state["end_position"] < 2 * math.pi))
    apart = kernel.following["end_position"] - kernel.following["position"]
    np.testing.assert_allclose(np.sin(apart / 2), 0, atol=1e-9)
    with pytest.raises(ValueError, match="Argument transitions must be left out with an ensemble"):
        ss.transition_kernel(many, transitions=64)


def test_a_base_whose_frequency_is_uncertain_has_no_phase():
    law = ss.RandomPhase(ss.Harmonic(1.0, ss.Uniform(2.5, 2.7)))
    assert simulated(law, 20, t1=50.0).given == ("end_position", "base_velocity", "ending")


@pytest.mark.slow
@pytest.mark.usefixtures("annotations_unchecked")
def test_contacts_of_a_structure_one_by_one():
    """The end of a stick of one block does not tell what the other does: the chain remembers more, and the test of its
    order finds it. Of each contact, and of the ensemble of all contacts.
    """
    law, friction = ss.PoissonSwitching(speed=0.5, rate=0.1), ss.Coulomb(0.5, 0.7)
    contacts = tuple(ss.Contact(way, 1.0, friction) for way in np.eye(2))
    system = ss.LinearStructure(np.diag([1.0, 1.7]), np.array([[2.0, -1.0], [-1.0, 2.0]]), contacts=contacts)
    run = {"t1": 300.0, "samples": 512, "key": jax.random.key(0), "keep": "sticks", "progress": False}
    both = ss.simulate_contacts(system, law, **run)
    for number in (0, 1):
        kernel = ss.transition_kernel(both.of_contact(number))
        alone = ss.transition_kernel(ss.simulate_ensemble(system.of_contact(number), law, **run))
        assert kernel.number == alone.number > 5_000
        np.testing.assert_allclose(kernel.second_eigenvalue.value, alone.second_eigenvalue.value, rtol=1e-9)
        assert kernel.order_test().rejected
    with pytest.raises(ValueError, match=r"of several contacts give one, \.of_contact\(0\)"):
        ss.transition_kernel(both)


def test_bad_questions(kernels):
    exact, _ = kernels
    state = {"end_position": 0.1, "base_velocity": 1.0, "ending": SWITCHED}
    for call, message in [
        (exact.joint, "Argument values must hold pairs"),
        (lambda: exact.joint(("mass", 1)), "Argument values must be one of 'slip_before'"),
        (lambda: exact.joint(("duration", 0)), "Argument values must be"),
        (lambda: exact.joint(("duration", 1), ("duration", 1)), "hold each number once"),
        (lambda: exact.joint(*(("duration", n) for n in range(1, 8))), "Argument bins must be fewer"),
        (lambda: exact.joint(("duration", 1), start="now"), "Argument start must be one of 'stationary'"),
        (lambda: exact.sample(3, 1, start={"end_position": 0.1}), "Argument state must hold a number for each of"),
        (lambda: exact.sample(3, 1, start=state | {"base_velocity": 5.0}), "must be one that a stick ended in"),
        (lambda: exact.sample(0, 1), "Argument sequences must be"),
        (lambda: exact.steps_to_forget(2.0), "Argument distance must be"),
        (lambda: exact.order_test(0.0), "Argument significance must"),
    ]:
        with pytest.raises(ValueError, match=message):
            call()


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(
    ("number", "message"),
    [
        (math.nan, "must be finite"),
        (np.ma.masked, "a single real number"),
        (0.1 + 0j, "a single real number"),
        (True, "a single real number"),
        ("0.1", "a single real number"),
        ([0.1], "a single real number"),
        (5.0, r"must be between -0\.[12]\d* and 0\.[12]\d* m, as at the ends that the kernel knows, but 5.0"),
    ],
)
def test_states_that_are_none(kernels, number, message):
    """The closest transitions to anything are some: to what is no state too."""
    state = {"end_position": number, "base_velocity": 1.0, "ending": SWITCHED}
    for call in (kernels[0].like, partial(ss.forecast, kernels[0]), lambda s: kernels[0].sample(3, 1, start=s)):
        with pytest.raises(ValueError, match=rf"Argument state\['end_position'\] .*{message}"):
            call(state)
    known = {"end_position": 0.0, "base_velocity": 1.0, "ending": RELEASED}
    with pytest.raises(ValueError, match=r"must be between 0\.25? and 0\.25? m"):  # released at the limit only
        ss.forecast(kernels[0], known)


def test_what_the_end_cuts_is_counted():
    """All ends before `ends_before` are used or counted; a record without displacements is refused."""
    many = ss.simulate_ensemble(SYSTEM, POISSON, t1=20.0, samples=300, key=jax.random.key(0), keep="sticks")
    kernel = ss.transition_kernel(many, ends_before=19.0)
    sticks = many.numbered_sticks()
    assert kernel.incomplete + kernel.number == np.sum((sticks.end < 19.0) & (sticks.ending != ss.Ending.HORIZON))
    assert 0 < kernel.incomplete < kernel.number
    assert f"{kernel.incomplete:,} ends left out" in repr(kernel)
    with pytest.raises(ValueError, match="at least 20 sticks that end before ends_before"):
        ss.transition_kernel(many, ends_before=0.01)
    table = {"sample": sticks.sample, "start": sticks.start, "end": sticks.end, "position": sticks.position}
    with pytest.raises(ValueError, match="must know the position and slip displacement"):
        ss.transition_kernel(ss.Ensemble.from_sticks(table, t1=20.0, samples=300))
    with pytest.raises(ValueError, match="Argument law must be left out"):
        ss.transition_kernel(many, POISSON)
