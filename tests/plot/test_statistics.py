"""Figures of the statistics of an ensemble: what is drawn are their numbers, with errors and units."""

import dataclasses
import math

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from support.plot import MAP_LABELS, T1, band_of, error_bars, line, mesh, only, simulate, steps, texts

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax._ensemble.data import Retained
from stickslip_jax._statistics.totals import convergence, histogram_convergence
from stickslip_jax.plot import _style


def error_of_share(inside, owner, samples):
    """The standard error of the share of values inside, by the spread of (inside - share all) over the samples."""
    own = np.bincount(owner, weights=inside, minlength=samples)
    each = np.bincount(owner, minlength=samples)
    return np.std(own - inside.mean() * each, ddof=1) * math.sqrt(samples) / len(inside)


def test_histogram_draws_density_errors_and_mean(many):
    distribution, sticks = many.statistics.duration, many.numbered_sticks()
    ax = plot.histogram(distribution, bins=20)
    heights, edges = steps(ax)
    counts, _ = np.histogram(sticks.duration, edges)
    assert counts.sum() == len(sticks.duration)
    assert len(counts) <= 20
    assert heights == pytest.approx(counts / counts.sum() / np.diff(edges))
    place, low, high = error_bars(ax)
    assert place == pytest.approx((edges[1:] + edges[:-1])[counts > 0] / 2)
    assert (low + high) / 2 == pytest.approx(heights[counts > 0])
    inside = (sticks.duration >= edges[4]) & (sticks.duration < edges[5])
    assert (high - low)[4] / 2 * np.diff(edges)[4] == pytest.approx(error_of_share(inside, sticks.sample, 200))
    mean = line(ax, "mean")
    assert mean.get_xdata() == pytest.approx([sticks.duration.mean()] * 2)
    (span,) = [patch for patch in ax.patches if isinstance(patch, mpl.patches.Rectangle)]
    assert span.get_width() == pytest.approx(2 * distribution.mean.standard_error)
    assert span.get_x() + span.get_width() / 2 == pytest.approx(distribution.mean.value)
    shown = str(distribution.mean).partition(": ")[2].replace("+-", "±")
    assert texts(ax) == [
        f"{len(sticks.duration):,} values in 200 samples; bars: standard error",
        f"mean {shown} (shaded: ±)",
    ]
    assert ax.get_xlim() == (edges[0], edges[-1])


def test_quantiles_stand_behind_the_bars(many):
    distribution, sticks = many.statistics.duration, many.numbered_sticks()
    bars = min(patch.zorder for patch in plot.histogram(distribution).patches if hasattr(patch, "get_data"))
    for result, found in (
        (distribution, [distribution.quantile(share).value for share in (0.05, 0.5, 0.95)]),
        (many, np.quantile(sticks.duration[sticks.ending != ss.Ending.HORIZON], [0.05, 0.5, 0.95])),
    ):
        ax = plot.histogram(result, quantiles=(0.95, 0.05, 0.5))
        for share, value in zip((5, 50, 95), found, strict=True):
            mark = line(ax, f"{share} %: ")
            assert mark.get_xdata() == pytest.approx([value] * 2)
            assert mark.get_label() == f"{share} %: {value:.4g} s"
            assert mark.zorder < bars
        band = [patch for patch in ax.patches if isinstance(patch, mpl.patches.Rectangle)][-1]
        assert (band.get_x(), band.get_x() + band.get_width()) == pytest.approx((found[0], found[2]))
    with pytest.raises(ValueError, match="Argument quantiles must be"):
        plot.histogram(distribution, quantiles=(1.5,))


def test_histogram_of_whole_numbers_is_centered_on_them(many):
    ax = plot.histogram(many.statistics.stick_count)
    heights, edges = steps(ax)
    count = many.finished_sticks().count
    numbers = np.arange(count.min(), count.max() + 1)
    assert edges[:-1] == pytest.approx(numbers - 0.5)
    assert heights == pytest.approx([np.mean(count == number) for number in numbers])
    assert error_bars(ax)[0] == pytest.approx(numbers[heights > 0])
    # Of several numbers in a bin, the height is their mean share.
    heights, edges = steps(plot.histogram(many.statistics.stick_count, bins=5))
    assert np.diff(edges).min() > 1
    assert heights @ np.diff(edges) == pytest.approx(1)
    assert np.mod(edges, 1) == pytest.approx(0.5)


