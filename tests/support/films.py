"""What the tests of films share: how to read a picture, and a system of a user's."""

import math

import matplotlib as mpl
import numpy as np

mpl.use("Agg")

import stickslip_jax as ss
from stickslip_jax.plot import _style


class Pair(ss.SwitchedSystem):
    """Two masses in a row, the second of which rubs on the base."""

    stiffness: float
    mass: float
    normal_force: float
    mu: float
    mu_static: float

    @property
    def state_names(self):
        return "position 1 in m", "velocity 1 in m/s", "position 2 in m", "velocity 2 in m/s"

    def rates(self, t, y, base, friction):
        x1, v1, x2, v2 = y
        pull = self.stiffness * (x2 - x1)
        force = friction * self.mu * self.normal_force
        return v1, (pull - self.stiffness * x1) / self.mass, v2, (-pull - force) / self.mass

    def relative_velocity(self, t, y, base):
        return y[3] - base.velocity

    @property
    def static_ratio(self):
        return self.mu_static / self.mu

    @property
    def shortest_time(self):
        return 2 * math.pi / (1.618 * (self.stiffness / self.mass) ** 0.5)


def bodies(figure):
    """The bodies of the mechanism, in the order in which they are drawn, without those that are fixed."""
    return [
        patch
        for patch in figure.axes[0].patches
        if isinstance(patch, mpl.patches.Rectangle) and patch.get_hatch() is None
    ]


def disks(figure):
    """Centre and radius of each disk, and the angles of its marks; in the order in which they are drawn."""
    circles = [patch for patch in figure.axes[0].patches if isinstance(patch, mpl.patches.Circle)]
    marks = marks_of(figure)
    found = []
    for circle, segments in zip(circles, marks, strict=True):
        ways = [segment[1] - np.array(circle.get_center()) for segment in segments]
        found.append((circle.get_center(), circle.get_radius(), [math.atan2(y, x) for x, y in ways]))
    return found


def marks_of(figure):
    """The segments of each set of marks."""
    drawn = [one for one in figure.axes[0].collections if isinstance(one, mpl.collections.LineCollection)]
    return [one.get_segments() for one in drawn]


def springs(figure):
    """The ends (2, 2) of each spring, in the units of the axes."""
    ax = figure.axes[0]
    lines = [line for line in ax.lines if line.get_transform() == figure.dpi_scale_trans]
    return [
        ax.transData.inverted().transform(figure.dpi_scale_trans.transform(line.get_xydata()[[0, -1]]))
        for line in lines
    ]


def rods(figure):
    """The ends (2, 2) of each rod."""
    ax = figure.axes[0]
    return [
        line.get_xydata()
        for line in ax.lines
        if line.get_transform() != figure.dpi_scale_trans and line.get_color() != _style.BASE
    ]


def history(figure):
    """The line of the coordinate, and that of its sticks."""
    by_colour = {
        line.get_color(): line
        for line in figure.axes[1].lines
        if line.get_linestyle() == "-" and line.get_marker() == "None"
    }
    return by_colour[_style.MASS], by_colour[_style.STICK]


def contact_rows(figure):
    """Row, start and end of each bar."""
    (drawn,) = figure.axes[2].collections
    corners = [path.vertices for path in drawn.get_paths()]
    return [(round(each[:, 1].mean()), each[:, 0].min(), each[:, 0].max()) for each in corners]
