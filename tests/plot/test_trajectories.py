"""Figures: what is drawn is what was simulated, at the right instants, labelled with units."""

import importlib

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest

mpl.use("Agg")

import matplotlib.pyplot as plt
from support.plot import segments

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax.plot import _style

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
LAW = ss.PoissonSwitching(speed=1.0, rate=1.0)
T1 = 40.0

evaluate = jax.jit(ss.Simulation.evaluate)


@jax.jit
def simulate(base, t1, y0):
    return ss.simulate(SYSTEM, base, t1=t1, y0=y0)


@pytest.fixture(scope="module")
def one():
    """A realisation with sticks that end by release and by the base's switching."""
    base = LAW.sample(jax.random.key(3), T1)
    run = simulate(base, T1, (0.0, 1.0))
    assert set(np.asarray(run.sticks.ending)[np.asarray(run.sticks.mask)]) >= {0, 1}
    return run


@pytest.fixture(scope="module")
def ensemble():
    return ss.simulate_ensemble(
        SYSTEM, LAW, t1=T1, samples=300, key=jax.random.key(5), y0=(0.0, 1.0), keep="sticks", threads=1
    )


def line(ax, label):
    (found,) = [drawn for drawn in ax.lines if drawn.get_label() == label]
    return found


def filled(simulation, name):
    return np.asarray(getattr(simulation.sticks, name))[np.asarray(simulation.sticks.mask)]


@pytest.mark.slow
def test_history_draws_each_stick_where_it_happens(one):
    upper, lower = plot.time_history(one)
    for panel in (upper, lower):
        drawn = segments(line(panel, "mass, stick"))
        assert [piece[0, 0] for piece in drawn] == filled(one, "start").tolist()
        assert [piece[-1, 0] for piece in drawn] == filled(one, "end").tolist()
    # The instants are those recorded, to the last bit; the states there come from the closed forms, to round-off.
    drawn = segments(line(upper, "mass, stick"))
    assert [piece[0, 1] for piece in drawn] == pytest.approx(filled(one, "position"), abs=1e-12)


@pytest.mark.slow
def test_during_sticks_the_mass_has_the_velocity_of_the_base(one):
    _, lower = plot.time_history(one)
    for piece in segments(line(lower, "mass, stick")):
        base = float(one.base.velocity(piece[:, 0].mean()))
        assert piece[:, 1] == pytest.approx(base, abs=1e-12)


@pytest.mark.slow
def test_history_of_the_mass_is_the_trajectory(one):
    upper, lower = plot.time_history(one)
    times, position = line(upper, "mass").get_data()
    _, velocity = line(lower, "mass").get_data()
    assert times[0] == 0
    assert times[-1] == T1
    assert np.all(np.diff(times) >= 0)
    exact = evaluate(one, jnp.asarray(times))
    assert position == pytest.approx(np.asarray(exact[0]), abs=1e-12)
    assert velocity == pytest.approx(np.asarray(exact[1]), abs=1e-12)
    # Between events, points are at most two degrees of a slip arc apart: pi / 90 over omega.
    assert np.max(np.diff(times)[~np.isin(times[:-1], filled(one, "start"))]) <= np.pi / 180 + 1e-12


@pytest.mark.slow
def test_history_draws_the_jumps_of_the_base(one):
    _, lower = plot.time_history(one)
    times, velocity = line(lower, "base").get_data()
    upright = (np.diff(times) == 0) & (np.diff(velocity) != 0)
    switches = np.asarray(one.base.times)
    inside = switches[(switches > 0) & (switches < T1)]
    # The simulation and `times` add the same durations in different order.
    assert times[:-1][upright] == pytest.approx(inside, abs=1e-12)
    flat = np.asarray(one.base.velocity(jnp.asarray(times[::2] + times[1::2]) / 2))
    assert velocity.tolist() == np.repeat(flat, 2).tolist()


@pytest.mark.slow
def test_history_marks_the_band_where_sticks_are_possible(one):
    upper, _ = plot.time_history(one)
    (band,) = upper.patches
    assert band.get_y() == pytest.approx(-0.25)
    assert band.get_height() == pytest.approx(0.5)


