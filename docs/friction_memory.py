"""Draw the figures of the page on friction with a memory: ``python docs/friction_memory.py``."""

import math
from collections.abc import Callable
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


MU, BASE, START, T1 = 0.9, ss.Harmonic(1.0, 0.4), (0.3, -0.2), 25.0
# Of each law: made with a stiffness of the bristles, whose damping is critical if they have one; and what its sticks'
# threshold is, m/s, times the root of the stiffness. Bristles without damping ring in sticks.
LAWS: dict[str, tuple[Callable[[float], ss.DynamicFriction], float]] = {
    "LuGre": (lambda stiffness: ss.LuGre(MU, MU, 1.0, stiffness, damping=2 * math.sqrt(stiffness)), 0.3),
    "elasto-plastic": (lambda stiffness: ss.ElastoPlastic(MU, MU, 1.0, stiffness, 2 * math.sqrt(stiffness)), 0.3),
    "Dahl": (lambda stiffness: ss.Dahl(MU, stiffness), 2.0),
}
STIFFNESSES = np.geomspace(1e3, 1e6, 7)


def _sticks(one: ss.Simulation) -> np.ndarray:
    """Begins and ends of all sticks, s, (2, sticks)."""
    there = np.asarray(one.sticks.mask)
    return np.stack([np.asarray(one.sticks.start)[there], np.asarray(one.sticks.end)[there]])


def errors_of(name: str) -> np.ndarray:
    """Largest errors of the state (m/s: velocity, and position times the angular frequency), and of begins and ends of
    sticks (s), for each stiffness, (3, stiffnesses).
    """
    times = np.linspace(0.0, T1, 50_001)
    exact = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(MU)), BASE, t1=T1, y0=START)
    make, share = LAWS[name]
    rows = []
    for stiffness in STIFFNESSES:
        threshold = share / math.sqrt(stiffness)
        method = ss.Regularized(rtol=1e-8, threshold=threshold, minimum_duration=0.2, max_steps=400_000)
        one = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, make(stiffness)), BASE, t1=T1, y0=START, method=method)
        x, v = np.array(one.evaluate(times)[:2]) - np.array(exact.evaluate(times))
        rows.append([np.max(np.hypot(2 * x, v)), *np.max(np.abs(_sticks(one) - _sticks(exact)), axis=1)])
    return np.transpose(rows)


def draw_orders(axes: np.ndarray) -> None:
    """Errors against Coulomb's exact sticks as bristles become stiffer, and the slopes of theory."""
    for name, marker in zip(LAWS, "os^", strict=True):
        for ax, errors in zip(axes, errors_of(name), strict=True):
            ax.loglog(STIFFNESSES, errors, marker + "-", ms=5, mfc="none", lw=1.2, label=name)
    titles = "state (m/s)", "begins of sticks (s)", "ends of sticks (s)"
    for ax, title, order in zip(axes, titles, (2, 2, 4), strict=True):
        ax.loglog(STIFFNESSES, 0.7 * STIFFNESSES ** (-1 / order), "k--", lw=1, label=f"slope $-$1/{order}")
        ax.set(xlabel="stiffness of the bristles (1/m)", title=title, ylim=(2e-4, 0.5))
    axes[0].set_ylabel("largest error")
    axes[0].legend(fontsize=8, loc="lower left")
    axes[2].legend(fontsize=8, loc="lower left")


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    draw_loops(left)
    draw_steps(right)
    plot.save((left, right), Path(__file__).with_name("friction_memory.png"), dpi=110, overwrite=True)
    plt.close(figure)
    figure, axes = plt.subplots(1, 3, figsize=(9.5, 3.4), layout="constrained")
    draw_orders(axes)
    plot.save(axes, Path(__file__).with_name("friction_memory_order.png"), dpi=110, overwrite=True)
    plt.close(figure)


if __name__ == "__main__":
    main()
