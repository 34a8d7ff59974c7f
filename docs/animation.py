"""Make the film of the first page: ``python docs/animation.py``."""

from pathlib import Path

import jax

import stickslip_jax as ss
from stickslip_jax import plot

if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    friction = ss.Coulomb(mu=1.0)
    system = ss.MassSpring(mass=1.0, stiffness=2.0, normal_force=1.0, friction=friction)
    law = ss.PoissonSwitching(speed=1.0, rate=0.5)
    base = law.sample(jax.random.key(0), t1=60.0)
    one = ss.simulate(system, base, t1=60.0, y0=(0.0, 1.0))
    how = {"speed": 1.0, "fps": 12.5, "figsize": (7.0, 4.2)}
    film = plot.animate(one, window=(5.5, 18.5), coordinate="velocity", **how)
    film.save(Path(__file__).with_name("animation.gif"), dpi=90, overwrite=True)
