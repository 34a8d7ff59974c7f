"""Bad input of `calibrate_sticks` gives an error that names the argument and says what to do."""

import jax
import pytest

import stickslip_jax as ss

T1 = 30.0
SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.2))
LAW = ss.PoissonSwitching(speed=0.7, rate=0.9)


def sticks(recordings=8, same=False):
    """A stick in each recording, and two more in some."""
    lengths = [1.0 if same else 1.0 + 0.1 * (3 * number % 8) for number in range(recordings)]
    later = [] if same else list(range(0, recordings, 2))
    table = {
        "sample": [*range(recordings), *later, *later[::2]],
        "start": [2.0 if same else 2.0 + 0.01 * number**2 for number in range(recordings)]
        + [20.0] * len(later) + [25.0] * len(later[::2]),
        "duration": lengths + [0.5] * len(later) + [1.3] * len(later[::2]),
    }  # fmt: skip
    return ss.Ensemble.from_sticks(table, t1=T1, samples=recordings)


def no_sticks():
    return ss.Ensemble.from_sticks({"sample": [], "start": [], "duration": []}, t1=T1, samples=3)


def totals_only():
    return ss.simulate_ensemble(
        SYSTEM, LAW, t1=T1, samples=4, key=jax.random.key(0), keep="totals", progress=False
    )  # fmt: skip


def unfinished():
    return ss.simulate_ensemble(
        ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.2), damping=0.1), LAW, t1=T1,
        samples=4, key=jax.random.key(0), keep="sticks", progress=False, method=ss.Exact(max_steps=3),
    )  # fmt: skip


BAD = {
    "a table": (
        {"observed": lambda: {"start": [1.0]}},
        r"Argument observed must be an Ensemble, as Ensemble\.from_sticks makes one of measured sticks, but ",
    ),
    "none": ({"observed": list}, r"Argument observed must be an Ensemble or a list of them, at least one, but \[\]"),
    "no sticks": (
        {"observed": no_sticks},
        r"Argument observed must hold sticks, but its 3 recordings have none: nothing of sticks can be fitted",
    ),
    "totals": ({"observed": totals_only}, r'Argument observed must hold every stick, .* keep="sticks"\.'),
    "few": (
        {"observed": lambda: [sticks(), sticks(4)]},
        r"Argument observed\[1\] must hold at least 6 recordings for the covariance of 4 moments, but it holds 4; ",
    ),
    "no scatter": (
        {"observed": lambda: sticks(same=True), "moments": [ss.mean_stick_count]},
        r"Argument moments must differ between recordings, but 'mean number of sticks' is the same in all of observed",
    ),
    "dependent": (
        {"moments": [ss.mean_total_stick_time, ss.stick_fraction]},
        r"Argument moments must not determine each other, but in observed one of 'mean total stick time', 'stick fra",
    ),
    "fewer than parameters": (
        {"wrt": ("mu", "rate"), "moments": [ss.mean_stick_count]},
        r"Argument moments must hold at least as many moments as there are parameters, 2, but there are 1; ",
    ),
    "slips": (
        {"moments": [ss.mean_slip_count]},
        r"Argument moments must hold statistics of sticks, .* but 'mean number of slips' was given; ",
    ),
    "an unknown moment": ({"moments": "mean"}, r"Argument moments must be stick_fraction, "),
    "a ratio in a likelihood": (
        {"moments": [ss.mean_stick_duration], "objective": "likelihood"},
        r"Argument moments must hold means over all realisations with objective=\"likelihood\", but 'mean stick dur",
    ),
    "a name": ({"wrt": "nu"}, r"Argument wrt must name one of system\.mass, .*, but 'nu' was given"),
    "at a bound": (
        {"system": ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu=0.0)), "wrt": "mu"},
        r"Argument wrt must name numbers whose first guess lies inside their bounds, above 0, but mu = 0 was given",
    ),
    "systems": (
        {"system": [SYSTEM, SYSTEM]},
        r"Argument system must be one for all, or a list with one for each of the 1 ensembles in observed, but 2 were",
    ),
    "an objective": (
        {"objective": "likely"}, r"Argument objective must be one of 'moments', 'likelihood', but 'likely' was given",
    ),
    "an estimator": (
        {"estimator": "exact"}, r"Argument estimator must be one of 'corrected', 'finite-difference', but 'exact' was",
    ),
    "an estimator of exact events": (
        {"estimator": "corrected", "method": ss.Regularized(0.1)},
        r"Argument estimator must be 'finite-difference' \(the default here\), .* with regularised dynamics",
    ),
    "no system": ({"system": 3.0}, r"Argument system must be a MassSpring, "),
    "no law": ({"law": "mu"}, r"Argument law must be a base motion such as Harmonic"),
    "no start": ({"y0": {"position": 0.0}}, r"Argument y0 must be a tuple with the initial value of each coordinate"),
    "no chance": (
        {"law": ss.Constant(speed=0.7), "y0": (0.0, 0.0)},
        r"Argument law must be random, or system or y0 hold a distribution such as Uniform: without chance the ",
    ),
    "no key": ({"key": None}, r"Argument key must be a key such as jax\.random\.key"),
    "samples": ({"samples": 0}, r"Argument samples must be a whole number of at least 2, but 0 was given"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize("case", BAD)
def test_bad_input(case):
    given, message = BAD[case]
    options = {"system": SYSTEM, "law": LAW, "observed": sticks, "wrt": "mu", "samples": 256, "key": jax.random.key(0)}
    options |= given
    first = [options.pop(name) for name in ("system", "law")]
    data = options.pop("observed")()
    with pytest.raises(ValueError, match=rf"\A{message}"):
        ss.calibrate_sticks(*first, data, **options)


@pytest.mark.slow
def test_realisations_that_did_not_finish():
    data = unfinished()
    with pytest.raises(ValueError, match=r"\AArgument observed must hold realisations that reached t1, but 4 of 4"):
        ss.calibrate_sticks(SYSTEM, LAW, data, wrt="mu", samples=256, key=jax.random.key(0))
