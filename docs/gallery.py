"""Draw the pictures of gallery.md, which shows the code of each.

``python docs/gallery.py [NAME ...]`` draws those of the figure functions, each by the function of its name here.
``python docs/gallery.py notebooks`` takes those of the notebooks from their last run: `make notebooks`, or `make docs`.
"""
# ruff: noqa: E402

# The page shows all from here to the next such line, and each function: lines are no longer than the 88 that it holds.
import math

import jax
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss
from stickslip_jax import nonlinear, papers, plot

jax.config.update("jax_enable_x64", True)

SYSTEM = ss.MassSpring(
    mass=1.0,
    stiffness=4.0,
    normal_force=1.0,
    friction=ss.Coulomb(mu=0.9),
)
LAW = ss.PoissonSwitching(speed=1.0, rate=1.0)  # of the velocity of the base
START = (0.0, 0.5)  # m, m/s
STUDY = {"t1": 200.0, "samples": 10_000, "key": jax.random.key(0), "y0": START}
# Until here.

import base64
import io
import sys
from pathlib import Path

import nbformat
from PIL import Image

HERE = Path(__file__).parent
FOLDER = HERE / "gallery"
RUNS = ("notebooks", "notebooks-small")  # below results; the first that has the notebook is taken
WIDTH = 960  # pixels, twice those of the page: sharp on all screens
FILMS = ("animate",)  # made by animation.py
FUNCTIONS = [name for name in plot.__all__ if name[0].islower() and name not in ("save", *FILMS)]
FIGURES = {
    "abc": 1,
    "base_isolation": 1,
    "calibration": 1,
    "conference_paper": 1,
    "control": 3,
    "electromechanical": 1,
    "isolated_building": 1,
    "measured_friction": 1,
    "nonlinear": 3,
    "own_base": 1,
    "own_system": 1,
    "parametric_analysis": 1,
    "parametric_oscillator": 1,
    "pipeline": 1,
    "posterior": 1,
    "quickstart": 5,
    "regularized": 1,
    "scaling": 1,
    "sensitivity": 1,
    "statistical_model": 2,
    "structures": 1,
    "uncertain": 1,
}
"""Which figure of each notebook is shown, counted from 1."""


def time_history():
    """A motion on a random base."""
    base = LAW.sample(jax.random.key(0), t1=60.0)
    one = ss.simulate(SYSTEM, base, t1=60.0, y0=START)
    return plot.time_history(one, window=(25.0, 50.0))


def phase_portrait():
    """Three periods of a belt that runs backward and forward alternately."""
    setup = papers.square_wave_belt(1.2)
    one = ss.simulate(setup.system, setup.law, t1=setup.t1, y0=setup.y0)
    last = (setup.t1 - 3 * setup.law.period, setup.t1)
    return plot.phase_portrait(one, window=last)


def energies():
    """A motion on a random base."""
    base = LAW.sample(jax.random.key(0), t1=60.0)
    one = ss.simulate(SYSTEM, base, t1=60.0, y0=START)
    return plot.energies(one, window=(25.0, 50.0))


def friction_force():
    """A period of a mass with Dahl's friction on a base that moves to and fro."""
    system = ss.MassSpring(
        mass=1.0,
        stiffness=4.0,
        normal_force=1.0,
        friction=ss.Dahl(mu=0.4, stiffness=20.0),
    )
    base = ss.Harmonic(amplitude=0.5, angular_frequency=1.3)
    one = ss.simulate(system, base, t1=40.0, method=ss.Regularized())
    last = (40.0 - 2 * math.pi / 1.3, 40.0)
    return plot.friction_force(one, over="slip", window=last)


def stick_raster():
    """The sticks of sixty realisations."""
    many = ss.simulate_ensemble(SYSTEM, LAW, **STUDY)
    return plot.stick_raster(many, samples=60, window=(0.0, 40.0))


def histogram():
    """The durations of all sticks."""
    many = ss.simulate_ensemble(SYSTEM, LAW, **STUDY)
    return plot.histogram(many.statistics.duration, quantiles=(0.05, 0.5, 0.95))