def test_window_cuts_sticks_and_curve(one):
    start, end = filled(one, "start")[1], filled(one, "end")[1]
    window = (float(0.5 * (start + end)), float(end) + 1.0)
    upper, lower = plot.time_history(one, window=window)
    assert upper.get_xlim() == pytest.approx(window)
    times, _ = line(lower, "mass").get_data()
    assert (times[0], times[-1]) == window
    first = segments(line(upper, "mass, stick"))[0]
    assert first[:, 0].tolist() == [window[0], end]


@pytest.mark.slow
def test_a_window_on_an_event_but_for_round_off_draws_no_crumb(one):
    end = float(filled(one, "end")[1])
    window = (end - 1e-15 * end, end + 0.05)
    _, lower = plot.time_history(one, window=window)
    assert line(lower, "mass, stick").get_xdata().size == 0
    times, _ = line(lower, "base").get_data()
    assert np.all(np.diff(times)[::2] > 1e-6)


@pytest.mark.parametrize(("abscissa", "scale"), [("position", 1.0), ("position_times_omega", 2.0)])
def test_portrait_draws_sticks_at_the_base_velocity(one, abscissa, scale):
    ax = plot.phase_portrait(one, abscissa=abscissa)
    drawn = segments(line(ax, "stick"))
    assert len(drawn) == int(one.sticks.count)
    velocities = np.asarray(one.base.velocity(jnp.asarray(filled(one, "start") + 1e-9)))
    for piece, begins, lasts, velocity in zip(
        drawn, filled(one, "position"), filled(one, "duration"), velocities, strict=True
    ):
        assert piece[:, 1] == pytest.approx(velocity, abs=1e-12)
        assert piece[[0, -1], 0] == pytest.approx(scale * np.array([begins, begins + velocity * lasts]), abs=1e-12)
    assert line(ax, "stick").get_color() == _style.STICK


def test_portrait_slips_are_circles_about_the_centers(one):
    """Gray and black arcs keep their distance from the centre on their side (conference paper, eq. 3)."""
    ax = plot.phase_portrait(one, abscissa="position_times_omega")
    for label, sign in (("slip, base forward", 1), ("slip, base backward", -1)):
        for arc in segments(line(ax, label)):
            # Below the base velocity about +mu n / (m omega), above it about the other; states on it lie on both.
            for side in (1, -1):
                radius = np.hypot(arc[:, 0] - 0.5 * sign * side, arc[:, 1])
                belongs = side * (1 - sign * arc[:, 1]) >= 0
                pairs = belongs[:-1] & belongs[1:]
                assert np.abs(np.diff(radius))[pairs] == pytest.approx(0, abs=1e-12)


def test_portrait_crosses_mark_the_centers(one):
    ax = plot.phase_portrait(one)
    crosses = line(ax, r"centres, $x = \pm \mu n/k$")
    assert crosses.get_xdata().tolist() == [-0.25, 0.25]
    assert crosses.get_ydata().tolist() == [0, 0]
    assert crosses.get_marker() == "x"


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1, -1])
def test_portrait_marks_the_only_equilibrium_of_a_belt_that_runs_one_way(sign):
    """Conference paper, section 2: (n mu / (m omega), 0) if the belt runs forward, else minus that."""
    one = simulate(ss.Constant(float(sign)), 10.0, (0.3, 1.5))
    crosses = line(plot.phase_portrait(one), r"centre, $x = \mu n/k\,\mathrm{sgn}\,v$")
    assert crosses.get_xdata().tolist() == [0.25 * sign]


@pytest.mark.slow
def test_portrait_pieces_last_the_whole_window(one):
    ax = plot.phase_portrait(one, window=(5.0, 15.0))
    exact = np.column_stack([np.asarray(values) for values in evaluate(one, jnp.asarray([5.0, 15.0]))])
    ends = np.concatenate([piece for drawn in ax.lines for piece in segments(drawn)])
    for state in exact:
        assert np.min(np.linalg.norm(ends - state, axis=1)) < 1e-12


