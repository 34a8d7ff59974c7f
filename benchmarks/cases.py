"""What the workers time: functions of the round's number that return the work they did. Public functions only."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import stickslip_jax as ss
from stickslip_jax._numerics.elementary import exponential, fine_uniform

from . import compiled, derivatives
from .baselines import scipy_lugre
from .lock import held_share
from .setups import (
    BELT,
    BESIDE_BRISTLES,
    BUILDING,
    ENSEMBLES,
    EVERY_STICK,
    HARMONIC,
    INNER_TOLERANCES,
    INTERVALS,
    LAW,
    MEAN,
    ON_BRISTLES,
    ON_HARMONIC,
    ONE_TRAJECTORY,
    OWN_ENGINES,
    RANDOM_PHASE,
    RATE,
    REGULARIZED,
    SHAKEN,
    SPEED,
    START,
    STICK_TIME,
    T1,
    THREADS,
    TWO_BLOCKS,
    WIDE,
    basin_name,
    chain,
    chain_name,
    chain_time,
    diagram_name,
    inner_name,
    quake,
    starts,
    system,
)
from .sizes import FULL, TINY, Sizes


class Work(NamedTuple):
    """Work done, in the unit of the part, and error of the result."""

    amount: float = 1.0
    error: float | None = None


Run = Callable[[int], Work]


def _ensemble(keep: ss.Keep, threads: int, sizes: Sizes) -> Run:
    """The conference paper's study from call to result."""

    def run(number: int) -> Work:
        many = ss.simulate_ensemble(
            system(), LAW, t1=T1, samples=sizes.samples, key=jax.random.key(number), y0=START,
            keep=keep, threads=threads, progress=False,
        )  # fmt: skip
        assert many.finished == sizes.samples
        return Work(sizes.samples * INTERVALS)

    return run


def _uncertain(threads: int, sizes: Sizes) -> Run:
    """The conference paper's study, each sample with its own numbers: as many intervals, about as many sticks."""
    moved = ss.MassSpring(
        mass=1.0, stiffness=ss.LogNormal(4.0, 0.1), normal_force=1.0, friction=ss.Coulomb(ss.Uniform(0.8, 1.2))
    )
    y0 = (ss.Uniform(-0.5, 0.5), ss.Uniform(-1.0, 1.0))

    def run(number: int) -> Work:
        many = ss.simulate_ensemble(
            moved, LAW, t1=T1, samples=sizes.samples, key=jax.random.key(number), y0=y0, keep="totals",
            threads=threads, progress=False,
        )  # fmt: skip
        assert many.finished == sizes.samples
        return Work(sizes.samples * INTERVALS)

    return run


