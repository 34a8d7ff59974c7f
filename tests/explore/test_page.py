"""The page of the explorer without a browser: what is computed when its controls move."""

import html
import re
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax.study import _explorer_page, read_config
from stickslip_jax.study._explorer_page import GIVEN, NumberControl, Worker
from stickslip_jax.study._explorer_scene import (
    Scene,
    ensemble_of,
    motion_of,
    numbers_of,
    realization,
    require_little,
    section_of,
    statistics_of,
)

T1, SAMPLES, Y0 = 20.0, 300, (0.0, 1.0)


def system(mu=0.8):
    return ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))


def shown(**options):
    given = {"t1": T1, "y0": Y0, "samples": SAMPLES} | options
    return ss.explore(given.pop("system", system()), given.pop("law", ss.PoissonSwitching(0.9, 1.0)), **given)


def control(explorer, name) -> NumberControl:
    """The control of a number."""
    found = [one for one in explorer.controls if one.number.name == name]
    assert len(found) == 1
    return found[0]


def slide(moved: NumberControl, value):
    """Move the slider, as its handle does."""
    moved._slider.value = value


def write(moved: NumberControl, text):
    """Write into the box, as the keyboard does."""
    moved._box.value = text


def choose(explorer, which, name):
    """Choose from the list of "System", "Friction" or "Base"."""
    explorer._lists[which].value = name


def said(pane):
    return html.unescape(re.sub("<[^>]*>", " ", pane.object))


@pytest.mark.slow
def test_numbers_are_those_of_the_package():
    explorer = shown()
    write(control(explorer, "system.friction.mu"), "0.65")
    slide(control(explorer, "law.rate"), 1.25)
    options = {"t1": T1, "samples": SAMPLES, "key": jax.random.key(0), "y0": Y0}
    new = system(0.65), ss.PoissonSwitching(0.9, 1.25)
    many = ss.simulate_ensemble(*new, **options, progress=False)
    for statistic in (ss.mean_stick_duration(many), ss.mean_stick_count(many), ss.stick_fraction(many)):
        row = f"{statistic.name} {statistic.without_name().replace('+-', '±')}"
        assert row in " ".join(said(explorer.statistics).split())
    slope = ss.sensitivity(ss.mean_stick_duration, *new, wrt="law.rate", **options)
    number = str(slope).replace("+-", "±").partition(": ")[2]
    assert f"Derivative of the mean stick duration (pooled) by rate: {number} s per 1/s." in said(explorer.slope)
    assert explorer.scene.law.rate == 1.25
    assert explorer.scene.system.friction.mu == 0.65


@pytest.mark.slow
def test_without_sticks():
    explorer = shown(system=system(0.0))
    assert "nan" not in said(explorer.statistics) + said(explorer.slope)
    assert "No derivative by friction coefficient: too few sticks." in said(explorer.slope)


@pytest.mark.slow
def test_unit_of_a_difference_quotient():
    explorer = shown(law=ss.Harmonic(ss.Uniform(0.5, 0.9), 1.5), samples=40)
    assert re.search(r"± [0-9.]+ s \(central differences of [0-9.]+\)", said(explorer.slope))