@pytest.mark.slow
def test_portrait_on_a_base_at_rest():
    """The base moves forward, rests, moves backward, rests; the mass sticks on each rest."""
    base = ss.VelocitySteps(jnp.array([3.0, 3.0, 2.0, 2.0]), jnp.array([1.0, 0.0, -1.0, 0.0]))
    ax = plot.phase_portrait(simulate(base, 10.0, (0.3, 1.5)))
    assert line(ax, "slip, base at rest").get_color() == _style.AT_REST
    points = [piece for piece in segments(line(ax, "stick")) if np.all(np.abs(piece[:, 1]) < 1e-12)]
    assert len(points) == 2
    assert line(ax, "stick").get_marker() == "o"  # a line of no length would not be seen


def histogram(ax):
    density, edges, _ = ax.patches[-1].get_data()
    return density, edges


def test_durations_count_every_complete_stick_once(ensemble):
    ax = plot.histogram(ensemble, bins=20)
    density, edges = histogram(ax)
    flat = ensemble.numbered_sticks()
    complete = flat.ending != ss.Ending.HORIZON
    assert 0 < np.sum(~complete) < np.sum(complete)
    counts, _ = np.histogram((flat.end - flat.start)[complete], edges)
    assert counts.sum() == complete.sum()
    assert density * np.diff(edges) * complete.sum() == pytest.approx(counts)
    assert len(density) == 20
    (text,) = ax.get_legend().get_texts()
    assert text.get_text() == (f"{complete.sum():,} sticks ({np.sum(~complete):,} more, cut by the end, left out)")


def test_durations_with_given_edges_stay_a_density(ensemble):
    edges = [0.1, 0.2, 0.3]
    ax = plot.histogram(ensemble, bins=edges)
    density, drawn = histogram(ax)
    flat = ensemble.numbered_sticks()
    durations = (flat.end - flat.start)[flat.ending != ss.Ending.HORIZON]
    inside = np.mean((durations >= 0.1) & (durations <= 0.3))
    assert drawn.tolist() == edges
    assert np.sum(density * np.diff(edges)) == pytest.approx(inside)
    assert (
        f"{np.sum((durations < 0.1) | (durations > 0.3)):,} of them outside"
        in ax.get_legend().get_texts()[0].get_text()
    )


def test_durations_of_one_simulation_and_of_a_batch(one):
    ax = plot.histogram(one)
    number = int(np.sum(filled(one, "ending") != ss.Ending.HORIZON))
    assert ax.get_legend().get_texts()[0].get_text().startswith(f"{number} sticks")
    batch = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 3), one)
    ax = plot.histogram(batch)
    assert ax.get_legend().get_texts()[0].get_text().startswith(f"{3 * number} sticks")


def test_samples_that_did_not_finish_are_left_out(one):
    broken = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 2), one)
    object.__setattr__(broken, "status", jnp.asarray([0, 1], jnp.int8))
    number = int(np.sum(filled(one, "ending") != ss.Ending.HORIZON))
    ax = plot.histogram(broken)
    assert ax.get_legend().get_texts()[0].get_text().startswith(f"{number} sticks")


@pytest.mark.slow
def test_no_sticks_is_a_labeled_empty_figure():
    slipping = simulate(ss.Constant(5.0).sample(None, 3.0), 3.0, (0.0, 0.0))
    ax = plot.histogram(slipping)
    assert [text.get_text() for text in ax.texts] == ["no sticks"]
    assert ax.get_xlabel() == "stick duration (s)"
    assert not ax.patches


def test_only_a_censored_stick_is_noted():
    sticking = simulate(ss.Constant(0.01).sample(None, 3.0), 3.0, (0.0, 0.01))
    ax = plot.histogram(sticking)
    assert [text.get_text() for text in ax.texts] == ["no sticks (1 more, cut by the end, left out)"]


@pytest.mark.slow
def test_durations_need_kept_sticks():
    few = ss.simulate_ensemble(SYSTEM, LAW, t1=2.0, samples=2, key=jax.random.key(0), threads=1, keep="totals")
    with pytest.raises(ValueError, match='keep="sticks"'):
        plot.histogram(few)


def test_fractions_are_drawn_in_percent_in_order_of_the_ratio():
    ax = plot.stick_fraction_curve([1.2, 0.8, 1.0], [0.36, 0.1, 0.16], label="steady")
    assert line(ax, "steady").get_xdata().tolist() == [0.8, 1.0, 1.2]
    assert line(ax, "steady").get_ydata() == pytest.approx([10, 16, 36])


