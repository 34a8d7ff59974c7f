"""What the tests of the figures of statistics share: small ensembles, and how to read what was drawn."""

import jax
import matplotlib as mpl
import numpy as np

mpl.use("Agg")

import stickslip_jax as ss

T1 = 40.0
MAP_LABELS = {"xlabel": "friction coefficient", "ylabel": "speed (m/s)", "label": "mean stick duration (s)"}


def simulate(samples, speed=1.0, keep="statistics"):
    """An ensemble; all have the same shape, so that one compiled function serves them."""
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))
    law = ss.PoissonSwitching(speed, 1.0)
    return ss.simulate_ensemble(
        system, law, t1=T1, samples=samples, key=jax.random.key(0), y0=(0.0, 1.0), chunk=64, threads=1, keep=keep,
        orders=30,
    )  # fmt: skip


def steps(ax):
    """Heights and edges of the outline of the histogram in `ax`."""
    drawn = [patch for patch in ax.patches if isinstance(patch, mpl.patches.StepPatch)]
    heights, edges, _ = drawn[-1].get_data()
    return heights, edges


def error_bars(ax, upright=True):
    """Where each error bar stands, its lower and its upper end, (bars,) each."""
    (container,) = ax.containers
    ends = np.array(container.lines[2][0].get_segments())
    place, value = (0, 1) if upright else (1, 0)
    return ends[:, 0, place], ends[:, 0, value], ends[:, 1, value]


def line(ax, label):
    (found,) = [drawn for drawn in ax.lines if str(drawn.get_label()).startswith(label)]
    return found


def only(ax, kind):
    (found,) = [drawn for drawn in ax.collections if isinstance(drawn, kind)]
    return found


def mesh(ax):
    """Colours (cells along x, along y; masked where white) and edges of a map."""
    drawn = only(ax, mpl.collections.QuadMesh)
    corners = drawn.get_coordinates()
    return drawn.get_array().T, corners[0, :, 0], corners[:, 0, 1]


def segments(drawn):
    """The segments of a line between its NaNs, arrays (points, 2)."""
    points = np.column_stack(drawn.get_data())
    missing = np.isnan(points[:, 0])
    if np.all(missing):
        return []
    return [piece[~np.isnan(piece[:, 0])] for piece in np.split(points, np.flatnonzero(missing))]


def texts(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def band_of(ax):
    """The ends of the band above each abscissa."""
    corners = only(ax, mpl.collections.FillBetweenPolyCollection).get_paths()[0].vertices
    return {x: (min(corners[corners[:, 0] == x, 1]), max(corners[corners[:, 0] == x, 1])) for x in set(corners[:, 0])}