@pytest.mark.parametrize("log", [False, True])
def test_joint_histogram_and_its_sides(many, log):
    sticks = many.numbered_sticks()
    joint = many.statistics.joint("duration", "position")
    main, above, right = plot.joint_histogram(joint, bins=16, log=log)
    density, *edges = mesh(main)
    counts, *_ = np.histogram2d(sticks.duration, sticks.position, edges)
    spread = ~joint.atoms.of_pair
    assert 0.5 < spread.mean() < 1
    smooth, *_ = np.histogram2d(sticks.duration[spread], sticks.position[spread], edges)
    assert np.array_equal(np.ma.getmaskarray(density), smooth == 0)
    assert np.any(smooth == 0)
    area = np.outer(*map(np.diff, edges))
    assert np.ma.filled(density, 0) * area * len(sticks.duration) == pytest.approx(smooth)
    (circles,) = [drawn for drawn in main.collections if isinstance(drawn, mpl.collections.PathCollection)]
    assert np.asarray(circles.get_offsets()) == pytest.approx(np.column_stack([joint.atoms.x, joint.atoms.y]))
    for side, axis, values in ((above, 0, sticks.duration), (right, 1, sticks.position)):
        heights, own = steps(side)
        assert own == pytest.approx(edges[axis])
        assert heights * np.diff(own) * len(values) == pytest.approx(counts.sum(axis=1 - axis))
        _, low, high = error_bars(side, upright=axis == 0)
        inside = (values >= own[5]) & (values < own[6])
        assert np.all(heights[:6] > 0)
        assert (high - low)[5] / 2 * np.diff(own)[5] == pytest.approx(error_of_share(inside, sticks.sample, 200))
    assert main.get_xlim() == above.get_xlim()
    assert main.get_ylim() == right.get_ylim()
    share = 100 * (1 - spread.mean())
    assert len(joint.atoms.share) == 1
    atoms = f"a point that {share:.1f} % of the pairs lie on"
    assert texts(above) == [f"{len(sticks.duration):,} pairs", atoms]


def test_joint_histogram_with_the_conditional_mean(many):
    sticks = many.numbered_sticks()
    main, above, _ = plot.joint_histogram(
        many.statistics.joint(("duration", 1), ("duration", 2)), conditional_mean=True
    )
    assert main.get_xlabel() == "duration of stick 1 (s)"
    assert main.get_ylabel() == "duration of stick 2 (s)"
    first = sticks.first[sticks.count > 1]
    x, y = sticks.duration[first], sticks.duration[first + 1]
    edges = np.linspace(x.min(), x.max(), 21)
    place = np.clip(np.digitize(x, edges) - 1, 0, 19)
    filled = np.unique(place)
    (container,) = main.containers
    drawn = np.array(container.lines[0].get_data())
    assert drawn[0] == pytest.approx(((edges[1:] + edges[:-1]) / 2)[filled])
    assert drawn[1] == pytest.approx([y[place == index].mean() for index in filled])
    means = many.statistics.joint(("duration", 1), ("duration", 2)).conditional_mean(20)
    _, low, high = error_bars(main)
    assert (high - low) / 2 == pytest.approx(np.nan_to_num(means.error[filled]))  # of a single pair no bar
    assert "mean duration of stick 2 given the duration\nof stick 1" in texts(above)


@pytest.mark.parametrize("quantity", ["slip_start", "slip_duration"])
def test_means_of_slips_by_order(many, quantity):
    ax = plot.means_by_order(many, quantity)
    numbers, values = line(ax, "_mean").get_data()
    of_slips = [many.statistics.slips.order(int(number)).distributions[quantity] for number in numbers]
    assert values.tolist() == [one.mean.value for one in of_slips]
    assert len(numbers) > 5
    assert ax.get_ylabel() == f"mean {quantity[5:]} of the $i$-th slip (s)"
    assert ax.get_xlabel() == "order $i$ of the slip in its sample"


@pytest.mark.parametrize("quantity", ["start", "duration", "position"])
def test_means_by_order(many, quantity):
    sticks = many.numbered_sticks()
    ax = plot.means_by_order(many, quantity, level=0.8)
    numbers, values = line(ax, "_mean").get_data()
    most = sticks.count.max()
    assert most < many.statistics.orders  # the last orders are absent
    assert numbers.tolist() == list(range(1, most + 1))
    by_order = np.arange(len(sticks.start)) - np.repeat(sticks.first, sticks.count) + 1
    assert values == pytest.approx([getattr(sticks, quantity)[by_order == number].mean() for number in numbers])
    _, low, high = error_bars(ax)
    intervals = [getattr(many.statistics.order(int(number)), quantity).mean.interval(0.8) for number in numbers]
    drawn = np.column_stack([low, high])  # a single value has no interval
    assert drawn[np.isfinite(drawn).all(axis=1)] == pytest.approx(
        np.array(intervals)[np.isfinite(intervals).all(axis=1)]
    )
    (below,) = [other for other in ax.figure.axes if other is not ax]
    heights = [bar.get_height() for bar in below.patches]
    assert heights == pytest.approx([100 * np.mean(sticks.count >= number) for number in numbers])
    # The bars of the shares stay below all means and intervals.
    ax.figure.draw_without_rendering()
    top = max(below.transData.transform((0, height))[1] for height in heights)
    assert top < min(ax.transData.transform((0, value))[1] for value in low)
    assert texts(ax) == ["mean; bars: 80 % confidence interval", "share of samples"]


