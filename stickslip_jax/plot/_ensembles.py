"""Figures of many samples: histograms of one quantity and of two, sticks by where they begin and when they happen, one
stick after the other, and how estimates converge.
"""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, to_rgba
from matplotlib.patches import StepPatch

from .._dynamics.simulation import Simulation
from .._ensemble.ensemble import Ensemble
from .._excitation.motion import Signal
from .._foundation import checks
from .._foundation.types import Ending, Status
from .._statistics.distribution import DEFAULT_BINS, Distribution, JointDistribution, bin_of
from .._statistics.estimate import DEFAULT_LEVEL, check_level
from .._statistics.quantities import SLIP_QUANTITIES, STICK_QUANTITIES, FirstSticks
from .._statistics.totals import Convergence, HistogramConvergence
from .._systems.motor_cart import MotorCart, stick_duration_bound
from .._systems.system import System, require_system, unphased
from . import _style
from ._style import Bins, JointBins, SeveralAxes, SimulatedSticks, Voltage, Window, legend_above, plain_numbers
from ._trajectory import TRACED, check_simulation, check_window, contact_rows, require_one_contact

# The complete sticks of a result, one by one: their durations and the positions at which they begin.


def complete_sticks(result: SimulatedSticks, *, also: str = "") -> tuple[np.ndarray, np.ndarray, str]:
    """The complete sticks of a `Simulation`, one or a batch, of an `Ensemble`, those that it kept, or of `FirstSticks`.

    They are those whose end was seen, in samples that reached ``t1``: how long they last (s), where they begin (m; of a
    motor its angle, rad), (sticks,) each, and for legends how many there are.

    `also`: what else the figure takes, for the message.

    Raises:
        ValueError: For anything else, and for an ensemble with ``keep="totals"``.
    """
    part = ""
    if isinstance(result, Ensemble):
        sticks = result.numbered_sticks()
        used, duration = np.ones(len(sticks.start), bool), sticks.duration
        part = f" of the first {len(sticks.count):,} samples" if len(sticks.count) < result.finished else ""
    elif isinstance(result, FirstSticks):
        sticks, used, duration = result, result.mask, result.duration
    elif isinstance(result, Simulation):
        require_one_contact(result)
        sticks = result.sticks
        if any(checks.is_traced(leaf) for leaf in (sticks.mask, result.status)):
            raise ValueError(TRACED)
        used = np.asarray(sticks.mask) & (np.asarray(result.status) == Status.FINISHED)[..., None]
        duration = np.asarray(sticks.duration)
    else:
        demand = f"be a result of simulate_ensemble or of simulate, or of first_stick{also}"
        raise checks.refused("result", demand, result)
    cut = np.asarray(sticks.ending) == Ending.HORIZON
    kept, left_out = used & ~cut, int(np.sum(used & cut))
    duration, position = (np.asarray(values, float)[kept] for values in (duration, sticks.position))
    label = (f"{len(duration):,} sticks" if len(duration) else "no sticks") + part
    return duration, position, label + (f" ({left_out:,} more, cut by the end, left out)" if left_out else "")


def edges_of_bins(name: str, bins: Bins, span: tuple[float, float], unit: str) -> np.ndarray:
    """The edges of `bins`, (bins + 1,): so many of equal width over `span`, or the increasing edges given.

    `name` of the argument and `unit` are for the message.

    Raises:
        ValueError: For anything else.
    """
    if np.ndim(bins) == 0:
        return np.linspace(*span, checks.whole_number(name, bins) + 1)
    checks.numeric(name, bins, ndim=1)
    edges = np.asarray(bins, float)
    if len(edges) < 2 or np.any(np.diff(edges) <= 0):
        raise checks.refused(name, f"be a whole number or increasing edges (in {unit})", bins)
    return edges


def outside(label: str, number: int) -> str:
    """`label` with a line on how many sticks lie outside the bins, if any do."""
    return f"{label}\n{number:,} of them outside the bins" if number else label


# Where complete sticks begin, on the first coordinate of the system, and how long they can last there.


_BOUND_POINTS = 1441  # of the bound: every quarter of a degree


class PlacedSticks(NamedTuple):
    """Complete sticks to draw over the coordinate at which they begin; arrays (sticks,).

    - `duration`: s. `position`: m; of a motor its angle modulo `period`, rad.
    - `label`: how many there are. `system`: what was simulated.
    - `voltage`: whose bound of durations to draw, or None. `period`: of the angle, or None for a position.
    """

    duration: np.ndarray
    position: np.ndarray
    label: str
    system: System
    voltage: Signal | None
    period: float | None