@pytest.mark.slow
def test_pictures_are_those_of_the_sticks():
    scene = Scene(system(), ss.PoissonSwitching(0.9, 1.0), Y0, T1, SAMPLES)
    motion, found, many = motion_of(scene), statistics_of(scene), ensemble_of(scene)
    sticks = many.finished_sticks()
    durations, numbers = found.bars["durations"], found.bars["numbers"]
    assert np.sum(durations["top"] * (durations["right"] - durations["left"])) == pytest.approx(1)
    assert durations["right"][-1] == sticks.duration.max()
    assert np.sum(numbers["top"]) == pytest.approx(1)
    centres = (numbers["right"] + numbers["left"]) / 2
    assert centres @ numbers["top"] == pytest.approx(np.mean(sticks.count))
    # The first realisation, at its own sticks.
    own = ss.simulate(*many.realization(0)[:2], t1=T1, y0=many.realization(0).y0)
    mask, one = np.asarray(own.sticks.mask), realization(scene)
    np.testing.assert_allclose(
        np.asarray(one.sticks.start)[np.asarray(one.sticks.mask)],
        np.asarray(own.sticks.start)[mask],
        rtol=0,
    )
    times = motion.curves["stick"]["t"]
    times = times[np.isfinite(times)]
    inside = [
        np.any((times >= a) & (times <= b))
        for a, b in zip(np.asarray(own.sticks.start)[mask], np.asarray(own.sticks.end)[mask], strict=True)
    ]
    assert all(inside)
    slip = motion.curves["slip"]
    drawn = np.isfinite(slip["t"])
    np.testing.assert_allclose(slip["x"][drawn], np.asarray(own.evaluate(slip["t"][drawn])[0]), atol=1e-12)
    base = motion.curves["base"]
    assert set(np.abs(base["y"][np.isfinite(base["y"])])) == {0.9}
    held = np.isfinite(motion.curves["stick"]["y"])
    assert set(np.abs(motion.curves["stick"]["y"][held])) == {0.9}
    assert (base["t"][0], base["t"][-1]) == (0.0, T1)


@pytest.mark.slow
def test_axes_hold_what_is_drawn():
    explorer = shown()
    for mu in ("0.3", "3"):
        write(control(explorer, "system.friction.mu"), mu)
        figures = explorer._figures
        for name in ("slip", "stick"):
            data = figures.curves[name].data
            for axis, values in (
                (figures.portrait.x_range, data["x"]), (figures.portrait.y_range, data["y"]),
                (figures.history.x_range, data["t"]), (figures.history.y_range, data["x"]),
            ):  # fmt: skip
                assert axis.start <= np.nanmin(values) <= np.nanmax(values) <= axis.end < axis.start + 2 * T1
        for name in ("durations", "starts", "numbers"):
            data, plot = figures.bars[name].data, figures.histograms[name]
            assert (plot.x_range.start, plot.x_range.end) == (data["left"][0], data["right"][-1])
            assert plot.y_range.start == 0 < data["top"].max() < plot.y_range.end <= 1.1 * data["top"].max()


@pytest.mark.slow
def test_base_with_random_numbers():
    """The realisation has those of the first sample."""
    scene = Scene(system(), ss.PoissonSwitching(ss.Uniform(0.5, 1.0), ss.Uniform(0.5, 2.0)), Y0, T1, 50, 0)
    sticks = ensemble_of(scene).finished_sticks()
    assert float(realization(scene).stick_time) == pytest.approx(sticks.duration[: sticks.count[0]].sum(), rel=1e-12)


@pytest.mark.slow
def test_derivative_and_diagram_are_both_shown():
    explorer = shown(law=ss.SquareWave(0.9, 3.0), samples=20)
    explorer._tabs.active = 1
    write(control(explorer, "system.friction.mu"), "0.65")
    assert "once a period" in explorer._section.plot.yaxis.axis_label
    assert "Computing" not in said(explorer.slope)


@pytest.mark.slow
def test_moving_numbers_compiles_nothing():
    """Within the ranges of the sliders, of numbers that were moved before."""
    explorer = shown()
    moves = [("system.friction.mu", 0.5, 1.1), ("law.rate", 0.6, 1.6), ("law.speed", 0.5, 1.4), ("y0[1]", 0.2, -0.4)]
    for name, first, _ in moves:
        slide(control(explorer, name), first)
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if "backend_compile" in event else None
    )
    try:
        for name, _, second in moves:
            slide(control(explorer, name), second)
    finally:
        jax.monitoring.clear_event_listeners()
    assert compiled == []


@pytest.mark.slow
@pytest.mark.parametrize("text", ["", "fast", "1;2", "nan", "-1", "0"])
def test_bad_input_says_why_and_moves_nothing(text):
    explorer = shown()
    before = explorer.scene, said(explorer.statistics)
    one = control(explorer, "system.mass")
    write(one, text)
    assert (explorer.scene, said(explorer.statistics)) == before
    assert one.problem.startswith(("Mass must be positive (in kg), but", f"{text!r} is not a number"))
    write(one, "1.5")
    assert one.problem == ""
    assert explorer.scene.system.mass == 1.5


