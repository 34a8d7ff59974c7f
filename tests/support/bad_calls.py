"""Calls of public functions and constructors with one argument, or two, of a wrong kind, and what comes of them."""

import re
import signal
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss
from stickslip_jax import papers
from support import bad_contacts
from support.bad_values import KEY, VALUES, Draw, Target, fields, takes

SECONDS = 60  # after which a call is taken for one that never ends

SYSTEM, LAW = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5)), ss.PoissonSwitching(1.0, 1.0)
TABLE = {"sample": [0, 0, 1], "start": [1.0, 3.0, 2.0], "end": [2.0, 4.0, 4.5], "position": [0.1, 0.2, 0.3]}


@cache
def many() -> ss.Ensemble:
    return ss.simulate_ensemble(SYSTEM, LAW, t1=20.0, samples=32, key=KEY, y0=(0.0, 1.0), keep="sticks")


@cache
def row_of_blocks() -> ss.Simulation:
    row = ss.block_row(2, mass=1.0, between=9.0, to_ground=1.0, normal_force=1.0, friction=ss.Coulomb(0.4, 0.5))
    return ss.simulate(row, ss.Constant(0.02), t1=60.0, y0=(0.0, 0.1, 0.02, 0.02))


ENSEMBLE = {
    "t1": (5.0, "positive"),
    "samples": (4, "whole | design"),
    "key": (KEY, "key"),
    "y0": ((0.0, 1.0), "optional start"),
}
OPTIONS = {"orders": (3, "whole"), "count_initial_rest": (False, "truth")}
RUN = {"threads": (1, "optional whole"), "chunk": (None, "optional whole"), "progress": (False, "optional truth")}
SEQUENCE = ("durations", "values", "slopes", "velocities", "times")


def systems() -> Iterator[Target]:
    yield fields(ss.Coulomb, mu=(0.5, "not negative field"), mu_static=(0.6, "optional not negative field"))
    yield fields(
        ss.MassSpring, mass=(1.0, "positive field"), stiffness=(4.0, "not negative field"),
        normal_force=(1.0, "positive field | force"), friction=(ss.Coulomb(0.5), "friction"),
        damping=(0.1, "optional not negative field"), force=(None, "optional base"),
    )  # fmt: skip
    cart = {name: (getattr(ss.MotorCart(), name), "field") for name in ("resistance", "inductance", "cart_mass")}
    yield fields(ss.MotorCart, mu=(0.2, "optional not negative field"), **cart)
    yield fields(
        ss.Stribeck, mu=(0.3, "not negative field"), mu_static=(0.5, "not negative field"),
        stribeck_speed=(0.1, "positive field"), exponent=(1.0, "field"), viscous=(0.0, "not negative field"),
    )  # fmt: skip
    yield fields(
        ss.VelocityDependent, mu_slow=(0.05, "not negative field"), mu_fast=(0.1, "not negative field"),
        rate=(20.0, "positive field"), mu_static=(None, "optional not negative field"),
    )  # fmt: skip
    yield fields(ss.VelocityWeakening, mu_static=(0.5, "not negative field"), weakening=(1.0, "not negative field"))
    yield fields(ss.FrictionCurve, curve=(lambda v: 0.5, "function"), mu_static=(None, "optional not negative field"))
    yield from laws_with_a_memory()


