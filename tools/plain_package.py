"""What the package promises without extras, in an environment that has nothing else: ``python tools/plain_package.py``.

Every public name is imported, one call of each kind made and every figure drawn, and what needs an extra says so in
one sentence. `tools/plain_wheel.py` makes the environment.
"""

import contextlib
import re
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jax
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss
from stickslip_jax import nonlinear, papers, plot

mpl.use("Agg")
jax.config.update("jax_enable_x64", True)
warnings.simplefilter("error")

SENTENCE = r"[^.\n]* needs? [^\n]*: pip install 'stickslip_jax\[(study|tables|explore)\]'[^.\n]*\."
EXTRAS = "xarray", "h5netcdf", "h5py", "tqdm", "cyclopts", "pydantic", "filelock", "loky", "pandas", "pyarrow", "panel"
SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.7))
LAW, KEY, T1 = ss.PoissonSwitching(speed=1.0, rate=1.0), jax.random.key(0), 20.0
START = ss.Uniform(-0.5, 0.5), ss.Uniform(-0.5, 0.5)
MANY = {"t1": T1, "samples": 2000, "key": KEY, "y0": START}
BELT = papers.harmonic_belt(0.7)
TIMES = np.linspace(0.0, 10.0, 101)
NAMED = {"xlabel": "a", "ylabel": "b", "label": "c"}
UNLABELED = {"basins", "bifurcation_diagram", "histograms", "orbit_branch", "parameter_sweep", "section"}
"""Figures of labelled results, which only functions that need an extra return."""


def every_public_name() -> None:
    """All are there; of the modules only `study` needs an extra."""
    for name in set(dir(ss)) - {"study"}:
        assert getattr(ss, name) is not None, name
    for module in (plot, nonlinear, ss.design, papers):
        public = getattr(module, "__all__", None) or [name for name in vars(module) if not name.startswith("_")]
        assert all(getattr(module, name) is not None for name in public), module


def sobol_indices() -> Any:
    """Indices of two inputs, of outputs that are given."""
    return ss.sobol_indices(1.0 + np.arange(24), ss.design.saltelli(4, ["mu", "mass"]))


def figures() -> dict[str, Callable[[], object]]:
    """One call of each kind, and the figure of each result by the name of its function."""
    one = ss.simulate(SYSTEM, LAW.sample(KEY, T1), t1=T1, y0=(0.0, 1.0))
    soft = ss.simulate(SYSTEM, ss.Harmonic(1.0, 1.4), t1=T1, y0=(0.0, 1.0), method=ss.Regularized(width=0.01))
    assert one.status == soft.status == ss.Status.FINISHED
    many = ss.simulate_ensemble(SYSTEM, LAW, **MANY, keep="sticks")
    print(many)
    print(ss.independent(many, "duration"), ss.bootstrap_interval(ss.stick_fraction, many, resamples=100), sep="\n")
    print(ss.forecast(ss.transition_kernel(many, given=("base_velocity",)), {"base_velocity": 1.0}))
    assert ss.Sweep(SYSTEM, LAW, over={"mu": [0.5, 1.0]}, **MANY).ensemble_at(mu=0.5).samples == 2000
    derivatives: Any = ss.sensitivity(ss.mean_stick_duration, SYSTEM, LAW, wrt=("mu", "stiffness"), **MANY)
    derivative: Any = ss.sensitivity(ss.mean_stick_duration, SYSTEM, LAW, wrt="mu", **MANY)
    clean = np.asarray(soft.evaluate(TIMES)[0])
    seen = {"position": clean + 0.02 * np.random.default_rng(0).normal(size=TIMES.size)}
    fitted = ss.calibrate(SYSTEM, ss.Harmonic(1.0, 1.4), TIMES, seen, wrt="mu", y0=(0.0, 1.0))
    moments = ss.calibrate_sticks(SYSTEM, LAW, many, wrt="mu", samples=2000, key=jax.random.key(1), y0=START)
    simulator = ss.stick_simulator(SYSTEM, LAW, wrt="mu", t1=T1, y0=(0.0, 1.0))
    assert np.isfinite(np.asarray(simulator([[0.5]], KEY))).all()
    assert np.isfinite(np.asarray(ss.LuGre(0.3, 0.4, 0.1, 1e3, 1.0).force(TIMES, np.sin(TIMES), 1.0))).all()
    assert nonlinear.periodic_orbit(BELT.system, BELT.law, y0=BELT.y0, iterations=5).state.shape == (2,)
    bound = ss.MotorCart(), ss.SourceVoltage()
    blocks = ss.newmark_displacements([ss.GroundAcceleration([0.0, 0.5, 0.6], [3.0, 3.0, 0.0])], [0.1, 0.2])
    indices = sobol_indices()
    return {
        "time_history": lambda: plot.time_history(one),
        "phase_portrait": lambda: plot.phase_portrait(one),
        "energies": lambda: plot.energies(one),
        "friction_force": lambda: plot.friction_force(one),
        "animate": lambda: plot.animate(one, window=(0.0, 1.0), speed=1.0, fps=5).save("film.gif"),
        "save": lambda: plot.save(plot.time_history(one), "history.png"),
        "mechanism": lambda: plot.mechanism(SYSTEM),
        "friction_law": lambda: plot.friction_law(SYSTEM.friction),
        "stick_raster": lambda: plot.stick_raster(many),
        "histogram": lambda: plot.histogram(many.statistics.duration),
        "joint_histogram": lambda: plot.joint_histogram(many.statistics.joint("duration", "position")),
        "means_by_order": lambda: plot.means_by_order(many, "duration"),
        "convergence": lambda: plot.convergence(ss.convergence(ss.mean_stick_duration, many)),
        "stick_map": lambda: plot.stick_map(ss.first_stick(many), system=SYSTEM),
        "stick_bounds": lambda: plot.stick_bounds(*bound, mu=[0.2, 0.4]),
        "curve": lambda: plot.curve([1.0, 2.0], [many.statistics.duration.median] * 2, xlabel="rate (1/s)"),
        "stick_fraction_curve": lambda: plot.stick_fraction_curve([1.0, 2.0], [many.statistics.stick_fraction] * 2),
        "parameter_map": lambda: plot.parameter_map(
            [1.0, 2.0], [1.0, 2.0], np.eye(2), xlabel="a", ylabel="b", label="c"
        ),
        "sobol_indices": lambda: plot.sobol_indices(indices),
        "newmark_displacements": lambda: plot.newmark_displacements(blocks),
        "sensitivity_curve": lambda: plot.sensitivity_curve([derivative]),
        "tornado": lambda: plot.tornado(derivatives),
        "calibration": lambda: plot.calibration(fitted),
        "calibration_moments": lambda: plot.calibration_moments(moments),
    }