def test_raster_draws_each_stick_in_its_row(many):
    sticks = many.finished_sticks()
    ax = plot.stick_raster(many, samples=30)
    drawn = only(ax, mpl.collections.PolyCollection)
    boxes = np.array([path.get_extents().extents for path in drawn.get_paths()])
    used = sticks.sample < 30
    middle = (boxes[:, 1] + boxes[:, 3]) / 2
    assert middle == pytest.approx(sticks.sample[used])
    assert np.all(boxes[:, 3] - boxes[:, 1] < 1)
    assert boxes[:, 0].tolist() == sticks.start[used].tolist()
    assert boxes[:, 2].tolist() == sticks.end[used].tolist()
    assert ax.get_xlim() == (0, T1)
    assert ax.get_ylim() == (29.5, -0.5)  # the first on top
    assert mpl.colors.to_hex(drawn.get_facecolor()[0]).upper() == _style.STICK
    assert texts(ax) == [f"{used.sum():,} sticks in 30 of 200 realisations"]


def test_raster_in_a_window_and_of_all_samples(many):
    sticks = many.finished_sticks()
    ax = plot.stick_raster(many, samples=1000, window=(5.0, 15.0))
    inside = np.count_nonzero((sticks.end > 5) & (sticks.start < 15))
    assert len(only(ax, mpl.collections.PolyCollection).get_paths()) == inside
    assert texts(ax) == [f"{inside:,} sticks in 200 of 200 realisations"]
    assert (ax.get_xlim(), ax.get_ylim()) == ((5, 15), (199.5, -0.5))
    kept = plot.stick_raster(simulate(200, keep="sticks"), samples=1000, window=(5.0, 15.0))
    assert texts(kept) == texts(ax)


def test_maps_and_durations_of_the_sticks_retained(many):
    sticks = many.finished_sticks()
    few = dataclasses.replace(many, retained=Retained(sticks.head(60), many.retained.totals[:60]))
    sticks = many.numbered_sticks()
    for ensemble, samples in ((many, 200), (few, 60)):
        used = sticks.sample < samples
        complete = used & (sticks.ending != ss.Ending.HORIZON)
        ax = plot.stick_map(ensemble)
        drawn = np.asarray(only(ax, mpl.collections.PathCollection).get_offsets())
        assert drawn.tolist() == np.column_stack([sticks.position, sticks.duration])[complete].tolist()
        part = " of the first 60 samples" if samples == 60 else ""
        more = f" ({np.sum(used & ~complete):,} more, cut by the end, left out)"
        assert [text.replace("\n", " ") for text in texts(ax)] == [f"{complete.sum():,} sticks{part}{more}"]
        assert texts(plot.histogram(ensemble)) == texts(ax)


def draw_all(ensemble):
    """One figure of each kind: the axes that have the legend, and all axes."""
    statistics = ensemble.statistics
    panels = plot.joint_histogram(statistics.joint("start", "duration"), conditional_mean=True)
    return [
        (plot.histogram(statistics.position),) * 2,
        (plot.histogram(statistics.stick_count),) * 2,
        (panels[1], panels),
        (plot.means_by_order(ensemble),) * 2,
        (plot.stick_raster(ensemble),) * 2,
        (plot.stick_fraction_curve([1.0], [statistics.stick_fraction]),) * 2,
    ]