def joint_histogram():
    """Duration and position of all sticks."""
    many = ss.simulate_ensemble(SYSTEM, LAW, **STUDY)
    return plot.joint_histogram(many.statistics.joint("duration", "position"))


def means_by_order():
    """The mean duration of the first, the second ... stick."""
    many = ss.simulate_ensemble(SYSTEM, LAW, **STUDY)
    return plot.means_by_order(many, "duration")


def convergence():
    """The mean stick duration by the number of samples."""
    many = ss.simulate_ensemble(SYSTEM, LAW, **STUDY)
    return plot.convergence(ss.convergence(ss.mean_stick_duration, many))


def stick_map():
    """The first stick of a motor cart from random starts, and its closed-form bound."""
    cart, voltage = ss.MotorCart(mu=0.5), ss.SourceVoltage()
    start = (ss.Uniform(0.0, 2 * math.pi), 0.0, 0.0)  # angle, angular velocity, current
    many = ss.simulate_ensemble(
        cart,
        ss.RandomPhase(voltage),
        t1=2.0,
        samples=2000,
        key=jax.random.key(0),
        y0=start,
        keep="sticks",
    )
    first = ss.first_stick(many)
    return plot.stick_map(first, system=cart, bound=voltage, period=math.pi)


def stick_bounds():
    """The bound of a motor cart for three friction coefficients."""
    return plot.stick_bounds(ss.MotorCart(), ss.SourceVoltage(), mu=[0.2, 0.4, 0.6])


def curve():
    """The median duration of sticks over the switching rate of the base."""
    rates = np.geomspace(0.1, 10.0, 13)
    laws = [ss.PoissonSwitching(speed=1.0, rate=rate) for rate in rates]
    studies = [ss.simulate_ensemble(SYSTEM, law, **STUDY) for law in laws]
    medians = [many.statistics.duration.median for many in studies]
    return plot.curve(rates, medians, xlabel="switching rate (1/s)", xlog=True)


def stick_fraction_curve():
    """The share of time spent sticking over the frequency ratio of base and mass."""
    ratios = np.linspace(0.2, 3.0, 29)
    fractions = []
    for ratio in ratios:
        setup = papers.random_belt(ratio)
        many = ss.simulate_ensemble(
            setup.system,
            setup.law,
            t1=setup.t1,
            samples=1000,
            key=jax.random.key(0),
            y0=setup.y0,
        )
        fractions.append(many.statistics.stick_fraction)
    return plot.stick_fraction_curve(ratios, fractions)


def parameter_map():
    """The mean stick duration over friction and switching rate."""
    over = {"mu": np.linspace(0.2, 3.0, 15), "rate": np.linspace(0.1, 3.0, 16)}
    few = STUDY | {"samples": 400}
    results = ss.Sweep(SYSTEM, LAW, over=over, **few).run(progress=False)
    return plot.parameter_map(results, "mean_stick_duration")


def parameter_sweep():
    """Two statistics of a parameter sweep."""
    over = {"mu": np.linspace(0.2, 2.0, 10), "rate": [0.5, 1.0, 2.0]}
    few = STUDY | {"samples": 1000}
    results = ss.Sweep(SYSTEM, LAW, over=over, **few).run(progress=False)
    names = ["mean_stick_duration", "stick_fraction"]
    _, axes = plt.subplots(2, 1, figsize=(6.4, 7.0), layout="constrained")
    return plot.parameter_sweep(results, names, axes=axes)


def sensitivity_curve():
    """The derivative of the mean stick duration by the friction coefficient."""
    anywhere = (ss.Uniform(-0.5, 0.5), ss.Uniform(-0.5, 0.5))
    found = [
        ss.sensitivity(
            ss.mean_stick_duration,
            ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu)),
            LAW,
            wrt="mu",
            **STUDY | {"y0": anywhere, "samples": 4000},
        )
        for mu in np.linspace(0.42, 2.9, 13)
    ]
    return plot.sensitivity_curve(found)