def needing_an_extra() -> dict[str, Callable[[], object]]:
    """A call of each kind that needs one."""
    one = ss.simulate(SYSTEM, LAW.sample(KEY, T1), t1=T1, y0=(0.0, 1.0))
    many = ss.simulate_ensemble(SYSTEM, LAW, **MANY, keep="sticks")
    sweep, starts = ss.Sweep(SYSTEM, LAW, over={"mu": [0.5, 1.0]}, **MANY), [BELT.y0]
    repeating = {"system": BELT.system, "base": BELT.law}
    indices = sobol_indices()
    return {
        "study": lambda: ss.study,
        "sweep": lambda: sweep.run(progress=False),
        "sweep in a folder": lambda: sweep.run("folder", progress=False),
        "explore": lambda: ss.explore(SYSTEM, LAW),
        "load": lambda: ss.load("history.png"),
        "save": lambda: many.save("many.nc"),
        "arrays of an ensemble": many.to_xarray,
        "arrays of a simulation": one.to_xarray,
        "indices": indices.to_xarray,
        "table": one.to_pandas,
        "file of a table": lambda: many.write_sticks("sticks.csv"),
        "progress": lambda: ss.simulate_ensemble(SYSTEM, LAW, **MANY, progress=True),
        "section": lambda: nonlinear.stroboscopic_section(**repeating),
        "events": lambda: nonlinear.event_section(**repeating, of="stick_start"),
        "diagram": lambda: nonlinear.bifurcation_diagram(**repeating, over={"mu": [0.5, 1.0]}),
        "basins": lambda: nonlinear.basins(**repeating, y0=starts),
        "exponents": lambda: nonlinear.lyapunov_exponents(**repeating),
        "branch": lambda: nonlinear.continue_orbit(
            nonlinear.periodic_orbit(**repeating, y0=BELT.y0, iterations=5), "mu", until=1.1
        ),
    }  # fmt: skip


def main() -> None:
    """Raises an error where a promise is not kept."""
    there = [name for name in EXTRAS if find_spec(name) is not None]
    if there:
        sys.exit(f"This environment has {', '.join(there)}; run it in a plain one: python tools/plain_wheel.py.")
    every_public_name()
    drawn = figures()
    functions = {name for name in dir(plot) if name[0].islower()}
    assert set(drawn) | UNLABELED == functions, set(drawn) ^ functions
    for name, draw in drawn.items():
        draw()
        plt.close("all")
        print(f"drawn: {name}", flush=True)
    for name, call in needing_an_extra().items():
        try:
            call()
            said = "nothing"
        except ImportError as error:
            said = str(error)
        assert re.fullmatch(SENTENCE, said), f"{name}: {said}"
        print(f"{name}: {said}", flush=True)
    for words in (["--help"], ["study"], ["sweep"], ["explore"], ["show", "nowhere"]):
        command = [str(Path(sys.executable).with_name("stickslip")), *words]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 1, done
        assert re.fullmatch(f"stickslip: {SENTENCE}\n", done.stderr), done.stderr
    assert not list(Path().glob("*.nc")), "what needs an extra has begun to write"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        main()