def placed_sticks(
    result: SimulatedSticks, system: System | None, bound: Voltage | None, period: float | None, *, also: str = ""
) -> PlacedSticks:
    """The complete sticks of `result`, and what else to draw with them, checked.

    `also`: what else the figure takes, for the message.

    Raises:
        ValueError: For unsuitable arguments.
    """
    duration, position, label = complete_sticks(result, also=also)
    known = None if isinstance(result, FirstSticks) else result.system
    if system is None and known is None:
        raise ValueError(
            "Argument system must be given with FirstSticks, which do not say whether their positions are lengths or "
            "angles: system=ensemble.system."
        )
    system = known if system is None else system
    require_system(system)
    assert system is not None
    if known is not None and type(known) is not type(system):
        raise checks.refused("system", f"be the {type(known).__name__} that was simulated", system)
    if np.any(np.isnan(position)):
        raise ValueError(
            "Argument result must hold sticks with positions, but those of these sticks were not measured; draw "
            "histogram(result), their durations."
        )
    whole = system.coordinates[0].period
    voltage: Any = unphased(bound)  # the user's, until it is checked
    if voltage is not None and np.ndim(getattr(system, "mu", 0.0)) > 0:
        raise ValueError(
            "Argument system must be given with the bound, which is that of one MotorCart, but a batch of shape "
            f"{np.shape(getattr(system, 'mu', 0.0))} was simulated."
        )
    longest = system.look.longest_stick
    if voltage is not None and not (whole and longest is not None and longest(voltage, np.zeros(1)) is not None):
        demand = "be a SourceVoltage, or RandomPhase(SourceVoltage(...)), and be given for a MotorCart only"
        raise ValueError(
            f"Argument bound must {demand}, but {checks.show(bound)} was given for a {type(system).__name__}."
        )
    if period is None:
        period = whole
    else:
        checks.numeric("period", period)
        if not whole or not np.any(np.isclose(period, (whole / 2, whole), rtol=1e-6)):
            raise ValueError(
                "Argument period must be pi or 2 pi (in rad), and be given for a MotorCart only, but "
                f"{checks.show(period)} was given for a {type(system).__name__}."
            )
    position = position if period is None else np.mod(position, period)
    return PlacedSticks(duration, position, label, system, voltage, period)


def finish(ax: Axes, sticks: PlacedSticks) -> None:
    """Draw the bound, name the axes and set their limits; with a note where there are no sticks."""
    if sticks.voltage is not None and sticks.period is not None:
        angles = np.linspace(0, sticks.period, _BOUND_POINTS)
        bound = sticks.system.look.longest_stick
        assert bound is not None
        longest = np.asarray(bound(sticks.voltage, angles), float)
        endless = np.isinf(longest)
        drawn = np.where(endless, np.nan, longest)
        ax.plot(angles, drawn, color=_style.MASS, lw=1.5, label="longest possible, closed form")
        if np.any(endless):  # shaded where there is no limit
            look = {"color": _style.BAND, "alpha": 0.3, "lw": 0, "zorder": 0, "label": "sticks of any duration"}
            ax.fill_between(angles, 0, 1, where=endless, transform=ax.get_xaxis_transform(), **look)
    if len(sticks.duration) == 0:
        _style.note(ax, sticks.label)
    first = sticks.system.coordinates[0]
    if sticks.period is None:
        ax.set_xlabel(first.labeled(" where the stick begins"))
    else:
        name = _style.angle_axis(ax, sticks.period)
        ax.set_xlabel(first.labeled(f" of the stick, modulo {name}"))
    ax.set_ylabel(_style.quantity_label("stick duration", "s"))
    ax.set_ylim(bottom=0)


# The longest possible stick of a motor against the angle at which it stops.


_LONG = 20  # letters: three columns of longer labels are wider than the axes