def laws_with_a_memory() -> Iterator[Target]:
    yield fields(
        ss.Directional, forward=(ss.Coulomb(0.5), "plain friction"), backward=(ss.Coulomb(0.3), "plain friction")
    )
    yield fields(ss.OneWay, forward=(ss.Coulomb(0.0), "plain friction"), capacity=(1e3, "positive field"))
    yield fields(ss.Ageing, law=(ss.Coulomb(0.5), "plain friction"), growth=(ss.ExponentialGrowth(0.1, 1.0), "growth"))
    yield fields(
        ss.SlipWeakening, static=(0.6, "positive field"), dynamic=(0.4, "not negative field"),
        distance=(0.02, "positive field"), healing=(None, "optional positive field"),
    )  # fmt: skip
    for growth in (ss.ExponentialGrowth, ss.LogarithmicGrowth):
        yield fields(growth, amount=(0.1, "not negative field"), time=(1.0, "positive field"))
    bristles = {
        "mu": (0.3, "positive field"), "mu_static": (0.5, "positive field"), "stribeck_speed": (0.1, "positive field"),
        "stiffness": (1e3, "positive field"), "damping": (1.0, "not negative field"),
        "viscous": (0.0, "not negative field"),
    }  # fmt: skip
    yield fields(ss.LuGre, **bristles)
    yield fields(ss.ElastoPlastic, **bristles, breakaway=(0.7, "not negative field"))
    yielding = {
        "mu": (0.3, "positive field"),
        "stiffness": (1e3, "positive field"),
        "exponent": (1.0, "positive field"),
    }
    yield fields(ss.Dahl, **yielding)
    yield fields(ss.BoucWen, **yielding, sharing=(0.5, "not negative field"))
    yield fields(
        ss.DieterichRuina, mu=(0.6, "positive field"), direct=(0.01, "positive field"),
        evolution=(0.015, "not negative field"), length=(1e-5, "positive field"),
        reference_speed=(1e-6, "positive field"), form=("slip", "never"),
        second_evolution=(-0.01, "field"), second_length=(1e-4, "positive field"),
    )  # fmt: skip
    motion = {"times": ([0.0, 1.0], "array"), "velocity": ([0.1, 0.1], "array | base"),
              "normal_force": (1.0, "not negative | array")}  # fmt: skip
    yield fields(
        ss.Dahl(0.3, 1e3).force, **motion, initial_state=(None, "optional number"), rtol=(1e-6, "positive"),
        max_steps=(None, "optional whole"), adjoint=(None, "optional never"),
    )  # fmt: skip
    spring = {"series_stiffness": (1e3, "optional positive"), "backlash": (1e-3, "not negative")}
    yield fields(ss.Dahl(0.3, 1e3).force, **motion, **spring)
    rock = ss.DieterichRuina(0.6, 0.01, 0.015, 1.0, 0.1)
    yield fields(rock.force, **motion, **spring, initial_state=(None, "optional number"))
    yield fields(ss.Coulomb(0.3).force, **motion, **spring)


def constructors() -> Iterator[Target]:
    yield from systems()
    yield fields(ss.Constant, speed=(1.0, "field"))
    yield fields(ss.SquareWave, speed=(1.0, "positive field"), period=(2.0, "positive field"))
    yield fields(
        ss.PoissonSwitching, speed=(1.0, "positive field"), rate=(1.0, "positive field"), first_sign=("random", "never")
    )
    yield fields(
        ss.RandomSteps, speed=(1.0, "positive field"), interval=(1.0, "positive field"), levels=((-1.0, 1.0), "array"),
        probabilities=(None, "optional array"),
    )  # fmt: skip
    yield fields(ss.PiecewiseConstant, times=([0.0, 1.0], "array"), velocities=([1.0, 2.0], "array"))
    yield fields(
        ss.SemiMarkovSwitching, gap=(ss.Uniform(0.5, 1.0), "distribution"), speed=(1.0, "positive | distribution"),
        alternating=(True, "truth"), first_sign=("random", "never"),
    )  # fmt: skip
    yield fields(ss.Recorded, times=([0.0, 1.0], "array"), values=([1.0, 2.0], "array"))
    yield fields(ss.GroundAcceleration, times=([0.0, 1.0], "array"), accelerations=([1.0, 2.0], "array"))
    ground = ss.GroundAcceleration([0.0, 1.0], [1.0, 0.0])
    yield fields(
        ss.RecordSuite, records=([ground], "never | path"), scale=(1.0, "field"), record=(None, "optional field"),
    )  # fmt: skip
    yield fields(ss.RecordSuite([ground]).at_scales, scales=([1.0, 2.0], "array"))
    yield fields(
        ss.VelocitySteps, ("durations",), durations=(np.array([1.0, 1.0]), "array"),
        velocities=(np.array([1.0, 2.0]), "array"),
    )  # fmt: skip
    yield fields(
        ss.VelocitySegments, SEQUENCE, durations=([1.0, 1.0], "array | any"), values=([1.0, 2.0], "array"),
        slopes=([0.0, 0.0], "array"), may_jump=(True, "truth"),
    )  # fmt: skip
    yield fields(
        ss.Harmonic, amplitude=(1.0, "field"), angular_frequency=(1.0, "positive field"), phase=(0.0, "field"),
        offset=(0.0, "field"),
    )  # fmt: skip
    yield fields(
        ss.SumOfHarmonics, amplitudes=([1.0], "array"), angular_frequencies=([1.0], "array"),
        phases=(None, "optional array"), offset=(0.0, "field"),
    )  # fmt: skip
    yield fields(
        ss.SourceVoltage, mean=(1.0, "field"), amplitude=(1.0, "field"), angular_frequency=(1.0, "positive field"),
        phase=(0.0, "field"),
    )  # fmt: skip
    yield fields(ss.RandomPhase, signal=(ss.Harmonic(1.0, 1.0), "base"))
    yield fields(ss.WithJumps, ("base",), motion=(ss.Harmonic(1.0, 1.0), "base"), jumps=(LAW, "base"))
    yield fields(
        ss.KanaiTajimi, rms=(1.0, "positive field"), ground_frequency=(15.0, "positive field"),
        ground_damping=(0.6, "positive field"), interval=(0.02, "positive field"),
    )  # fmt: skip
    yield fields(
        ss.KanaiTajimiSpectrum, intensity=(1.0, "positive field"), ground_frequency=(15.0, "positive field"),
        ground_damping=(0.6, "positive field"),
    )  # fmt: skip
    yield fields(ss.TabulatedSpectrum, angular_frequencies=([0.0, 1.0], "array"), densities=([1.0, 1.0], "array"))
    yield fields(ss.VelocitySpectrum, acceleration=(ss.CloughPenzienSpectrum(), "function"))
    yield fields(
        ss.GaussianProcess, spectrum=(ss.KanaiTajimiSpectrum(), "function"), cutoff=(50.0, "positive field"),
        rms=(None, "optional positive field"), mean=(0.0, "field"), harmonics=(16, "whole"),
    )  # fmt: skip