def test_axes_name_quantity_and_unit(many):
    drawn = [axes for _, axes in draw_all(many)]
    named = [(ax.get_xlabel(), ax.get_ylabel()) for ax in (*drawn[:2], *drawn[2], *drawn[3:])]
    assert named == [
        ("stick position (m)", "probability density (1/m)"),
        ("number of sticks", "probability"),
        ("stick start (s)", "stick duration (s)"),
        ("", "probability\ndensity (1/s)"),
        ("probability\ndensity (1/s)", ""),
        ("order $i$ of the stick in its sample", "mean duration of the $i$-th stick (s)"),
        ("time $t$ (s)", "realisation"),
        (r"frequency ratio $r = f_\mathrm{b}\,/\,(\omega/2\pi)$ (dimensionless)", "stick fraction $T_s$ (%)"),
    ]
    assert drawn[2][0].figure.axes[-1].get_ylabel() == "probability density (1/s$^2$)"
    joint = plot.joint_histogram(many.statistics.joint("duration", "position"))
    assert joint[0].figure.axes[-1].get_ylabel() == "probability density (1/(s m))"
    assert plot.histogram(many.statistics.stick_fraction).get_ylabel() == "probability density"
    settled = [convergence(ss.mean_stick_duration, many), histogram_convergence(many, bins=6)]
    assert [(ax.get_xlabel(), ax.get_ylabel()) for ax in map(plot.convergence, settled)] == [
        ("number of samples", "mean stick duration (pooled) (s)"),
        ("number of samples of each of the two histograms", "distance of the histograms\n(total variation)"),
    ]


@pytest.mark.slow
def test_legends_hide_no_data(many):
    """Each legend lies wholly above its axes and inside the figure."""
    holes = np.array([[1.0, 2.0], [3.0, np.nan]])
    others = [
        plot.convergence(convergence(ss.stick_fraction, many)),
        plot.convergence(histogram_convergence(many, bins=6)),
        plot.parameter_map([1, 2], [1, 2], holes, **MAP_LABELS),
    ]
    for ax in (*(drawn[0] for drawn in draw_all(many)), *others):
        ax.figure.draw_without_rendering()
        legend, axes, figure = ax.get_legend().get_window_extent(), ax.get_window_extent(), ax.figure.bbox
        assert axes.y1 <= legend.y0 < legend.y1 <= figure.y1 + 1
        assert figure.x0 - 1 <= legend.x0 < legend.x1 <= figure.x1 + 1


def test_given_axes_are_used_and_no_other_figure_is_made(many):
    axes = mpl.figure.Figure().subplots(3, 3).flat
    statistics = many.statistics
    assert plot.histogram(statistics.duration, ax=axes[0]) is axes[0]
    assert plot.means_by_order(many, "start", ax=axes[1]) is axes[1]
    assert plot.convergence(convergence(ss.stick_fraction, many), ax=axes[2]) is axes[2]
    assert plot.stick_raster(many, ax=axes[3]) is axes[3]
    assert plot.stick_fraction_curve([1.0], [ss.stick_fraction(many)], ax=axes[4]) is axes[4]
    assert plot.parameter_map([1, 2], [1, 2], np.ones((2, 2)), **MAP_LABELS, ax=axes[5]) is axes[5]
    assert plot.joint_histogram(statistics.joint("start", "position"), axes=axes[6:]) == tuple(axes[6:])
    assert axes[6].get_xlim() == axes[7].get_xlim()
    assert axes[6].get_ylim() == axes[8].get_ylim()
    assert plt.get_fignums() == []


def test_no_sticks_are_noted(none):
    statistics = none.statistics
    main, above, right = plot.joint_histogram(statistics.joint("duration", "position"), conditional_mean=True)
    notes = {
        "no values in 3 samples": plot.histogram(statistics.duration),
        "no pairs": main,
        "no sticks": plot.means_by_order(none),
    }
    for text, ax in (*notes.items(), ("no sticks", plot.stick_raster(none))):
        assert [note.get_text() for note in ax.texts] == [text]
        assert ax.get_xlabel()
        assert ax.get_ylabel()
        ax.figure.draw_without_rendering()
    assert not above.patches
    assert not right.patches
    heights, edges = steps(plot.histogram(statistics.stick_count))
    assert heights.tolist() == [1]
    assert edges.tolist() == [-0.5, 0.5]
    ax = plot.convergence(convergence(ss.mean_stick_duration, none))
    assert [note.get_text() for note in ax.texts] == ["not defined in 3 samples"]


def test_one_sample_is_drawn_without_errors(single):
    (_, histogram), (_, counts), (_, panels), (_, means), (_, raster), (_, curve) = drawn = draw_all(single)
    for ax, _ in drawn:
        ax.figure.draw_without_rendering()
    number = single.statistics.duration.number
    assert number > 2
    assert texts(histogram)[0] == f"{number} values in 1 sample"
    assert texts(histogram)[1].endswith("m (no error from one sample)")
    assert not any(ax.containers for ax in (histogram, counts, panels[1], panels[2]))
    assert texts(means) == ["mean (no interval from one sample)"]
    assert not means.containers
    assert texts(raster) == [f"{len(single.finished_sticks().start)} sticks in 1 of 1 realisation"]
    assert np.ptp(list(band_of(curve).values())) == pytest.approx(
        0, abs=100 * single.statistics.stick_fraction.resolution
    )
    one = plot.histogram(single.statistics.order(1).duration)  # a single value
    heights, edges = steps(one)
    assert heights @ np.diff(edges) == pytest.approx(1)
    one.figure.draw_without_rendering()