def test_fractions_have_bands_and_are_compared():
    ax = plot.stick_fraction_curve([1.0, 2.0], [0.1, 0.2], label="a")
    errors = [[0.02, 0.01], [0.03, 0.04]]
    same = plot.stick_fraction_curve([2.0, 1.0], [0.3, 0.2], errors=errors, label="b", band_label="90 %", ax=ax)
    assert same is ax
    (band,) = ax.collections
    corners = {tuple(np.round(corner, 9)) for corner in band.get_paths()[0].vertices}
    assert corners == {(1.0, 19.0), (1.0, 24.0), (2.0, 28.0), (2.0, 33.0)}
    assert {text.get_text() for text in ax.get_legend().get_texts()} == {"a", "b", "90 %"}
    assert len({drawn.get_color() for drawn in ax.lines} | {_style.STICK}) == 3


def draw_all(one, ensemble):
    return [
        *plot.time_history(one),
        plot.phase_portrait(one),
        plot.histogram(ensemble),
        plot.stick_fraction_curve([1.0, 1.2], [0.1, 0.2], label="share"),
    ]


def test_axes_name_quantity_and_unit(one, ensemble):
    labels = [(ax.get_xlabel(), ax.get_ylabel()) for ax in draw_all(one, ensemble)]
    assert labels == [
        ("", "position $x$ (m)"),  # above the next, with which it shares its times
        ("time $t$ (s)", "velocity (m/s)"),
        ("position $x$ (m)", r"velocity $\dot x$ (m/s)"),
        ("stick duration (s)", "probability density (1/s)"),
        (r"frequency ratio $r = f_\mathrm{b}\,/\,(\omega/2\pi)$ (dimensionless)", "stick fraction $T_s$ (%)"),
    ]
    scaled = plot.phase_portrait(one, abscissa="position_times_omega")
    assert scaled.get_xlabel() == r"position times frequency $\omega x$ (m/s)"
    assert scaled.get_aspect() == 1.0  # circles look round


def test_legends_hide_no_data(one, ensemble):
    """Each legend lies wholly above its axes and inside the figure."""
    upper, lower, *others = draw_all(one, ensemble)
    assert lower.get_legend() is None
    for ax in (upper, *others):
        ax.figure.draw_without_rendering()
        legend, axes, figure = ax.get_legend().get_window_extent(), ax.get_window_extent(), ax.figure.bbox
        assert legend.y0 >= axes.y1
        assert figure.x0 - 1 <= legend.x0 < legend.x1 <= figure.x1 + 1
        assert legend.y1 <= figure.y1 + 1


def test_drawing_changes_no_result(one, ensemble):
    before = [np.array(leaf) for leaf in jax.tree.leaves((one, ensemble.flat_sticks, ensemble.totals))]
    draw_all(one, ensemble)
    after = jax.tree.leaves((one, ensemble.flat_sticks, ensemble.totals))
    for old, new in zip(before, after, strict=True):
        np.testing.assert_array_equal(old, new)


