"""Draw the figure of the page on friction with a memory: ``python docs/friction_memory.py``."""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import stickslip_jax as ss
from stickslip_jax import plot


def draw_loops(ax: Axes) -> None:
    """Friction against displacement, as a test rig measures it."""
    amplitude, w = 1e-3, 2 * np.pi
    times = np.linspace(0.0, 2.0, 1001)
    motion, position = ss.Harmonic(amplitude * w, w), amplitude * np.sin(w * times)
    normal = 10.0
    loops = {
        "Coulomb behind a spring\nwith backlash": ss.Coulomb(0.4).force(
            times, motion, normal, series_stiffness=2e4, backlash=4e-4
        ),
        "Dahl": ss.Dahl(0.4, stiffness=2e3).force(times, motion, normal),
        "Bouc-Wen, exponent 8": ss.BoucWen(0.4, stiffness=2e3, exponent=8.0).force(times, motion, normal),
        "LuGre": ss.LuGre(0.35, 0.45, stribeck_speed=2e-3, stiffness=1e4, damping=1.0).force(times, motion, normal),
    }
    for (name, force), style in zip(loops.items(), ("-", "--", "-.", ":"), strict=True):
        ax.plot(1e3 * position, force, style, lw=1.4, label=name)
    ax.set(xlabel="displacement (mm)", ylabel="friction force (N)", ylim=(-5.2, 9.5), xticks=[-1, -0.5, 0, 0.5, 1])
    ax.legend(fontsize=8, loc="upper left")


def draw_steps(ax: Axes) -> None:
    """Rate-and-state friction while the speed becomes ten times as high, and falls again."""
    times = np.unique(np.concatenate([np.linspace(0.0, 40.0, 801), [10.0 + 1e-6, 25.0 + 1e-6]]))
    speed = 1e-6 * np.where((times > 10.0) & (times <= 25.0), 10.0, 1.0)
    for form, style in (("ageing", "-"), ("slip", "--")):
        law = ss.DieterichRuina(0.6, 0.01, 0.015, length=1e-5, reference_speed=1e-6, form=form)
        ax.plot(times, law.force(times, speed), style, label=f"{form} form")
    ax.set(xlabel="time (s)", ylabel="friction coefficient")
    ax.text(17.5, 0.6105, "10 $\\mu$m/s", ha="center", fontsize=8)
    ax.text(5.0, 0.6105, "1 $\\mu$m/s", ha="center", fontsize=8)
    ax.legend(fontsize=8, loc="upper right")


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    draw_loops(left)
    draw_steps(right)
    plot.save((left, right), Path(__file__).with_name("friction_memory.png"), dpi=110, overwrite=True)
    plt.close(figure)


if __name__ == "__main__":
    main()