def histograms():
    """The durations of sticks at five friction coefficients."""
    over = {"mu": np.linspace(0.3, 2.0, 5)}
    sweep = ss.Sweep(SYSTEM, LAW, over=over, **STUDY)
    return plot.histograms(sweep.run(progress=False), "duration")


def friction_law():
    """Friction: constant, falling with the speed, and different by direction."""
    stribeck = ss.Stribeck(mu=0.3, mu_static=0.5, stribeck_speed=0.1)
    ax = plot.friction_law(ss.Coulomb(0.25), speed=0.6, label="Coulomb")
    plot.friction_law(stribeck, speed=0.6, label="Stribeck", ax=ax)
    one_way = ss.Directional(ss.Coulomb(0.4), ss.Coulomb(0.1))
    return plot.friction_law(one_way, speed=0.6, label="Directional", ax=ax)


def newmark_displacements():
    """Rigid blocks under twelve artificial earthquakes."""
    times = np.linspace(0.0, 16.0, 801)
    envelope = 0.8 * np.exp(-(((times - 6) / 3) ** 2))
    source, records = np.random.default_rng(1), []
    for _ in range(12):
        waves = np.sin(2 * np.pi * times[:, None] * source.uniform(0.5, 4.0, 10))
        records.append(ss.GroundAcceleration(times, envelope * waves.sum(axis=1)))
    yields = np.linspace(0.02, 0.14, 13)
    return plot.newmark_displacements(ss.newmark_displacements(records, yields))


def mechanism():
    """The motor and cart of the 2022 paper."""
    return plot.mechanism(ss.MotorCart(), (0.6, 0.0, 0.0))


def tornado():
    """How much each parameter matters for the mean stick duration."""
    anywhere = (ss.Uniform(-0.5, 0.5), ss.Uniform(-0.5, 0.5))
    found = ss.sensitivity(
        ss.mean_stick_duration,
        ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.9)),
        LAW,
        wrt=("mu", "mass", "stiffness", "speed", "rate"),
        elasticity=True,
        **STUDY | {"y0": anywhere},
    )
    return plot.tornado(found)


def sobol_indices():
    """Which random number matters most for the total stick time."""
    system = ss.MassSpring(
        mass=1.0,
        stiffness=ss.Uniform(3.0, 5.0),
        normal_force=1.0,
        friction=ss.Coulomb(mu=ss.Uniform(0.5, 1.5)),
    )
    names = ["mu", "stiffness"]
    design = ss.design.saltelli(1024, names, realization="factor")
    study = STUDY | {"t1": 50.0, "samples": design}
    many = ss.simulate_ensemble(system, LAW, keep="totals", **study)
    found = ss.sobol_indices(many.totals.stick_time, design)
    return plot.sobol_indices(found)


def forced(angular_frequency):
    """A mass on a belt, whose friction falls with the speed, under a harmonic force."""
    return ss.MassSpring(
        mass=1.0,
        stiffness=1.0,
        normal_force=1.0,
        friction=ss.VelocityWeakening(mu_static=1.0, weakening=3.0),
        damping=0.001,
        force=ss.Harmonic(amplitude=0.6, angular_frequency=angular_frequency),
    )


def section():
    """The states of a chaotic motion, once a period of the force."""
    found = nonlinear.stroboscopic_section(
        forced(1.9),
        ss.Constant(0.3),
        y0=(0.0, 0.0),
        transient=100,
        kept=1500,
    )
    return plot.section(found)


def bifurcation_diagram():
    """On what motions settle, over the frequency of the force."""
    over = {"angular_frequency": np.linspace(1.505, 2.405, 181)}
    found = nonlinear.bifurcation_diagram(forced(1.9), ss.Constant(0.3), over)
    return plot.bifurcation_diagram(found)


def damped():
    """A mass on a belt that comes to rest from some starts."""
    return ss.MassSpring(
        mass=1.0,
        stiffness=1.0,
        normal_force=1.0,
        friction=ss.Stribeck(mu=0.5, mu_static=1.0, stribeck_speed=0.5),
        damping=0.1,
    )