@pytest.mark.slow
def test_number_beyond_the_slider():
    explorer = shown()
    write(control(explorer, "law.speed"), "12.5")
    assert control(explorer, "law.speed").number.high == 12.5
    assert explorer.scene.law.speed == 12.5


@pytest.mark.slow
def test_other_system_friction_and_base():
    explorer = shown(samples=20)
    choose(explorer, "System", "two blocks")
    assert "friction coefficient, contact 1" in [one.number.label for one in explorer.controls]
    assert explorer.scene.samples == 20
    choose(explorer, "System", GIVEN)
    assert explorer.scene.system.friction.mu == 0.8
    choose(explorer, "Friction", "Stribeck")
    assert isinstance(explorer.scene.system.friction, ss.Stribeck)
    choose(explorer, "Base", "SquareWave")
    assert isinstance(explorer.scene.law, ss.SquareWave)
    assert explorer.tabs == ["Motion and statistics", "Bifurcation"]
    choose(explorer, "Base", GIVEN)
    assert explorer.tabs == ["Motion and statistics"]


@pytest.mark.slow
def test_study_file_and_figures():
    explorer = shown(samples=20)
    write(control(explorer, "law.speed"), "0.75")
    config = explorer.study_file().getvalue().decode()
    assert "speed = 0.75" in config
    assert "samples = 20" in config
    assert explorer.figures_file().getvalue().startswith(b"%PDF")


@pytest.mark.slow
def test_study_file_is_read_again(tmp_path):
    explorer = shown(samples=20)
    (tmp_path / "study.toml").write_bytes(explorer.study_file().getvalue())
    for path in (tmp_path / "study.toml", str(tmp_path / "study.toml")):
        assert read_config(path).system.build().friction.mu == 0.8


@pytest.mark.slow
def test_no_sticks_at_all():
    explorer = shown(system=system(mu=0.0), samples=20)
    assert "mean number of sticks 0" in " ".join(said(explorer.statistics).split())
    assert explorer.figures_file().getvalue().startswith(b"%PDF")


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"samples": 1}, r"\AArgument samples must be"),
        ({"samples": 10**7}, r"\AArgument samples must be"),
        ({"t1": -1.0}, r"\AArgument t1 must be positive"),
        ({"seed": -1}, r"\AArgument seed must be"),
        ({"system": 3}, r"\AArgument system must be a system such as MassSpring"),
        ({"y0": (0.0,)}, r"Argument y0 must"),
    ],
)
def test_bad_arguments(options, message):
    with pytest.raises(ValueError, match=message):
        shown(**options)


def test_scripts_of_a_notebook_are_not_loaded_from_the_net(monkeypatch):
    asked = []
    monkeypatch.setattr("panel.extension", lambda **options: asked.append(options))
    shown(samples=5)
    assert asked == [{"inline": True}]


class Own:
    """A random base of a user."""

    def sample(self, key, t1):
        return ss.Harmonic(jax.random.uniform(key, minval=0.5, maxval=1.0), 2.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [
        ss.RandomSteps(speed=0.9, interval=1.5),
        ss.RandomPhase(ss.Harmonic(0.9, ss.Uniform(1.5, 2.5))),
        ss.Harmonic(ss.Uniform(0.5, 0.9), 1.5),
        Own(),
    ],
    ids=["random steps", "random phase", "random amplitude", "own"],
)
def test_realization_is_the_first_of_the_ensemble(law):
    scene = Scene(system(), law, (ss.Uniform(-0.5, 0.5), 0.0), T1, 5, seed=4)
    many = ensemble_of(scene)
    assert float(realization(scene).stick_time) == pytest.approx(many.totals.stick_time[0], rel=1e-12)
    assert many.totals.stick_time[0] > 0


def test_steps_end_at_the_first_failure():
    done = []

    def failing():
        raise ValueError("no")

    worker = Worker(None, None, lambda *told: None)
    steps = [((int,), done.append), ((failing,), done.append), ((list,), done.append)]
    worker.do([((task, ()), then) for (task,), then in steps], lambda error: done.append(str(error)))
    assert done == [0, "no"]


