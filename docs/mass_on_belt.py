"""Draw what is simulated, for the first page: ``python docs/mass_on_belt.py``."""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

import stickslip_jax as ss
from stickslip_jax import plot

STICK, BASE = "#D55E00", "#0072B2"


def draw_machine(ax: Axes) -> None:
    """Wall, spring, mass, and the belt that it rubs on."""
    ax.add_patch(Rectangle((-0.25, 0.0), 0.25, 1.5, facecolor="0.85", hatch="///", edgecolor="0.5"))
    turns = np.linspace(0.0, 1.0, 401)
    coil = np.where((turns > 0.15) & (turns < 0.85), 0.16 * np.sin(2 * np.pi * 8 * (turns - 0.15) / 0.7), 0.0)
    ax.plot(1.8 * turns, 0.7 + coil, color="black", lw=1.2)
    ax.add_patch(Rectangle((1.8, 0.16), 1.2, 0.99, facecolor="0.93", edgecolor="black", lw=1.2))
    ax.plot([1.8, 3.0], [0.16, 0.16], color=STICK, lw=4, solid_capstyle="butt")
    belt = FancyBboxPatch(
        (0.55, -0.55), 4.1, 0.55, boxstyle="round,pad=0.1,rounding_size=0.37", fill=False, ec=BASE, lw=2
    )
    ax.add_patch(belt)
    for center in (0.8, 4.4):
        ax.add_patch(Circle((center, -0.275), 0.3, facecolor="white", edgecolor="0.4"))
    arrow = {"arrowstyle": "<->", "color": BASE, "lw": 1.6}
    ax.annotate("", (3.5, -0.9), (1.7, -0.9), arrowprops=arrow)
    ax.text(2.6, -1.22, "base velocity $v(t)$, random", color=BASE, ha="center", va="center")
    ax.annotate("", (2.4, 1.2), (2.4, 1.75), arrowprops={"arrowstyle": "->", "lw": 1.4})
    ax.text(2.5, 1.6, "normal force $n$", va="center")
    ax.text(2.4, 0.7, "mass $m$", ha="center", va="center")
    ax.text(0.9, 1.08, "stiffness $k$", ha="center", va="center")
    ax.text(3.15, 0.3, r"friction, $\mu$", color=STICK, va="center")
    ax.set(xlim=(-0.35, 4.9), ylim=(-1.45, 1.9), aspect="equal")
    ax.axis("off")


def draw_motion(ax: Axes) -> None:
    """Velocities of mass and base: they are the same in a stick, and different in a slip."""
    system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
    law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    one = ss.simulate(system, law.sample(jax.random.key(0), t1=60.0), t1=60.0, y0=(0.0, 1.0))
    times = np.linspace(26.0, 39.0, 4001)
    velocity, base = np.asarray(one.evaluate(times)[1]), np.asarray(one.base_velocity(times))
    start, end = np.asarray(one.sticks.start), np.asarray(one.sticks.end)
    sticks = (times[:, None] > start) & (times[:, None] < end)
    sticking = sticks.any(axis=1)
    ax.plot(times, base, color=BASE, lw=1, ls="--", label="base")
    ax.plot(times, velocity, color="black", lw=1.3, label="mass, slip")
    ax.plot(times, np.where(sticking, velocity, np.nan), color=STICK, lw=4, label="mass, stick")
    ax.set(xlabel="time (s)", ylabel="velocity (m/s)", xlim=(times[0], times[-1]), ylim=(-1.35, 1.35))
    ax.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained", width_ratios=(1, 1.15))
    draw_machine(left)
    draw_motion(right)
    plot.save((left, right), Path(__file__).with_name("mass_on_belt.png"), dpi=110, overwrite=True)