def numbers_and_methods() -> Iterator[Target]:
    yield fields(ss.Uniform, low=(0.0, "number"), high=(1.0, "number"))
    yield fields(ss.Normal, mean=(0.0, "number"), std=(1.0, "positive"))
    yield fields(ss.LogNormal, median=(1.0, "positive"), log_std=(1.0, "positive"))
    yield fields(ss.LogNormal.from_moments, ("median", "log_std"), mean=(1.0, "positive"), std=(1.0, "positive"))
    yield fields(ss.Beta, a=(1.0, "positive"), b=(1.0, "positive"), low=(0.0, "number"), high=(1.0, "number"))
    yield fields(ss.Triangular, low=(0.0, "number"), mode=(0.5, "number"), high=(1.0, "number"))
    yield fields(ss.Exponential, mean=(1.0, "positive"))
    yield fields(ss.Weibull, scale=(1.0, "positive"), shape=(1.0, "positive"))
    yield fields(ss.Discrete, values=([1.0, 2.0], "array"), probabilities=(None, "optional array"))
    yield fields(
        ss.Truncated, distribution=(ss.Normal(0.0, 1.0), "distribution"), low=(-1.0, "optional number"),
        high=(1.0, "optional number"),
    )  # fmt: skip
    yield fields(ss.GaussianCopula, names=(("a", "b"), "words"), correlation=(np.eye(2), "any"))
    yield fields(ss.GaussianCopula.from_spearman, names=(("a", "b"), "words"), matrix=(np.eye(2), "any"))
    yield fields(
        ss.Exact, step=(None, "optional positive"), max_steps=(None, "optional whole"), solver=(None, "optional never")
    )
    yield fields(
        ss.Regularized, width=(0.1, "optional positive"), shape=("linear", "never"), step=(None, "optional positive"),
        solver=(None, "optional never"), rtol=(1e-5, "positive"), atol=(None, "optional number or array | any"),
        max_steps=(None, "optional whole"), threshold=(None, "optional positive per contact"),
        minimum_duration=(None, "optional not negative per contact"), adjoint=(None, "optional never"),
    )  # fmt: skip
    yield fields(ss.Quantity, unit=("m", "any"), above=(None, "any"))
    for sampled in (LAW, ss.KanaiTajimi(1.0), ss.SemiMarkovSwitching(ss.Uniform(0.5, 1.0), 1.0)):
        yield fields(sampled.sample, key=(KEY, "key"), t1=(2.0, "positive"))
    yield fields(LAW.sample, key=(KEY, "key"), t1=(2.0, "positive"), capacity=(4, "optional whole"))