def _handed_on(sizes: Sizes) -> Run:
    """Every stick kept, in ten calls; what each returns is dropped after use: memory does not grow."""
    part = -(-sizes.samples // 10)

    def run(number: int) -> Work:
        sticks = 0
        for key in jax.random.split(jax.random.key(number), 10):
            many = ss.simulate_ensemble(
                system(), LAW, t1=T1, samples=part, key=key, y0=START, keep="sticks", threads=1, progress=False
            )
            sticks += 0 if many.flat_sticks is None else many.flat_sticks.start.size
        assert sticks > 0
        return Work(10 * part * INTERVALS)

    return run


# --- where the time of a base interval goes


class CheapBits(ss.PoissonSwitching):
    """Bits by two multiplications, which are not random enough, in place of those by Threefry."""

    def draw(self, key_data: Any, number: Any, dtype: Any) -> Any:
        high, low = _bits(key_data, number)
        return exponential(high, low, dtype)


class NoLogarithm(ss.PoissonSwitching):
    """Cheap bits, and gaps of uniform distribution, of the same mean."""

    def draw(self, key_data: Any, number: Any, dtype: Any) -> Any:
        high, low = _bits(key_data, number)
        return 2 * fine_uniform(high, low, dtype)


def _bits(key_data: Any, number: Any) -> Any:
    bits = (number * np.uint32(2654435761)) ^ key_data[0]
    return bits * np.uint32(2246822519), bits ^ key_data[1]


for _law in (CheapBits, NoLogarithm):  # compiled as the package's own laws are
    _law.__module__ = ss.PoissonSwitching.__module__

WITHOUT: dict[str, ss.PoissonSwitching] = {
    "totals": LAW,
    "totals, without Threefry": CheapBits(speed=SPEED, rate=RATE),
    "totals, without random numbers": NoLogarithm(speed=SPEED, rate=RATE),
}


def _without(name: str, sizes: Sizes) -> Run:
    """The conference paper's study on one thread, its random numbers by less and less work."""

    def run(number: int) -> Work:
        many = ss.simulate_ensemble(
            system(), WITHOUT[name], t1=T1, samples=sizes.samples, key=jax.random.key(number), y0=START,
            keep="totals", threads=1, progress=False,
        )  # fmt: skip
        assert many.finished == sizes.samples
        return Work(sizes.samples * INTERVALS)

    return run


def _locked(keep: ss.Keep, sizes: Sizes) -> Run:
    """Five times as many samples on one thread; the error is the share of the time under Python's lock."""

    def run(number: int) -> Work:
        many = sizes._replace(samples=5 * sizes.samples)
        return Work(many.samples * INTERVALS, held_share(lambda: _ensemble(keep, 1, many)(number)))

    return run


# --- `simulate` under vmap, sampling included


class Own(NamedTuple):
    """Programs of one's own: `simulate` of a friction coefficient and one of the inputs, which `inputs` gives by the
    round's number; and `together`, the same samples by `simulate_ensemble`, given that number and threads.
    """

    samples: int
    work: float
    simulate: Callable[[Any, Any], ss.Simulation]
    inputs: Callable[[int], Any]
    together: Callable[[int, int], Any]
    mu: float = 1.0


def _own(engine: str, sizes: Sizes) -> Own:
    samples = sizes.vmapped if engine == "Poisson switching" else sizes.vmapped_stepped
    quiet = {"samples": samples, "keep": "totals", "progress": False}
    if engine == "two blocks":
        t1, still = sizes.blocks_t1, (0.0, 0.0)

        def blocks_together(number: int, threads: int) -> Any:
            y0 = (*starts(number, 2, samples), *still)
            return ss.simulate_contacts(TWO_BLOCKS, BELT, t1=t1, y0=y0, threads=threads, **quiet)

        return Own(
            samples, samples * t1,
            lambda mu, x: ss.simulate(TWO_BLOCKS, BELT, t1=t1, y0=(x[0], x[1], *still)),
            lambda number: jnp.asarray(starts(number, 2, samples).T),
            blocks_together,
        )  # fmt: skip
    of_engine = {
        "Poisson switching": ("closed form: Poisson switching", system(), LAW, sizes.switched_t1),
        "harmonic base": ("time steps: harmonic base", system(), RANDOM_PHASE, sizes.stepped_t1),
        "motor and cart": ("time steps: motor and cart", None, None, sizes.cart_t1),
        "a user's system": (
            "time steps: a user's system",
            derivatives.HardeningSpring(1.0),
            RANDOM_PHASE,
            sizes.stepped_t1,
        ),
    }
    case, moved, law, t1 = of_engine[engine]
    cart = ss.papers.motor_cart(0.2)
    y0 = START if moved else cart.y0

    def together(number: int, threads: int) -> Any:
        key = jax.random.key(number)
        return ss.simulate_ensemble(
            moved or cart.system, law or cart.law, t1=t1, y0=y0, key=key, threads=threads, **quiet
        )

    return Own(
        samples, samples * t1, derivatives.ENGINES[case](sizes),
        lambda number: jax.random.split(jax.random.key(number), samples), together, derivatives.FRICTION.get(case, 1.0),
    )  # fmt: skip


def _stick_times(own: Own, mu: Any, inputs: Any) -> Any:
    return jax.vmap(lambda given: own.simulate(mu, given).stick_time)(inputs)


def _all_sticks(own: Own, mu: Any, inputs: Any) -> Any:
    return jax.vmap(lambda given: own.simulate(mu, given).sticks)(inputs)


def _mean_stick_duration(own: Own, mu: Any, inputs: Any) -> Any:
    sticks = _all_sticks(own, mu, inputs)
    return jnp.where(sticks.mask, sticks.duration, 0.0).sum() / sticks.mask.sum()


PROGRAMS: dict[str, Callable[[Own, Any, Any], Any]] = {
    STICK_TIME: _stick_times,
    WIDE: _stick_times,
    EVERY_STICK: _all_sticks,
    MEAN: _mean_stick_duration,
    f"{MEAN}, value_and_grad": jax.value_and_grad(_mean_stick_duration, argnums=1),
    f"{MEAN}, jvp": lambda own, mu, inputs: jax.jvp(
        lambda mu: _mean_stick_duration(own, mu, inputs), (mu,), (jnp.ones_like(mu),)
    ),
}


def _composed(engine: str, name: str, sizes: Sizes) -> Run:
    own = _own(engine, sizes)
    options = {"xla_cpu_prefer_vector_width": 512} if name == WIDE else None
    program = jax.jit(partial(PROGRAMS[name], own), compiler_options=options)

    def run(number: int) -> Work:
        jax.block_until_ready(program(jnp.asarray(own.mu), own.inputs(number)))
        return Work(own.work)

    return run


def _beside(engine: str, threads: int, sizes: Sizes) -> Run:
    """The ensemble of as many samples."""
    own = _own(engine, sizes)

    def run(number: int) -> Work:
        own.together(number, threads)
        return Work(own.work)

    return run


# --- ensembles in time steps


def _stepped(name: str, threads: int, sizes: Sizes) -> Run:
    moved, law, y0 = ENSEMBLES[name](sizes)
    samples = sizes.stepped

    def run(number: int) -> Work:
        many = ss.simulate_ensemble(
            moved, law, t1=sizes.stepped_t1, samples=samples, key=jax.random.key(number), y0=y0,
            keep="totals", threads=threads, progress=False,
        )  # fmt: skip
        assert many.finished == samples
        return Work(samples * sizes.stepped_t1)

    return run


def _blocks(blocks: int, threads: int, sizes: Sizes) -> Run:
    """Blocks on a belt that begin anywhere without velocity, the sticks of all counted; 0: the two unequal blocks."""
    system, samples = (chain(blocks), sizes.chain_blocks // blocks) if blocks else (TWO_BLOCKS, sizes.two_blocks)
    still, t1 = np.zeros(system.size), chain_time(blocks, sizes)

    def run(number: int) -> Work:
        many = ss.simulate_contacts(
            system, BELT, t1=t1, samples=samples, y0=(*starts(number, system.size, samples), *still),
            keep="totals", threads=threads, progress=False,
        )  # fmt: skip
        assert many.of_contact(0).finished == samples
        return Work(samples * t1)

    return run


def _drift_on_grid(storey: int) -> Callable[[ss.Simulation], Any]:
    def drift(one: ss.Simulation) -> Any:
        y = one.evaluate(jnp.linspace(0, SHAKEN, 3000))
        return jnp.max(jnp.abs(y[storey + 1] - y[storey]))

    return drift


_LAST = {"last": lambda one: one.final_state[0]}
_PEAK = {"peak": lambda one: one.peak("position 0")}
_STOREYS = range(1, 6)
OUTPUTS: dict[str, dict[str, Callable[[ss.Simulation], Any]]] = {
    "none": {},
    "one, the last position": _LAST,
    "seven": _LAST
    | _PEAK
    | {f"drift{i}": partial(ss.Simulation.peak, coordinate=f"position {i + 1} - position {i}") for i in _STOREYS},
    "seven, drifts on a grid of times": _LAST | _PEAK | {f"drift{i}": _drift_on_grid(i) for i in _STOREYS},
}


def _shaken(name: str, sizes: Sizes) -> Run:
    """Six storeys on a bearing whose friction differs from sample to sample, under a record."""

    def run(number: int) -> Work:
        many = ss.simulate_ensemble(
            BUILDING, quake(), t1=SHAKEN, samples=sizes.shaken, key=jax.random.key(number), keep="totals",
            outputs=OUTPUTS[name], threads=1, progress=False,
        )  # fmt: skip
        assert many.finished == sizes.shaken
        return Work(sizes.shaken)

    return run


def _one_trajectory(how: str, sizes: Sizes) -> Run:
    """A user's system on a square wave, its friction another in each round."""
    base = ss.SquareWave(speed=SPEED, period=4.0)

    def stick_time(mu: Any) -> Any:
        return ss.simulate(derivatives.HardeningSpring(mu), base, t1=sizes.blocks_t1, y0=START).stick_time

    ways = {"as it is called": stick_time, "under jax.jit": jax.jit(stick_time)}
    call = ways.get(how) or jax.jit(jax.value_and_grad(stick_time))
    return _once(lambda number: call(0.8 + 0.01 * number))


def _diagram(values: int, sizes: Sizes) -> Run:
    """200 periods of transient and 100 that are kept, for values of the friction coefficient."""
    transient, kept = 200, 100

    def run(number: int) -> Work:
        over = {"mu": np.linspace(0.1, 1.0, values) + 1e-4 * number}
        found = ss.nonlinear.bifurcation_diagram(
            ON_HARMONIC, HARMONIC, over, transient=transient, kept=kept, longest_transient=transient, progress=False
        )  # fmt: skip
        assert not found.status.any()
        return Work(values * (transient + kept))

    return run


def _basins(side: int, sizes: Sizes) -> Run:
    """40 periods of transient and 8 that are kept, from a grid of starts."""
    transient, kept = 40, 8

    def run(number: int) -> Work:
        y0 = {"position": np.linspace(-2, 2, side) + 1e-4 * number, "velocity": np.linspace(-2, 2, side)}
        found = ss.nonlinear.basins(
            ON_HARMONIC, HARMONIC, y0=y0, transient=transient, kept=kept, longest_transient=transient, progress=False
        )  # fmt: skip
        assert found.basin.all()
        return Work(side * side * (transient + kept))

    return run


def _motor_cart(keep: ss.Keep, threads: int, sizes: Sizes) -> Run:
    """The paper's 20,000 runs: 10,000 at mu = 0.2 and at mu = 0.5, every one followed for 2 s."""

    def run(number: int) -> Work:
        done = 0.0
        for mu in (0.2, 0.5):
            setup = ss.papers.motor_cart(mu)
            many = ss.simulate_ensemble(
                setup.system, setup.law, t1=setup.t1, y0=setup.y0, samples=sizes.carts,
                key=jax.random.key(number), keep=keep, threads=threads, progress=False,
            )  # fmt: skip
            assert many.finished == many.samples
            done += sizes.carts * setup.t1
        return Work(done)

    return run


def _regularized(samples: int, settings: dict[str, Any] | None, sizes: Sizes) -> Run:
    """Trajectories of the study by regularised dynamics (None: exact), and how far their stick fraction is off."""
    exact = ss.Exact()
    method = exact if settings is None else ss.Regularized(**settings)
    samples = max(2, samples // sizes.regularized_share)

    def simulate(number: int, method: Any) -> ss.Ensemble:
        return ss.simulate_ensemble(
            system(), LAW, t1=T1, samples=samples, key=jax.random.key(number), y0=START, threads=1, progress=False,
            method=method, keep="totals",
        )  # fmt: skip

    right = ss.stick_fraction(simulate(0, exact)).value
    error = None

    def run(number: int) -> Work:
        nonlocal error
        many = simulate(number, method)
        assert many.finished == samples
        if number == 0:
            error = ss.stick_fraction(many).value / right - 1
        return Work(samples, error)

    return run


def _on_bristles(rtol: float, threads: int, sizes: Sizes) -> Run:
    """Masses on LuGre's bristles from random starts, and how far their last states are off."""
    t1, method = sizes.inner_t1, ss.Regularized(rtol=rtol)

    def simulate(x: np.ndarray, v: np.ndarray, **outputs: Any) -> ss.Ensemble:
        many = ss.simulate_ensemble(
            ON_BRISTLES, BESIDE_BRISTLES, t1=t1, samples=len(x), key=jax.random.key(0), y0=(x, v), method=method,
            keep="totals", threads=threads, progress=False, **outputs,
        )  # fmt: skip
        assert many.finished == len(x)
        return many

    last = {"x": lambda one: one.final_state[0], "v": lambda one: one.final_state[1]}
    values = simulate(*scipy_lugre.STARTS.T, outputs=last).output_values
    error = scipy_lugre.error(np.stack([values["x"], values["v"]], axis=1), t1)

    def run(number: int) -> Work:
        simulate(*np.random.default_rng(number).uniform(-0.2, 0.2, (2, sizes.inner_states)))
        return Work(sizes.inner_states, error)

    return run


def _sensitivity(motion: str | None, options: dict[str, Any] | None, sizes: Sizes) -> Run:
    """At mu = 0.9 (at 1, w = 2, there is none) d(pooled mean stick duration)/d mu; for an ensemble in time steps
    d(mean number)/d mu; or (no `options`) the value alone.
    """
    moved, law, y0 = (system(0.9), LAW, START) if motion is None else ENSEMBLES[motion](sizes)
    statistic = ss.mean_stick_duration if motion is None else ss.mean_stick_count
    t1, samples = (T1, sizes.sensitivity) if motion is None else (sizes.stepped_t1, sizes.sensitivity_compiled)

    def run(number: int) -> Work:
        study = {"t1": t1, "samples": samples, "key": jax.random.key(number), "y0": y0}
        if options is None:
            ss.simulate_ensemble(moved, law, progress=False, keep="totals", **study)
            return Work()
        found = ss.sensitivity(statistic, moved, law, wrt="mu", **options, **study)
        assert isinstance(found, ss.Sensitivity)
        # Of a few samples it may be that nothing moves.
        return Work(1.0, found.standard_error / abs(found.derivative) if found.derivative else float("inf"))

    return run


VALUE = "value alone"
_DIFFERENCES, _CORRECTED = {"estimator": "finite-difference"}, {"estimator": "corrected"}
SENSITIVITY: dict[str, tuple[str | None, dict[str, Any] | None]] = {
    VALUE: (None, None),
    "corrected derivative": (None, _CORRECTED),
    "finite difference, step 1 %": (None, _DIFFERENCES | {"step": 0.01}),
    "finite difference, step 0.2 %": (None, _DIFFERENCES | {"step": 0.002}),
}
for _motion in ("harmonic base of random phase", "damped, Poisson switching"):
    SENSITIVITY |= {
        f"{_motion}: {VALUE}": (_motion, None),
        f"{_motion}: corrected derivative": (_motion, _CORRECTED | {"relative_bandwidth": 0.01}),
        f"{_motion}: finite difference, step 1 %": (_motion, _DIFFERENCES | {"step": 0.01}),
    }


# --- the sequence of sticks


def _simulated_kernel(sizes: Sizes) -> Run:
    """Simulated and counted, with the second eigenvalue and its error."""

    def run(number: int) -> Work:
        many = ss.simulate_ensemble(
            system(0.8), LAW, t1=T1, samples=sizes.samples, key=jax.random.key(number), y0=START, keep="sticks",
            progress=False,
        )  # fmt: skip
        kernel = ss.transition_kernel(many)
        assert kernel.second_eigenvalue.value < 1
        return Work(kernel.number)

    return run


def _kernel_by_quadrature(sizes: Sizes) -> Run:
    def run(_: int) -> Work:
        kernel = ss.transition_kernel(system(0.8), LAW, transitions=sizes.samples)
        assert kernel.second_eigenvalue.value < 1
        return Work(kernel.number)

    return run


def _forecasts(sizes: Sizes) -> Run:
    """Distribution and hazard of the next stick after 100 ends of sticks, one by one, as a controller asks for them."""
    kernel = ss.transition_kernel(system(0.8), LAW, transitions=sizes.samples)

    def run(number: int) -> Work:
        for which in np.random.default_rng(number).integers(kernel.number, size=100):
            state = {name: float(kernel.state[name][which]) for name in kernel.given}
            found = ss.forecast(kernel, state)
            assert found.distribution("slip_before").quantile(0.9).value > 0
            assert found.hazard().rate.size == 30
        return Work(100)

    return run


def _scored_forecasts(sizes: Sizes) -> Run:
    """All sticks of a record forecast and compared."""
    kernel = ss.transition_kernel(system(0.8), LAW, transitions=sizes.samples)

    def run(number: int) -> Work:
        key = jax.random.key(number)
        record = ss.simulate_ensemble(system(0.8), LAW, t1=T1, samples=100, key=key, keep="sticks", progress=False)
        scores = ss.score_forecasts(kernel, ss.transition_kernel(record), seed=number)
        return Work(len(scores.owner))

    return run


SEQUENCE: dict[str, Callable[[Sizes], Run]] = {
    "kernel, simulation included": _simulated_kernel,
    "kernel by quadrature": _kernel_by_quadrature,
    "forecasts one by one": _forecasts,
    "forecasts of a record, scored": _scored_forecasts,
}

KEPT: tuple[tuple[ss.Keep, str], ...] = (
    ("totals", "totals"),
    ("statistics", "full statistics"),
    ("sticks", "every stick"),
)


def _all() -> dict[str, Callable[[Sizes], Run]]:
    found: dict[str, Callable[[Sizes], Run]] = {}
    for threads, word in enumerate(THREADS, 1):
        found |= {inner_name(rtol, word): partial(_on_bristles, rtol, threads) for rtol in INNER_TOLERANCES}
        for keep, name in KEPT:
            found[f"{name}, {word}"] = partial(_ensemble, keep, threads)
            found[f"motor and cart, {name}, {word}"] = partial(_motor_cart, keep, threads)
        found[f"totals, uncertain, {word}"] = partial(_uncertain, threads)
        for name in ENSEMBLES:
            found[f"{name}, {word}"] = partial(_stepped, name, threads)
        found[f"two blocks, {word}"] = partial(_blocks, 0, threads)
        for blocks in FULL.chains:
            found[f"{chain_name(blocks)}, {word}"] = partial(_blocks, blocks, threads)
    found |= {f"outputs: {name}": partial(_shaken, name) for name in OUTPUTS}
    found["every stick, handed on, 1 thread"] = _handed_on
    found |= {f"part: {name}": partial(_without, name) for name in WITHOUT}
    found |= {f"locked: {name}": partial(_locked, keep) for keep, name in KEPT}
    found |= {f"vmapped {of}: {name}": partial(_composed, of, name) for of in OWN_ENGINES for name in PROGRAMS}
    found |= {f"beside {of}, {THREADS[i]}": partial(_beside, of, i + 1) for of in OWN_ENGINES for i in range(2)}
    found |= {diagram_name(size): partial(_diagram, size) for size in (*TINY.diagrams, *FULL.diagrams)}
    found |= {basin_name(size): partial(_basins, size) for size in (*TINY.basins, *FULL.basins)}
    for name in ONE_TRAJECTORY:
        found[f"one trajectory: {name}"] = partial(_one_trajectory, name)
    found |= {f"sequence: {name}": build for name, build in SEQUENCE.items()}
    for name, what in SENSITIVITY.items():
        found[f"sensitivity: {name}"] = partial(_sensitivity, *what)
    found["exact"] = partial(_regularized, 40_000, None)
    for kind, entries in REGULARIZED.items():
        for label, samples, settings in entries:
            found[f"{kind}; {label}"] = partial(_regularized, samples, settings)
    for engine in derivatives.ENGINES:
        for mode in derivatives.MODES:
            found[f"derivatives: {engine}, {mode}"] = partial(_derivative, engine, mode)
    for name, build in compiled.CASES.items():
        found[f"compiled: {name}"] = lambda sizes, build=build: _once(build(sizes))
    return found


def _derivative(engine: str, mode: str, sizes: Sizes) -> Run:
    return _once(derivatives.program(engine, mode, sizes))


def _once(call: Callable[[int], Any]) -> Run:
    def run(number: int) -> Work:
        jax.block_until_ready(call(number))
        return Work()

    return run


CASES = _all()