@pytest.mark.slow
def test_bad_arguments(many, annotations_unchecked):
    statistics = many.statistics
    joint = statistics.joint("duration", "position")
    totals = simulate(2, keep="totals")
    settled = convergence(ss.stick_fraction, many)
    curve, square = plot.stick_fraction_curve, np.ones((2, 2))
    length = statistics.duration
    wrong = [
        (plot.histogram, (statistics,), {}, "result must be a result of .*, or a Distribution such as"),
        (plot.histogram, (length,), {"bins": 0}, "bins must be a whole number of at least 1"),
        (plot.histogram, (length,), {"ax": "here"}, "ax must be a matplotlib Axes"),
        (plot.joint_histogram, (length,), {}, "result must be a result of .*, or a JointDistribution such as"),
        (plot.joint_histogram, (joint,), {"bins": 129}, "bins must be at most 128"),
        (plot.joint_histogram, (joint,), {"log": 1}, "log must be True or False"),
        (plot.joint_histogram, (joint,), {"conditional_mean": "yes"}, "conditional_mean must be True or False"),
        (plot.joint_histogram, (joint,), {"axes": plt.figure().subplots(2)}, "axes must hold three matplotlib Axes"),
        (plot.means_by_order, (statistics,), {}, "result must be an Ensemble, but"),
        (
            plot.means_by_order,
            (many, "slip"),
            {},
            "quantity must be one of 'start', 'duration', 'position', 'slip_start', 'slip_duration'",
        ),
        (plot.means_by_order, (many,), {"level": 1.0}, "level must lie between 0 and 1"),
        (plot.convergence, (many,), {}, "result must be a Convergence or a HistogramConvergence, but"),
        (plot.convergence, (settled,), {"level": 90}, "level must lie between 0 and 1"),
        (plot.stick_raster, (statistics,), {}, "result must be an Ensemble, but"),
        (plot.stick_raster, (many,), {"samples": 0}, "samples must be a whole number of at least 1"),
        (
            plot.stick_raster,
            (many,),
            {"window": (0.0, 41.0)},
            r"window must be two times \(in s\) with 0 <= t_a < t_b <= 40, the end",
        ),
        (plot.stick_raster, (many,), {"window": (3.0, 3.0)}, "window must be two times"),
        (plot.stick_raster, (many,), {"window": ("now", 3.0)}, "window must be two times"),
        (curve, ([], []), {}, "parameter_values must hold one or more numbers"),
        (curve, ([1.0], 0.5), {}, "fractions must be a one-dimensional sequence"),
        (curve, ([1.0], [length]), {}, "fractions must hold stick fractions"),
        (curve, ([1.0, 2.0], [statistics.stick_fraction, ss.stick_fraction(many)]), {}, "fractions must hold"),
        (curve, ([1.0, 2.0], [ss.stick_fraction(many)]), {}, "fractions must have the length 2 of parameter_values"),
        (curve, ([1.0], [ss.stick_fraction(many)]), {"label": 1}, "label must be a string"),
        (plot.parameter_map, ([2, 1], [1, 2], square), MAP_LABELS, "x must hold two or more increasing numbers"),
        (plot.parameter_map, ([1, 2], [1], square), MAP_LABELS, "y must hold two or more increasing numbers"),
        (plot.parameter_map, ([1, 2], [1, 2, 3], square), MAP_LABELS, r"values must have the shape .* = \(2, 3\)"),
        (plot.parameter_map, ([1, 2], [1, 2], [1, 2]), MAP_LABELS, "values must be a 2-dimensional array"),
        (plot.parameter_map, ([1, 2], [1, 2], square * np.inf), MAP_LABELS, "values must be finite"),
        (plot.parameter_map, ([1, 2], [1, 2], square), MAP_LABELS | {"label": None}, "label must be a string"),
        (plot.parameter_map, ([1, 2], [1, 2], square), MAP_LABELS | {"contours": 1}, "contours must be True or False"),
    ]
    for draw, arguments, options, message in wrong:
        with pytest.raises(ValueError, match=f"Argument {message}"):
            draw(*arguments, **options)
    with pytest.raises(ValueError, match='keep="statistics"'):
        plot.stick_raster(totals)
