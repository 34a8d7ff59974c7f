"""Draw the figures of the tutorial: ``python docs/tutorial_figures.py``."""

from pathlib import Path

import jax

import stickslip_jax as ss

FOLDER = Path(__file__).parent


def save(axes, name: str) -> None:
    """Save a figure beside this file."""
    ss.plot.save(axes, FOLDER / f"{name}.png", dpi=100, overwrite=True)


def main() -> None:
    """Draw all of them."""
    system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.8))
    law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    settings = {"key": jax.random.key(0), "y0": (0.0, 1.0)}
    one = ss.simulate(system, law.sample(jax.random.key(0), t1=200.0), t1=200.0, y0=(0.0, 1.0))
    save(ss.plot.time_history(one, window=(0.0, 40.0)), "tutorial_time_history")
    save(ss.plot.phase_portrait(one, window=(0.0, 40.0)), "tutorial_phase_portrait")

    many = ss.simulate_ensemble(system, law, t1=200.0, samples=20_000, **settings)
    save(ss.plot.histogram(many.statistics.duration), "tutorial_histogram")
    over = {"mu": [0.4, 0.8, 1.6], "rate": [0.5, 1.0]}
    swept = ss.Sweep(system, law, over=over, t1=100.0, samples=2000, **settings).run(progress=False)
    save(ss.plot.parameter_sweep(swept, ["mean_stick_duration"]), "tutorial_sweep")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