def test_drawing_simulates_nothing(one, ensemble, monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("a figure called the simulator")

    for name in ("_dynamics.simulate", "_ensemble.setup"):
        module = importlib.import_module(f"stickslip_jax.{name}")
        monkeypatch.setattr(module, "working_dtype", refuse)  # both simulators ask for it first
    draw_all(one, ensemble)


def test_given_axes_are_used_and_no_other_figure_is_made(one, ensemble):
    axes = mpl.figure.Figure().subplots(1, 5)
    assert plot.time_history(one, axes=axes[:2]) == tuple(axes[:2])
    assert [panel.get_xlabel() for panel in axes[:2]] == ["time $t$ (s)"] * 2
    assert plot.phase_portrait(one, ax=axes[2]) is axes[2]
    assert plot.histogram(ensemble, ax=axes[3]) is axes[3]
    assert plot.stick_fraction_curve([1.0], [0.1], errors=[0.1], ax=axes[4]) is axes[4]
    assert plt.get_fignums() == []


@pytest.mark.parametrize("window", [(5.0, 3.0), (-1.0, 3.0), (0.0, T1 + 1), (1.0, 1.0), 3.0, (1.0, np.nan), ("a", "b")])
@pytest.mark.parametrize("draw", [plot.time_history, plot.phase_portrait])
def test_bad_windows(one, draw, window, annotations_unchecked):
    with pytest.raises(ValueError, match=r"Argument window must be two times .* 0 <= t_a < t_b <= 40, the end of the"):
        draw(one, window=window)


def stopped_at(time, one):
    """What `simulate` returns where the base has no more intervals."""
    stopped = jax.tree.map(lambda leaf: leaf, one)
    object.__setattr__(stopped, "status", jnp.asarray(1, jnp.int8))
    object.__setattr__(stopped, "time_reached", jnp.asarray(time))
    return stopped


@pytest.mark.slow
@pytest.mark.parametrize("draw", [plot.time_history, plot.phase_portrait, plot.friction_force])
def test_an_unfinished_motion_is_drawn_as_far_as_it_came(one, draw):
    axes = draw(stopped_at(12.5, one))
    ax = axes[0] if isinstance(axes, tuple) else axes
    assert [text.get_text() for text in ax.texts] == [f"NOT FINISHED: stopped at 12.5 of {T1:g} s"]
    if draw is not plot.phase_portrait:
        assert ax.get_xlim() == (0.0, 12.5)
    axes = draw(one)
    assert not (axes[0] if isinstance(axes, tuple) else axes).texts


@pytest.mark.parametrize("draw", [plot.time_history, plot.phase_portrait])
def test_bad_simulations(one, ensemble, draw, annotations_unchecked):
    with pytest.raises(ValueError, match="Argument result must be a result of simulate, but"):
        draw(ensemble)
    batch = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 3), one)
    with pytest.raises(ValueError, match=r"must hold one trajectory, but a batch of shape \(3,\)"):
        draw(batch)
    unfinished = stopped_at(0.0, one)
    with pytest.raises(ValueError, match=r"must hold a motion to draw, but .* too few intervals"):
        draw(unfinished)
    with pytest.raises(ValueError, match="traced"):
        jax.jit(lambda run: draw(run) and 0.0)(one)


def test_bad_axes_and_options(one, ensemble, annotations_unchecked):
    with pytest.raises(ValueError, match="Argument axes must hold two matplotlib Axes"):
        plot.time_history(one, axes=plt.figure().subplots())
    with pytest.raises(ValueError, match="Argument ax must be a matplotlib Axes, but 'here'"):
        plot.phase_portrait(one, ax="here")
    with pytest.raises(ValueError, match="Argument abscissa must be 'position' or"):
        plot.phase_portrait(one, abscissa="x")
    with pytest.raises(ValueError, match="Argument result must be a result of simulate_ensemble or of simulate"):
        plot.histogram([0.1, 0.2])
    for bins in (0, 2.5, True, "auto", [0.1], [0.2, 0.1], [0.0, np.inf], [[0.0, 1.0]]):
        with pytest.raises(ValueError, match="Argument bins must be"):
            plot.histogram(ensemble, bins=bins)


@pytest.mark.parametrize(
    ("values", "errors", "message"),
    [
        (([], []), None, "parameter_values must hold one or more numbers"),
        (([1.0, -1.0], [0.1, 0.2]), None, "parameter_values must hold positive frequency ratios"),
        (([1.0, 2.0], [0.1]), None, "fractions must have the length 2 of parameter_values"),
        (([1.0], [38.0]), None, "fractions must hold fractions between 0 and 1"),
        (([1.0], [np.nan]), None, "fractions must be finite"),
        (([1.0], 0.5), None, "fractions must be a one-dimensional sequence"),
        (([1.0], [0.5]), [-0.1], "errors must hold numbers of zero or more"),
        (([1.0, 2.0], [0.5, 0.5]), [0.1], r"errors must hold .* in the shape \(2,\) or \(2, 2\)"),
    ],
)
def test_bad_fractions(values, errors, message, annotations_unchecked):
    with pytest.raises(ValueError, match=f"Argument {message}"):
        plot.stick_fraction_curve(*values, errors=errors)