def designs() -> Iterator[Target]:
    drawn = {
        "names": (["mu", "mass"], "words"),
        "realization": ("own", "array | word"),
        "seed": (0, "whole or zero | key"),
    }
    yield fields(ss.design.random, ("key",), samples=(4, "whole"), dimensions=(None, "optional whole"), **drawn)
    yield fields(
        ss.design.latin_hypercube, ("key",), samples=(4, "whole"), dimensions=(None, "optional whole"), **drawn
    )
    yield fields(ss.design.sobol, ("key",), samples=(4, "whole"), scramble=(True, "truth"), **drawn)
    yield fields(
        ss.design.saltelli, ("key", "dimensions"), base_samples=(4, "whole"), second_order=(True, "truth"),
        scramble=(True, "truth"), **drawn,
    )  # fmt: skip
    yield fields(ss.design.grid, values=({"mu": [0.5, 1.0]}, "any"), realization=("own", "array | word"))
    yield fields(lambda values: ss.design.grid({"mu": values, "mass": [1.0]}), values=([0.5, 1.0], "array | any"))
    yield fields(
        ss.design.table, numbers=([[0.5, 1.0]], "any"), names=(["mu", "mass"], "words"), uniform=(False, "truth"),
        realization=("own", "array | word"),
    )  # fmt: skip
    yield fields(
        ss.design.Design, kind=("table", "word"), names=(("mu",), "optional words"), u=(None, "optional never"),
        values=([[0.5], [1.0]], "any"), realization=([0, 1], "array"), base_samples=(None, "optional whole"),
        second_order=(False, "truth"),
    )  # fmt: skip


def runs() -> Iterator[Target]:
    yield fields(
        ss.simulate, system=(SYSTEM, "system"), base=(ss.Constant(1.0), "base"), t1=(5.0, "positive"),
        y0=((0.0, 1.0), "optional start"), method=(ss.Exact(), "method"),
    )  # fmt: skip
    yield fields(
        ss.simulate_ensemble, ("base", "mu"), system=(SYSTEM, "system"), law=(LAW, "base"), **ENSEMBLE, **OPTIONS,
        **RUN, correlation=(None, "optional never"), method=(ss.Exact(), "method"), keep=("totals", "never | word"),
        first_sample=(0, "whole or zero"),
    )  # fmt: skip
    yield fields(
        ss.sensitivity, ("base", "samples", "mu"), statistic=(ss.stick_fraction, "function"), system=(SYSTEM, "system"),
        law=(LAW, "base"), wrt=("mu", "word"), **{**ENSEMBLE, "samples": (64, "whole")}, elasticity=(False, "truth"),
        estimator=(None, "optional word"), step=(None, "optional positive"), method=(ss.Exact(), "method"),
        relative_bandwidth=(None, "optional positive"), threads=(1, "optional whole"),
    )  # fmt: skip
    yield fields(
        ss.Sweep, ("base", "mu", "point"), system=(SYSTEM, "system"), law=(LAW, "base"),
        over=({"mu": [0.5, 1.0]}, "any"), **{**ENSEMBLE, "samples": (4, "whole")}, **OPTIONS,
        method=(ss.Exact(), "method"), keep=("totals", "never | word"), statistics=(None, "any"),
        sensitivities=((), "any"), independent=(False, "truth"), standard_error=(None, "any"),
        realizations=(0, "whole or zero"), batch=(None, "optional whole"),
    )  # fmt: skip
    sweep = ss.Sweep(SYSTEM, LAW, over={"mu": [0.5, 1.0]}, t1=5.0, samples=4, key=KEY, keep="totals")
    yield fields(
        lambda values: ss.Sweep(SYSTEM, LAW, over={"mu": values}, t1=5.0, samples=4, key=KEY, keep="totals"),
        ("over", "mu"), values=([0.5, 1.0], "array"),
    )  # fmt: skip
    yield fields(
        sweep.ensemble_at, ("Arguments",), mu=(0.5, "number"), samples=(4, "optional whole"), keep=("totals", "word")
    )
    yield fields(ss.Sweep.load, folder=("nowhere", "never"))
    yield fields(ss.load, path=("nowhere.nc", "never"))
    yield fields(
        ss.Ensemble.from_sticks, table=(TABLE, "any"), t1=(5.0, "positive"), samples=(2, "optional whole"),
        position_unit=("m", "optional word"), period=(None, "optional positive"), **OPTIONS,
    )  # fmt: skip
    for column, usual in TABLE.items():
        yield fields(
            lambda values, column=column: ss.Ensemble.from_sticks({**TABLE, column: values}, t1=5.0, samples=2),
            ("table", "samples"), values=(usual, "array | any"),
        )  # fmt: skip
    yield fields(ss.Ensemble.from_simulations, result=(None, "never"), **OPTIONS)
    yield fields(
        sweep.run, ("shared_folder",), folder=(None, "optional path"), threads=(1, "optional whole"),
        workers=(None, "optional never"), shared_folder=(False, "truth"), progress=(False, "optional truth"),
    )  # fmt: skip