def stick_bounds(
    system: MotorCart, voltage: Voltage, *, mu: Sequence[float] | np.ndarray | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the longest possible duration of a stick of a `MotorCart` against its angle, a curve for each `mu`.

    This is Lima and Sampaio (2022), figure 3; see `stick_duration_bound`. A curve is interrupted where the bound is
    infinite; the legend gives the share of such angles, and says so where no angle allows a stick.

    Args:
        system: A `MotorCart`.
        voltage: A `SourceVoltage`, or a `RandomPhase` of one, which has the same bound.
        mu: Friction coefficients in place of that of `system`, zero or positive.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind.
    """
    signal: Any = unphased(voltage)
    stick_duration_bound(system, signal, 0.0)  # refuses arguments of another kind
    if mu is None and system.friction is not None:
        systems = {type(system.friction).__name__: system}
    else:
        given = np.atleast_1d(np.asarray(system.mu if mu is None else mu, float))
        checks.numeric("mu", given, ndim=1)
        systems = {rf"$\mu$ = {one:g}": dataclasses.replace(system, mu=float(one), friction=None) for one in given}
    ax = _style.axes_or_new(ax, (5.6, 4.0))
    period = system.coordinates[0].period
    assert period is not None
    angles = np.linspace(0, period, _BOUND_POINTS)
    for name, one in systems.items():
        longest = np.asarray(stick_duration_bound(one, signal, angles), float)
        endless = np.isinf(longest)
        none = not np.any(longest > 0)
        label = f"{name}, no limit at {100 * endless.mean():.0f} % of the angles" if endless.any() else name
        look = _style.next_look(ax, angles)
        if none:  # a curve that is zero throughout lies on the axis, below the ends of the others
            label, look = f"{label}: no stick", look | {"lw": 2.5 * _style.SLIP_WIDTH, "zorder": 3, "clip_on": False}
        ax.plot(angles, np.where(endless, np.nan, longest), label=label, **look)
    _style.angle_axis(ax, period)
    ax.set_xlabel(system.coordinates[0].labeled(" of the stick"))
    ax.set_ylabel(_style.quantity_label("longest possible stick duration", "s"))
    ax.autoscale(axis="y")  # to all curves that have been drawn, also in axes that share this one's scale
    ax.set_ylim(bottom=0)
    longest_label = max(map(len, ax.get_legend_handles_labels()[1]))
    legend_above(ax, columns=2 if longest_label > _LONG else 3)
    return ax


# The distribution of one quantity.


def histogram(
    result: Distribution | SimulatedSticks,
    *,
    bins: Bins | None = None,
    label: str | None = None,
    quantiles: Sequence[float] = (),
    ax: Axes | None = None,
) -> Axes:
    """Draw the histogram of one quantity, or of the durations of complete sticks, as a probability density.

    Call it again with the same `ax` to compare: each histogram has a colour of its own, and all fit into the axes.

    The height is a probability density, 1/unit; of whole numbers it is the probability of each number, averaged over
    the numbers of a bin where these share one.

    Args:
        result: A distribution, such as ``ensemble.statistics.duration`` or ``.order(2).start``. Its histogram is drawn
            over all samples, with bars of one standard error and the mean; sticks and slips cut by the end are
            included with the part seen. From a single sample there is no standard error.

            Or the sticks themselves: an `Ensemble` (the sticks that it kept; with ``keep="statistics"`` those of the
            first samples), ``first_stick(ensemble)``, or a `Simulation` (one, or a batch by ``vmap``). The durations of
            complete sticks are drawn; the legend gives the number of those cut by the end, which are left out. So
            are samples that did not reach ``t1``.
        bins: Of a distribution, the largest number of bins, which have equal width and hold all values; by default 50,
            of whole numbers one for each number, centred on it. Of sticks, the number of equal bins from 0 to the
            longest duration, by default 50, or their increasing edges, s. Sticks outside the edges are not drawn but
            count: density times bin width stays the share of all complete sticks.
        label: What is drawn, before the number of values in the legend.
        quantiles: Shares of the values, between 0 and 1, such as ``(0.05, 0.5, 0.95)``: behind the bars a line stands
            at the value that each share does not exceed, and a band from the lowest to the highest.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if there is nothing to draw.

    Raises:
        ValueError: For an ensemble with ``keep="totals"``, for edges given with a distribution, and for arguments of
            another kind.
    """
    mean, is_whole = None, False
    if isinstance(result, Distribution):
        if bins is not None and np.ndim(bins) > 0:
            demand = "be a whole number for a distribution, whose bins were fixed while it was summed"
            raise checks.refused("bins", demand, bins, "edges go with the sticks: histogram(ensemble, bins=edges)")
        drawn = result.histogram(None if bins is None else checks.whole_number("bins", bins))
        number, name, unit, is_whole, where = result.number, result.name, result.unit, result.is_whole, result.quantile
        # A bin of whole numbers is centred on its number.
        edges, heights, errors = drawn.edges - 0.5 * is_whole, drawn.density, drawn.error
        color, mean = _style.STICK if "stick" in name else _style.SERIES[0], result.mean if number else None
        values = _style.counted(number, "value") if number else "no values"
        bars = "; bars: standard error" if np.any(np.isfinite(errors)) else ""
        text = f"{values} in {_style.counted(result.samples, 'sample')}{bars}"
    else:
        duration, _, text = complete_sticks(result, also=", or a Distribution such as ensemble.statistics.duration")
        number, name, unit, color = len(duration), "stick duration", "s", _style.STICK
        longest = duration.max(initial=0) or 1.0
        edges = edges_of_bins("bins", DEFAULT_BINS if bins is None else bins, (0.0, longest), "s")
        counts, _ = np.histogram(duration, edges)
        heights, errors = counts / (max(number, 1) * np.diff(edges)), np.full(len(counts), np.nan)
        text, where = outside(text, number - int(counts.sum())), partial(np.quantile, duration)
    checks.text("label", label, or_none=True)
    text = text if label is None else f"{label}: {text}"
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    earlier, ylabel = _outlines(ax), "probability" if is_whole else _style.density_label(unit)
    for axis, named in ((ax.xaxis, _style.quantity_label(name, unit)), (ax.yaxis, ylabel)):
        before = axis.get_label_text() if earlier else ""
        if named not in before:  # each name once
            axis.set_label_text(f"{before}, {named}" if before else named)
    if number:
        if is_whole:
            _style.whole_numbers(ax.xaxis)
        used = {to_rgba(outline.get_edgecolor(), 1.0) for outline in earlier}
        color = next((one for one in (color, *_style.SERIES) if to_rgba(one) not in used), color)
        _style.draw_histogram(ax, edges, heights, errors, color, label=text)
        if mean is not None:
            named, color = f"mean {_style.with_error(mean)}", color if earlier or label else _style.MASS
            if np.isfinite(error := mean.standard_error):
                ax.axvspan(mean.value - error, mean.value + error, color=color, alpha=0.25, lw=0, zorder=0)
                named += " (shaded: ±)"
            ax.axvline(mean.value, color=color, lw=_style.SLIP_WIDTH, ls="--", label=named)
        _style.draw_quantiles(ax, quantiles, where, unit)
        edges = np.concatenate([outline.get_data()[1] for outline in _outlines(ax)])
        ax.set_xlim(edges.min(), edges.max())
        ax.autoscale(axis="y")
        ax.set_ylim(bottom=0)
    elif earlier:
        ax.plot([], [], ls="none", label=text)
    else:
        _style.note(ax, text)
    legend_above(ax, columns=1)
    return ax


def _outlines(ax: Axes) -> list[StepPatch]:
    """The outlines of the histograms in `ax`."""
    return [patch for patch in ax.patches if isinstance(patch, StepPatch) and not patch.get_fill()]


# A joint histogram of two quantities, ready to draw: from the pairs of an ensemble, or from sticks one by one.


class Cells(NamedTuple):
    """A joint histogram.

    - `edges`: of the bins along x (m + 1,) and y (n + 1,). `counts`: of the pairs in them, and `density`, masked where
      no pair fell, (m, n). Of pairs, atoms are not in it.
    - `errors`: of the shares of pairs in the bins along x and along y, NaN if not known, (m,) and (n,).
    - `units`: of x and y. `number`: of all pairs. `label`: how many there are, or a note that there are none.
    """

    edges: tuple[np.ndarray, np.ndarray]
    counts: np.ndarray
    density: np.ma.MaskedArray
    errors: list[np.ndarray]
    units: tuple[str, str]
    number: int
    label: str


def cells_of_pairs(joint: JointDistribution, bins: JointBins) -> Cells:
    """The joint histogram of all pairs, with the standard errors of its sides.

    Raises:
        ValueError: Unless `bins` is a whole number of 1 to 128.
    """
    if isinstance(bins, (tuple, list, np.ndarray)):
        demand = "be a whole number for a joint distribution, whose bins were fixed while it was summed"
        hint = "bins of your own go with the sticks: joint_histogram(ensemble, bins=(edges, edges))"
        raise checks.refused("bins", demand, bins, hint)
    drawn = joint.histogram(checks.whole_number("bins", bins))
    edges, own = (drawn.x_edges, drawn.y_edges), (joint.x, joint.y)
    errors = [one.errors_of_shares(bin_of(one.values, at), len(at) - 1) for one, at in zip(own, edges, strict=True)]
    atoms = joint.share_of_atoms(int(bins))
    density = np.ma.masked_where((drawn.counts == 0) | (atoms == 1), drawn.density * (1 - atoms))
    label = _style.counted(drawn.number, "pair") if drawn.number else "no pairs"
    return Cells(edges, drawn.counts, density, errors, joint.units, drawn.number, label)


def cells_of_sticks(sticks: PlacedSticks, bins: JointBins) -> Cells:
    """The joint histogram of position (m or rad) and duration (s) of complete sticks.

    `bins`: as in `joint_histogram`.

    Raises:
        ValueError: For anything else.
    """
    pair = (bins, bins) if isinstance(bins, (int, np.integer)) else bins
    if not isinstance(pair, (tuple, list)) or len(pair) != 2:
        demand = "be a whole number, or two of them or of edges (of position, then of duration)"
        raise checks.refused("bins", demand, bins)
    low, high = (sticks.position.min(), sticks.position.max()) if len(sticks.position) else (0.0, 0.0)
    span = (low, high) if low < high else (low - 0.5, low + 0.5)
    units, number = (sticks.system.coordinates[0].unit, "s"), len(sticks.duration)
    edges = (
        edges_of_bins("bins[0]", pair[0], span if sticks.period is None else (0.0, sticks.period), units[0]),
        edges_of_bins("bins[1]", pair[1], (0.0, sticks.duration.max(initial=0) or 1.0), units[1]),
    )
    counts, *_ = np.histogram2d(sticks.position, sticks.duration, edges)
    density = np.ma.masked_equal(counts, 0) / (max(number, 1) * np.outer(*map(np.diff, edges)))
    errors = [np.full(bins, np.nan) for bins in counts.shape]
    label = outside(sticks.label, number - int(counts.sum()))
    return Cells(edges, counts, density, errors, units, number, label)


# The joint distribution of two quantities, and of each by itself.


_ALSO = ', or a JointDistribution such as ensemble.statistics.joint("duration", "position")'
_MEANS = 20  # bins at most of the conditional mean
_ROOM = 0.6  # of the width of the figure, for the legend above the joint histogram
_LARGEST = 1500  # square points: the area of an atom that holds all pairs


def joint_histogram(
    result: JointDistribution | SimulatedSticks,
    *,
    bins: JointBins = 40,
    log: bool = False,
    conditional_mean: bool = False,
    system: System | None = None,
    bound: Voltage | None = None,
    period: float | None = None,
    axes: Axes | SeveralAxes | None = None,
) -> tuple[Axes, ...]:
    """Draw the joint histogram of two quantities as a probability density, with the histogram of each beside it.

    Points that have a probability of their own (`JointDistribution.atoms`) are circles, whose area is in proportion to
    their share, and are left out of the density, which would depend on the bins. Cells without a pair are white.

    Args:
        result: A joint distribution, such as ``ensemble.statistics.joint("duration", "position")``: all pairs, sticks
            cut by the end included with the part seen; the histograms beside it have bars of one standard error.
            Or sticks as in `stick_map`, without those cut by the end: position at which they begin, and duration
            (of a `MotorCart`: Lima and Sampaio 2022, figures 4 and 5, right).
        bins: Of a joint distribution, the largest number of bins along each axis, at most 128. Of sticks, the number of
            equal bins each way, or two such numbers or sequences of increasing edges: of position (m, rad), then of
            duration (s). Sticks outside of edges are not drawn but count: density times area stays a share of all.
        log: Whether colours follow the logarithm of the density, to show rare pairs beside frequent ones.
        conditional_mean: Whether to draw the mean ordinate of the retained pairs of a joint distribution in each bin of
            the abscissa (20 bins at most), with bars of one standard error.
        system: With sticks only: what was simulated, where they do not know it.
        bound: With sticks only: the voltage of a `MotorCart` whose closed-form `stick_duration_bound` to draw.
        period: With sticks only: angles are drawn modulo this, pi or 2 pi, rad; by default 2 pi.
        axes: Three, of the joint histogram, above and right of it; or one, for it alone. By default those of a figure.

    Returns:
        The axes, with a note in the first if there is nothing to draw.

    Raises:
        ValueError: For an ensemble with ``keep="totals"``, and for arguments of another kind.
    """
    checks.truth("log", log)
    checks.truth("conditional_mean", conditional_mean)
    if isinstance(result, JointDistribution):
        for name, value in (("system", system), ("bound", bound), ("period", period)):
            if value is not None:
                hint = "it goes with the sticks: joint_histogram(ensemble)"
                raise checks.refused(name, "be left out with a joint distribution", value, hint)
        sticks, cells = None, cells_of_pairs(result, bins)
    else:
        sticks = placed_sticks(result, system, bound, period, also=_ALSO)
        if conditional_mean:
            hint = 'it is drawn of a joint distribution: ensemble.statistics.joint("position", "duration")'
            raise checks.refused("conditional_mean", "be False for sticks", True, hint)
        cells = cells_of_sticks(sticks, bins)
    if axes is None:
        figure = plt.figure(figsize=(6.4, 5.4), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(4, 1), height_ratios=(1, 4))
        main = figure.add_subplot(grid[1, 0])
        # Neighbours share their scales.
        others = [figure.add_subplot(grid[0, 0], sharex=main), figure.add_subplot(grid[1, 1], sharey=main)]
        others[0].tick_params(labelbottom=False)
        others[1].tick_params(labelleft=False)
        panels = (main, *others)
    elif len(panels := _style.axes_in(axes)) not in (1, 3):
        demand = "hold three matplotlib Axes (joint histogram, above it, to the right of it), or be one"
        raise checks.refused("axes", demand, axes)
    main, *others = panels
    _draw_density(panels, cells, log)
    if isinstance(result, JointDistribution):
        _draw_pairs(main, result, cells, bins if conditional_mean else 0)
    elif sticks is not None:
        finish(main, sticks)
    if others and cells.number:
        above, right = others
        above.set(xlim=main.get_xlim(), ylim=(0, None))
        right.set(ylim=main.get_ylim(), xlim=(0, None))
    legend_above(*others[:1], main, columns=1, room=_ROOM if others else None)
    for ax in others[1:]:
        plain_numbers(ax.xaxis)
    return panels


def _draw_density(panels: tuple[Axes, ...], cells: Cells, log: bool) -> None:
    """The density of all cells that hold a pair, the scale of its colours, and the histograms beside it."""
    main, *others = panels
    for axis, ax in enumerate(others):
        label = _style.density_label(cells.units[axis]).replace(" density", "\ndensity")
        ax.set(**{"ylabel" if axis == 0 else "xlabel": label})
    if not cells.number:
        return
    norm, label = LogNorm() if log else Normalize(vmin=0), _style.density_label(*cells.units)
    _style.draw_cells(main, cells.edges, cells.density, norm, label, list(panels))
    main.plot([], [], ls="none", label=cells.label)
    for axis, ax in enumerate(others):
        widths, shares = np.diff(cells.edges[axis]), cells.counts.sum(axis=1 - axis) / cells.number
        side = shares / widths, cells.errors[axis] / widths
        _style.draw_histogram(ax, cells.edges[axis], *side, _style.STICK, upright=axis == 0)


def _draw_pairs(main: Axes, joint: JointDistribution, cells: Cells, bins: Any) -> None:
    """The names of the axes and their limits, points that have a probability of their own, and the conditional mean.

    `bins` of the joint histogram; 0 without the mean.
    """
    xlabel, ylabel = map(_style.quantity_label, joint.labels, joint.units)
    main.set(xlabel=xlabel, ylabel=ylabel)
    if cells.number:
        main.set(xlim=cells.edges[0][[0, -1]], ylim=cells.edges[1][[0, -1]])
    else:
        _style.note(main, cells.label)
    atoms = joint.atoms
    if number := len(atoms.share):
        share = f"{100 * atoms.share.sum():.1f} % of the pairs"
        label = f"{number:,} points that {share} lie on" if number > 1 else f"a point that {share} lie on"
        look = {"facecolors": "none", "edgecolors": _style.STICK, "lw": 1.2, "clip_on": False, "zorder": 3}
        main.scatter(atoms.x, atoms.y, s=np.maximum(12, _LARGEST * atoms.share), label=label, **look)
    if bins and cells.number:
        means = joint.conditional_mean(min(bins, _MEANS))
        known = means.counts > 0
        centers, errors = (means.edges[1:] + means.edges[:-1]) / 2, np.nan_to_num(means.error)
        label = f"mean {joint.labels[1]} given the {joint.labels[0]}"
        look = {"marker": "o", "ms": 3, "lw": _style.SLIP_WIDTH, **_style.ERROR_LOOK}
        main.errorbar(centers[known], means.mean[known], errors[known], label=label, **look)


# The durations of sticks against the positions at which they begin.


_DOTS = (9.0, 0.6), (3.0, 0.35)  # area (square points) and opacity of points: of few, of many


def stick_map(
    result: SimulatedSticks,
    *,
    system: System | None = None,
    bound: Voltage | None = None,
    period: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the duration of each complete stick against the position at which it begins, a point for each.

    For a `MotorCart` and first sticks this is Lima and Sampaio (2022), figures 4 and 5, left. Sticks cut by the end
    are left out, because only a part of them was seen; the legend gives their number. So are samples that did not reach
    ``t1``.

    Args:
        result: An `Ensemble` (the sticks that it kept; with ``keep="statistics"`` those of the first samples); the
            first stick of each sample, ``first_stick(ensemble)``; or a `Simulation` (one, or a batch by ``vmap``).
        system: What was simulated. It must be given with ``first_stick(ensemble)``, which does not know it:
            ``ensemble.system``.
        bound: The voltage whose closed-form `stick_duration_bound` to draw (``ensemble.law``, say), for a `MotorCart`;
            by default none. The current's transient when a stick begins can prolong it by about the electrical time
            constant, inductance over resistance.
        period: Angles are drawn modulo this, pi or 2 pi, rad; by default 2 pi. The sticks of a `MotorCart` repeat
            themselves after pi.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if there is no complete stick.

    Raises:
        ValueError: For an ensemble with ``keep="totals"``, and for arguments of another kind.
    """
    sticks = placed_sticks(result, system, bound, period)
    ax = _style.axes_or_new(ax, (5.6, 4.0))
    if len(sticks.duration):
        _style.draw_dots(ax, sticks.position, sticks.duration, _DOTS, _style.STICK, sticks.label)
    finish(ax, sticks)
    legend_above(ax, columns=1)
    return ax


# When the sticks of many realisations happen.


def stick_raster(
    result: Ensemble | Simulation, *, samples: int = 100, window: Window | None = None, ax: Axes | None = None
) -> Axes:
    """Draw each stick of the first realisations as a bar: time to the right, a row for each realisation.

    Rows are the realisations that reached ``t1``, counted from 0 at the top. Sticks cut by the end stop there.

    Args:
        result: An `Ensemble` with ``keep="statistics"`` or ``"sticks"``. Or a simulation with several contacts: a row
            for each contact, and one for the times in which all closed contacts stick.
        samples: How many realisations to draw, at most.
        window: First and last time to draw, s; all of ``[0, t1]`` by default.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if there is no stick in the window.

    Raises:
        ValueError: For an ensemble with ``keep="totals"``, and for arguments of another kind.
    """
    if isinstance(result, Simulation) and result._of_all_contacts is not None:
        check_simulation(result, of_one_contact=False)
        shown = check_window(window, float(result.time_reached))
        ax = _style.axes_or_new(ax, (6.4, 1.4 + 0.3 * min(result.system.tracks.contacts or 1, 16)))
        contact_rows(ax, result, shown)
        _style.mark_unfinished(ax, result)
        legend_above(ax)
        return ax
    result = require_ensemble(result)
    checks.whole_number("samples", samples)
    begin, end = check_window(window, result.t1)
    every = result.finished_sticks()
    sticks = every.head(min(samples, len(every.count)))
    rows = len(sticks.count)
    shown = (sticks.end > begin) & (sticks.start < end)
    ax = _style.axes_or_new(ax, (6.4, 4.4))
    number = int(np.count_nonzero(shown))
    if number:
        corners = _style.sticks_in_rows(sticks.sample[shown], sticks.start[shown], sticks.end[shown])
        label = f"{_style.counted(number, 'stick')} in {rows:,} of {_style.counted(result.samples, 'realisation')}"
        _style.draw_polygons(ax, corners, facecolor=_style.STICK, rasterized=number > _style.MANY, label=label)
    else:
        _style.note(ax, "no sticks")
    ax.set_xlim(begin, end)
    ax.set_ylim(max(rows, 1) - 0.5, -0.5)
    _style.whole_numbers(ax.yaxis)
    ax.set_xlabel("time $t$ (s)")
    ax.set_ylabel("realisation" if result.finished == result.samples else "realisation (of those that finished)")
    legend_above(ax, columns=1)
    return ax


def require_ensemble(result: Ensemble | Simulation) -> Ensemble:
    """`result` itself. Raises ValueError unless it is an ensemble."""
    if not isinstance(result, Ensemble):
        raise checks.refused("result", "be an Ensemble", result, "give the result of simulate_ensemble")
    return result


# The mean of a quantity over the first sticks of all samples, over their second sticks, and so on.


_BOTTOM = 0.3  # of the height of the axes, for the shares


def means_by_order(
    result: Ensemble, quantity: str = "duration", *, level: float = DEFAULT_LEVEL, ax: Axes | None = None
) -> Axes:
    """Draw the mean over the samples of the i-th stick's duration, start or position, or of a slip's, against i.

    Each mean is over the samples that have an i-th one, with its confidence interval. Where not all samples have one,
    gray bars at the bottom show the share of those that do, on the axis at the right. Orders that no sample has are
    left out.

    Args:
        result: An `Ensemble` with ``keep="statistics"`` or ``"sticks"``.
        quantity: "duration" (s), "start" (s) or "position" (m; of a motor its angle, rad) of the stick; "slip_duration"
            or "slip_start" (s) of the slip, from the retained samples.
        level: Of the confidence intervals, by Student's t. There are none from a single sample.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if there are no sticks.

    Raises:
        ValueError: For an ensemble with ``keep="totals"``, and for arguments of another kind.
    """
    require_ensemble(result)
    of_slips = [one.name for one in SLIP_QUANTITIES]
    checks.chosen("quantity", quantity, [*(one.name for one in STICK_QUANTITIES), *of_slips])
    check_level(level)
    body = "slip" if quantity in of_slips else "stick"
    statistics = result.statistics.slips if body == "slip" else result.statistics
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    orders = [statistics.order(number) for number in range(1, result.statistics.orders + 1)]
    present = [order for order in orders if order.share.value > 0]
    name = quantity.removeprefix("slip_")
    ylabel = _style.quantity_label(f"mean {name} of the $i$-th {body}", getattr(statistics, name).unit)
    ax.set(xlabel=f"order $i$ of the {body} in its sample", ylabel=ylabel)
    if not present:
        _style.note(ax, f"no {body}s")
        return ax
    numbers = np.array([order.number for order in present])
    means = [order.distributions[quantity].mean for order in present]
    values = np.array([mean.value for mean in means])
    low, high = np.array([mean.interval(level) for mean in means]).T
    look = {"color": _style.STICK if body == "stick" else _style.MASS, "lw": _style.SLIP_WIDTH, "marker": "o", "ms": 4}
    known, label = np.isfinite(low), "mean (no interval from one sample)"
    if np.any(known):
        errors = (values - low)[known], (high - values)[known]
        named = f"mean; bars: {_style.interval_name(level)}"
        ax.errorbar(numbers[known], values[known], errors, ls="none", capsize=3, label=named, **look)
        label = "_mean"
    ax.plot(numbers, values, ls="none", label=label, **look)
    _style.whole_numbers(ax.xaxis)
    ax.set_xlim(numbers[0] - 0.5, numbers[-1] + 0.5)
    shares, panels = np.array([order.share.value for order in present]), [ax]
    if not np.all(shares == 1):  # bars at the bottom, below all that is shown so far, on axes of their own
        bottom, top = ax.get_ylim()
        ax.set_yticks([tick for tick in ax.get_yticks() if bottom <= tick <= top])
        ax.set_ylim(top - (top - bottom) / (1 - _BOTTOM), top)
        below = ax.twinx()
        below.bar(numbers, 100 * shares, width=0.8, color=_style.FORWARD, alpha=0.5, lw=0, label="share of samples")
        below.set_ylim(0, 100 / (_BOTTOM - 0.06))
        below.set_yticks([0, 50, 100])
        below.set_ylabel(f"samples that have an $i$-th {body} (%)", loc="bottom", fontsize="small")
        panels.append(below)
    legend_above(*panels, columns=2)
    return ax


# How estimates converge as the number of samples grows.


_FEWEST = 10  # samples: intervals from fewer are so wide that the others could not be seen beside them


def convergence(
    result: Convergence | HistogramConvergence, *, level: float = DEFAULT_LEVEL, ax: Axes | None = None
) -> Axes:
    """Draw an estimate, or the distance between two joint histograms, against the number of samples.

    Args:
        result: Of `stickslip_jax.convergence`: the estimate with its confidence interval over a logarithmic axis of the
            number of samples, and a line at the estimate from all samples. Intervals from fewer than 10 samples may
            leave the axes. Or of `stickslip_jax.histogram_convergence`: the total-variation distance between two
            histograms with independent samples, both axes logarithmic, and the slope -1/2 that it approaches once every
            cell holds many pairs; distances of 0 are left out.
        level: Of the confidence intervals, by Student's t.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if no estimate or distance is defined.

    Raises:
        ValueError: For arguments of another kind.
    """
    if not isinstance(result, (Convergence, HistogramConvergence)):
        hint = "give the result of convergence or of histogram_convergence"
        raise checks.refused("result", "be a Convergence or a HistogramConvergence", result, hint)
    check_level(level)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    look = {"color": _style.SERIES[0], "lw": _style.SLIP_WIDTH, "marker": "o"}
    if isinstance(result, Convergence):
        ax.set(xlabel="number of samples", ylabel=_style.quantity_label(result.name, result.unit), xscale="log")
        values, nothing = result.values, f"not defined in {result.numbers[-1]:,} samples"
    else:
        xlabel = "number of samples of each of the two histograms"
        ax.set(xlabel=xlabel, ylabel="distance of the histograms\n(total variation)", xscale="log", yscale="log")
        values, nothing = np.where(result.distances > 0, result.distances, np.nan), "no distance is known"
    known = np.isfinite(values)
    numbers, values = result.numbers[known], values[known]
    if not len(values):
        _style.note(ax, nothing)
    elif isinstance(result, Convergence):
        low, high = (ends[known] for ends in result.band(level))
        label = f"from all {result.final.samples:,} samples: {_style.with_error(result.final)}"
        ax.axhline(result.final.value, label=label, **_style.REFERENCE)
        _style.shade_between(ax, numbers, low, high, _style.SERIES[0], _style.interval_name(level))
        ax.plot(numbers, values, ms=3, label="from the first samples", **look)
        resolved = np.isfinite(low) & (numbers >= min(_FEWEST, numbers[-1]))
        shown = np.concatenate([values, low[resolved], high[resolved], [result.final.value]])
        margin = 0.05 * np.ptp(shown) or 0.05 * abs(shown[0]) or 0.05
        ax.set_ylim(shown.min() - margin, shown.max() + margin)
    else:
        fitted = f", slope {result.slope:.2f}" if np.isfinite(result.slope) else ""
        ax.plot(numbers, values, ms=4, label=f"distance in {result.cells:,} cells with pairs{fitted}", **look)
        # The line begins at a distance of 1, the largest that there is.
        ends = np.array([max(numbers[0], numbers[-1] * values[-1] ** 2), numbers[-1]])
        line = values[-1] * np.sqrt(numbers[-1] / ends)
        ax.plot(ends, line, label="slope -1/2 through the last", **_style.REFERENCE)
    if ax.has_data():
        for axis in (ax.xaxis, ax.yaxis)[: 1 if isinstance(result, Convergence) else 2]:
            _style.log_axis(axis)
    legend_above(ax, columns=1)
    return ax