@pytest.mark.slow_but_for("t1-2e8")
@pytest.mark.parametrize(("name", "value"), [("law.rate", "110001"), ("t1", "2e8")])
def test_what_takes_too_long_is_not_begun(name, value):
    """The page says what it would take; what is shown stays, and is marked as old until something else is shown."""
    explorer = shown(samples=2000)
    table = explorer.statistics.object
    write(control(explorer, name), value)
    told = said(explorer._alert)
    assert re.search(
        r"This was not begun: it would take about [0-9,]+ (s|minutes|hours|days) and up to [0-9.,]+ GB", told
    )
    assert explorer.statistics.object == table
    assert float(explorer._results.styles["opacity"]) < 0.5
    write(control(explorer, "law.rate"), "1.5")
    write(control(explorer, "t1"), "20")
    assert (explorer._results.styles["opacity"], explorer._alert.visible) == ("1", False)
    assert explorer.statistics.object != table


def test_estimate_follows_the_sizes():
    """Twice the realisations, or the duration, are twice the steps."""
    scene = Scene(system(), ss.SquareWave(0.9, 3.0), Y0, 300.0, 2000)
    steps, kind = require_little(scene)
    assert require_little(scene._replace(samples=4000)) == (2 * steps, kind)
    assert require_little(scene._replace(t1=600.0))[0] == pytest.approx(2 * steps, rel=0.05)


@pytest.mark.slow
def test_messages_are_in_the_words_of_the_page():
    """Of what the package says, the names of code are those of the controls, and advice about code is left out."""
    explorer = shown(system=ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.8, 1.0)))
    one = control(explorer, "system.friction.mu")
    write(one, "1.5")
    told = (
        "Static friction coefficient must be at least friction coefficient = 1.5, but 1.0 was given: a stick holds at "
    )
    assert one.problem == f"{told}least as well as a slip."
    special = shown(system=system(1.8))  # w = 1
    assert "w = speed / (a omega) is exactly 1, where the mean number of sticks" in said(special.slope)
    for word in ("relative_bandwidth", "docs/", "system.", "law."):
        assert word not in said(special.slope)


@pytest.mark.slow
def test_diagram_is_clipped_to_what_the_system_allows():
    scene = Scene(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.8, 1.0)), ss.SquareWave(0.9, 3.0), Y0, T1, 20)
    (number,) = (one for one in numbers_of(scene) if one.path[-1] == "mu")
    assert number.high > 1.0
    points, note = section_of(scene, number)
    assert points["value"].max() <= 1.0
    assert re.search(r"Only from [0-9.]+ to (1|0\.99\d+), which the other numbers of the system allow\.", note)


@pytest.mark.slow
def test_reset():
    explorer = shown(samples=20)
    before = explorer.scene
    write(control(explorer, "law.speed"), "0.75")
    choose(explorer, "Friction", "Stribeck")
    explorer._counts[0].value = 30
    explorer._begin_with(explorer._given, GIVEN)
    assert explorer.scene == before
    assert [one.value for one in explorer._lists.values()] == [GIVEN] * 3
    assert explorer._counts[0].value == 20


def test_moves_are_told_soon():
    """By an attribute of Panel's widgets, which it does not promise."""
    for control in shown(samples=5).controls:
        for part in (control._slider, control._box):
            assert (part._debounce, type(part).__base__._debounce) == (20, 50)


def test_a_process_that_is_ended_while_it_starts_is_killed(monkeypatch):
    """Ctrl-C right after the address is printed: the first page's process is just starting."""
    done = []

    class Starting:
        def __init__(self, **_):
            pass

        def start(self):
            one.end()
            done.append("started")

        def kill(self):
            done.append("killed")

    context = SimpleNamespace(Process=Starting, Pipe=lambda: (SimpleNamespace(), SimpleNamespace(close=lambda: None)))
    monkeypatch.setattr(_explorer_page, "_CONTEXT", context)
    one = _explorer_page._Process()
    with pytest.raises(EOFError):
        one.compute(b"", lambda _: None)
    assert done == ["started", "killed"]