def results() -> Iterator[Target]:
    ensemble = (many(), "never")
    yield fields(
        ss.bootstrap_interval, ensemble=ensemble, statistic=(ss.stick_fraction, "never"), level=(0.9, "positive"),
        resamples=(100, "whole"), seed=(0, "whole or zero"),
    )  # fmt: skip
    yield fields(ss.convergence, ensemble=ensemble, statistic=(ss.stick_fraction, "never"), points=(4, "whole"))
    yield fields(
        ss.histogram_convergence, ensemble=ensemble, x=("duration", "never | word"), y=("position", "never | word"),
        bins=(4, "whole"), points=(3, "whole"),
    )  # fmt: skip
    yield fields(ss.first_stick, ensemble=ensemble, count_initial_rest=(False, "truth"))
    tested = {"significance": (0.05, "share"), "starts_before": (None, "any")}
    yield fields(
        ss.identically_distributed, source=ensemble, quantity=("duration", "never | word"), orders=(2, "whole | array"),
        **tested,
    )  # fmt: skip
    yield fields(
        ss.independent, ("lag",), source=ensemble, quantity=("duration", "never | word"), lag=(1, "whole or zero"),
        first=(1, "whole"), bins=(3, "whole"), **tested,
    )  # fmt: skip
    kernel = ss.transition_kernel(SYSTEM, LAW, transitions=64)
    yield fields(
        ss.transition_kernel, ("ensemble", "law"), source=(SYSTEM, "system"), law=(LAW, "any"),
        after=("stick", "never | word"), bins=(4, "whole"), transitions=(64, "optional whole"),
    )  # fmt: skip
    yield fields(
        lambda start, bins: kernel.joint(("duration", 1), start=start, bins=bins), ("state",),
        start=("stationary", "never | word"), bins=(4, "whole"),
    )  # fmt: skip
    yield fields(
        ss.forecast, kernel=(kernel, "never"), elapsed=(0.0, "not negative"), neighbours=(None, "optional whole"),
        state=({"end_position": 0.1, "base_velocity": 1.0, "ending": 1.0}, "never"),
    )  # fmt: skip
    yield fields(
        ss.score_forecasts, kernel=(kernel, "never"), record=(kernel, "never"), neighbours=(50, "whole"),
        seed=(0, "whole or zero"),
    )  # fmt: skip
    yield fields(
        ss.sobol_indices, outputs=(np.ones(24), "any"), design=(ss.design.saltelli(4, ["mu", "mass"]), "design"),
    )  # fmt: skip
    yield fields(ss.catalogue, source=(row_of_blocks(), "never"))
    events = ss.catalogue(row_of_blocks())
    yield fields(events.slope, least=(1e-3, "positive"))
    yield fields(events.frequencies, bins=(4, "whole"))
    yield fields(ss.common_bins, distributions=([many().statistics.duration], "never"), bins=(4, "optional whole"))
    yield fields(ss.concatenate, ensembles=([many()], "never"))
    yield fields(
        many().extended, samples=(2, "whole"), threads=(1, "optional whole"), progress=(False, "optional truth")
    )
    yield fields(many().realization, number=(0, "whole or zero"))
    yield fields(many().statistics.order, number=(1, "whole"))
    yield fields(many().statistics.joint, x=("duration", "word"), y=("position", "word"))
    yield fields(many().statistics.duration.histogram, bins=(4, "any"))
    yield fields(ss.read_recorded_csv, path=("missing.csv", "path"), scale=(1.0, "number"), delimiter=(",", "any"))
    yield fields(ss.read_at2, path=("missing.at2", "path"), g=(9.81, "positive"))
    yield from of_earthquakes()
    for paper in (papers.square_wave_belt, papers.harmonic_belt, papers.random_belt):
        yield fields(paper, ratio=(1.0, "positive field"), mu=(1.0, "not negative field"))
    yield fields(papers.motor_cart, mu=(0.2, "not negative field"), t1=(2.0, "positive"))
    yield fields(papers.parametric_analysis, samples=(4, "whole"), t1=(5.0, "positive"), seed=(0, "any"))