def basins():
    """The starts that lead to a stick-slip cycle, and those that lead to rest."""
    starts = {
        "position": np.linspace(-2.5, 2.5, 80),
        "velocity": np.linspace(-2.0, 2.0, 80),
    }
    found = nonlinear.basins(
        damped(),
        ss.Constant(1.5),
        y0=starts,
        transient=80,
        kept=20,
        period=5.0,
    )
    return plot.basins(found)


def orbit_branch():
    """The cycle on a faster and faster belt, until its stick vanishes."""
    cycle = nonlinear.periodic_orbit(damped(), ss.Constant(1.5), y0=(0.5, 1.5))
    branch = nonlinear.continue_orbit(cycle, "speed", until=2.0)
    return plot.orbit_branch(branch, "stick_fraction")


def calibration():
    """A noisy record of a position, and the motion that fits it best."""
    base = ss.SquareWave(0.5, 5.0)
    true = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7))
    times = np.linspace(0.0, 20.0, 401)
    clean = ss.simulate(true, base, t1=20.0, y0=(0.3, 0.1)).evaluate(times)[0]
    noise = 0.02 * np.random.default_rng(0).normal(size=times.size)  # m
    guess = ss.MassSpring(1.0, 3.6, 1.0, ss.Coulomb(0.6))
    seen = {"position": np.asarray(clean) + noise}
    found = ss.calibrate(guess, base, times, seen, wrt=("mu", "stiffness"))
    return plot.calibration(found)


def calibration_moments():
    """Observed means over sticks beside those of the fitted model."""
    start = (ss.Uniform(-0.5, 0.5), ss.Uniform(-0.5, 0.5))
    observed = ss.simulate_ensemble(
        ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.2)),
        ss.PoissonSwitching(speed=0.7, rate=0.9),
        t1=60.0,
        samples=100,
        key=jax.random.key(0),
        y0=start,
        keep="sticks",
    )
    found = ss.calibrate_sticks(
        ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.8)),
        ss.PoissonSwitching(speed=0.7, rate=0.5),
        observed,
        wrt=("mu", "rate"),
        samples=4096,
        key=jax.random.key(1),
        y0=start,
    )
    return plot.calibration_moments(found)


def shrink(image: Image.Image, name: str) -> None:
    """Write a picture twice as wide as the page shows it, in colours of a palette."""
    small = image.convert("RGB").resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    # Other methods turn the few orange pixels of a stick brown.
    small = small.quantize(method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    small.save(FOLDER / f"{name}.png", optimize=True)


def draw(names: list[str]) -> None:
    """The pictures of these figure functions."""
    for name in names:
        axes = globals()[name]()
        figure = (axes[0] if isinstance(axes, tuple) else axes).figure
        with io.BytesIO() as file:
            figure.savefig(file, dpi=2 * WIDTH / figure.get_figwidth())
            plt.close(figure)
            shrink(Image.open(file), name)
        print(f"gallery/{name}.png", flush=True)


def take_notebooks() -> None:
    """The picture of each notebook, from its last run."""
    for name, number in FIGURES.items():
        runs = [HERE.parent / "results" / run / f"{name}.ipynb" for run in RUNS]
        found = next((run for run in runs if run.exists()), None)
        if found is None:
            print(f"{name}: not run; `make docs` runs all notebooks, `make notebooks` at full size")
            continue
        cells = [cell for cell in nbformat.read(found, as_version=4).cells if cell.cell_type == "code"]
        data = [output.get("data", {}) for cell in cells for output in cell.outputs]
        figures = [one["image/png"] for one in data if "image/png" in one]
        shrink(Image.open(io.BytesIO(base64.b64decode(figures[number - 1]))), f"notebook_{name}")
        print(f"gallery/notebook_{name}.png", flush=True)


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    if sys.argv[1:] == ["notebooks"]:
        take_notebooks()
    else:
        draw(sys.argv[1:] or FUNCTIONS)