def of_earthquakes() -> Iterator[Target]:
    ground = [ss.GroundAcceleration([0.0, 1.0], [1.0, 0.0])]
    yield fields(
        ss.response_spectrum, records=(ground, "never"), periods=([1.0], "array"), damping=(0.05, "not negative"),
        threads=(1, "optional whole"), progress=(False, "optional truth"),
    )  # fmt: skip
    yield fields(
        ss.sliding_spectrum, records=(ground, "never"), periods=([1.0], "array | positive"),
        mu=([0.1], "array | not negative"), damping=(0.0, "not negative"), gravity=(9.81, "positive"),
        t1=(1.0, "optional positive"),
    )  # fmt: skip
    yield fields(
        ss.incremental_dynamic_analysis, ("record", "law"), system=(SYSTEM, "system"), records=(ground, "never"),
        scales=([1.0], "array"), outputs=({"end": lambda one: one.final_state[0]}, "nothing"),
        t1=(1.0, "optional positive"), y0=(None, "optional start"), key=(None, "optional key"),
        period=(None, "optional positive"), progress=(False, "optional truth"),
    )  # fmt: skip
    fit = ss.fragility([1.0, 2.0, 3.0, 4.0], [False, True, False, True])
    yield fields(
        ss.fragility, intensity=([1.0, 2.0, 3.0, 4.0], "reals"), exceeds=([False, True, False, True], "reals"),
        trials=(None, "optional reals"), records=(None, "optional any"),
    )  # fmt: skip
    yield fields(fit.interval, intensity=(1.0, "reals"), level=(0.9, "share"))


def calibrations() -> Iterator[Target]:
    times, base = np.linspace(0.0, 5.0, 26), ss.Harmonic(0.8, 1.3)
    seen = np.asarray(ss.simulate(SYSTEM, base, t1=5.0, y0=(0.3, 0.0)).evaluate(times)[0]) + 1e-3 * np.cos(9 * times)
    record = {
        "system": (SYSTEM, "system"), "base": (base, "never | signal | number"), "times": (times, "never"),
        "measured": ({"position": seen}, "never"), "wrt": ("mu", "word"), "noise": (None, "optional nothing"),
        "y0": ((0.3, 0.0), "optional start"), "observe": (None, "optional nothing"), "method": (ss.Exact(), "method"),
    }  # fmt: skip
    given = {name: usual for name, (usual, _) in record.items()}
    for fit in (ss.calibrate, ss.log_likelihood):
        rest = {"windows": (1, "optional whole")} if fit is ss.calibrate else {}
        also = ("base", "mu", "position")
        yield fields(fit, also, **record, **rest)
        yield fields(
            lambda column, fit=fit: fit(**{**given, "measured": {"position": column}}), ("measured",),
            column=(seen, "never"),
        )  # fmt: skip
        yield fields(
            lambda deviation, fit=fit: fit(**{**given, "noise": {"position": deviation}}), ("noise",),
            deviation=(0.01, "positive"),
        )  # fmt: skip
    likelihood = ss.log_likelihood(**given)
    yield fields(
        likelihood.__call__,
        ("mu",),
        values=({"mu": 0.5}, "mapping | array"),
        noise=({"position": 0.1}, "never"),
    )
    yield fields(lambda mu: likelihood({"mu": mu}, noise={"position": 0.1}), ("values",), mu=(0.5, "any"))
    sticks = {
        "system": (SYSTEM, "system"), "law": (LAW, "base"), "wrt": ("mu", "word"), "y0": ((0.0, 1.0), "optional start"),
        "method": (ss.Exact(), "method"), "threads": (1, "optional whole"),
    }  # fmt: skip
    yield fields(
        ss.calibrate_sticks, ("base", "mu"), **sticks, observed=(many(), "never"), samples=(64, "whole"),
        key=(KEY, "key"), moments=(None, "optional never"), objective=("moments", "never"),
        estimator=(None, "optional never"),
    )  # fmt: skip
    yield fields(
        ss.sticks_of_record, ("records",), times=(times, "never"), speed=(np.cos(times), "array"),
        threshold=(0.1, "positive"), minimum_duration=(None, "optional not negative"),
    )  # fmt: skip
    yield fields(
        lambda **given: ss.stick_simulator(**given)([[0.5]], KEY), ("base", "mu"), **sticks, t1=(5.0, "positive"),
        realizations=(1, "whole"), summaries=(None, "optional never"),
    )  # fmt: skip
    simulator = ss.stick_simulator(SYSTEM, LAW, wrt="mu", t1=5.0, y0=(0.0, 1.0), threads=1)
    yield fields(simulator.__call__, ("mu",), parameters=([[0.5]], "table"), key=(KEY, "key"))


TARGETS: dict[str, Callable[[], Iterator[Target]]] = {
    each.__name__: each for each in (
        constructors, numbers_and_methods, designs, runs, results, calibrations, bad_contacts.structures,
        bad_contacts.periods,
    )
}  # fmt: skip


# --- what comes of a call


class _TooLongError(BaseException):
    pass


def _stop(*_: Any) -> None:
    raise _TooLongError


def outcome(target: Target, wrong: dict[str, Any]) -> str:
    """What is obscure about a call with `wrong` arguments; "" if nothing is."""
    signal.signal(signal.SIGALRM, _stop)
    signal.alarm(SECONDS)
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            target.call(**{**target.usual, **wrong})
        taken = [name for name, value in wrong.items() if not takes(target.kinds[name], value)]
        foreign = [str(one.message) for one in warned if not _of_package(one)]
        return f"taken: {', '.join(taken)}" if taken else f"warned: {foreign[0]}" if foreign else ""
    except _TooLongError:
        return "does not end"
    except MemoryError:
        return "MemoryError"
    except (ValueError, OSError) as error:
        if warned:
            return f"warned before it was refused: {warned[0].message}"
        return judged(str(error), (*target.kinds, *target.also), type(error))
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:200]}"
    finally:
        signal.alarm(0)
        plt.close("all")


def judged(said: str, names: tuple[str, ...], kind: type[BaseException]) -> str:
    """What is obscure about a refusal; "" if it is one sentence that names an argument."""
    named = any(re.search(rf"(?<!\w){re.escape(name)}(?!\w)", said) for name in names)
    is_sentence = re.fullmatch(r"[^\n]*[^.\n][.?]", said) and len(said) < 2000
    if named and is_sentence and kind in (ValueError, ss.SweepError, FileNotFoundError, OSError):
        return ""
    return f"{kind.__name__}: {said[:300]}"


def _of_package(one: warnings.WarningMessage) -> bool:
    """A warning that the package means: it is a sentence of its own."""
    said, where = str(one.message), str(one.filename)
    is_ours = "stickslip_jax" in where or (said.endswith(".") and where.endswith("bad_calls.py"))  # by its stack level
    starts = ("The ", "No two", "stickslip_jax runs")
    return (one.category in (RuntimeWarning, UserWarning) and is_ours) or said.startswith(starts)


def cases(draw: Draw, group: str, pairs: int) -> Iterator[tuple[str, Target, dict[str, Any]]]:
    """Every argument with a value of every kind, then `pairs` times two wrong ones at once."""
    targets = list(TARGETS[group]())
    for target in targets:
        for name in target.kinds:
            for kind, value in VALUES.items():
                yield f"{_name(target)} {name} = {kind}", target, {name: value(draw)}
    several = [target for target in targets if len(target.kinds) > 1]
    for _ in range(pairs):
        target = several[draw.integers(len(several))]
        one, other = draw.choice(list(target.kinds), 2, replace=False)
        kinds = draw.choice(list(VALUES), 2)
        wrong = {str(name): VALUES[kind](draw) for name, kind in zip((one, other), kinds, strict=True)}
        yield f"{_name(target)} {one} = {kinds[0]}, {other} = {kinds[1]}", target, wrong


def _name(target: Target) -> str:
    return getattr(target.call, "__qualname__", repr(target.call)[:60])


def started() -> None:
    """Set JAX up as users should."""
    jax.config.update("jax_enable_x64", True)
