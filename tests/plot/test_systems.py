"""Figures of every system and base motion: what is drawn is the trajectory, its base, and where it can stick."""

import importlib
import itertools

import equinox as eqx
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
from stickslip_jax.plot import _style, _trajectory

COULOMB = ss.Coulomb(mu=1.0)
FORCE = ss.Harmonic(0.5, 1.3, 0.2)
RECORD = ss.Recorded(jnp.arange(0.0, 9.0, 0.5), jnp.asarray(np.random.default_rng(0).normal(size=18) * 0.5))
GROUND = ss.GroundAcceleration(jnp.arange(0.0, 9.0, 0.25), jnp.asarray(np.random.default_rng(1).normal(size=36)))
T1 = 8.0
MOST_TIMES = 8192
FULL_CIRCLE = 2 * np.pi


class Chirp(eqx.Module):
    """A base motion of a user's."""

    speed: float
    shortest_period = 0.7

    def velocity(self, t):
        return self.speed * jnp.sin(t + 0.2 * t * t)

    def acceleration(self, t):
        return self.speed * jnp.cos(t + 0.2 * t * t) * (1 + 0.4 * t)


def simulate(name):
    damped = ss.MassSpring(1.0, 4.0, 1.0, COULOMB, damping=0.2, force=FORCE)
    plain = ss.MassSpring(1.0, 4.0, 1.0, COULOMB)
    jumping = ss.WithJumps(Chirp(0.5), ss.PoissonSwitching(0.6, 0.5)).sample(jax.random.key(1), T1)
    cases = {
        "harmonic": (damped, ss.Harmonic(0.8, 1.7, 0.3), (0.0, 0.1)),
        "recorded": (ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu=0.8, mu_static=1.0)), RECORD, (0.0, 0.1)),
        "jumps": (plain, jumping, (0.0, 0.1)),
        "weakening": (ss.MassSpring(1.0, 4.0, 1.0, ss.VelocityWeakening(1.0, 2.0)), ss.Constant(0.3), (0.0, 0.1)),
        "ground": (ss.MassSpring(1.0, 40.0, 1.0, ss.Coulomb(0.5)), GROUND, (0.0, 0.0)),
        "motor": (ss.MotorCart(mu=0.3), ss.SourceVoltage(phase=1.0), (1.13, 0.0, 0.0)),
    }
    system, base, y0 = cases[name]
    return ss.simulate(system, base, t1=1.5 if name == "motor" else T1, y0=y0)


MASSES = ("harmonic", "recorded", "jumps", "weakening", "ground")
runs = {}


@pytest.fixture
def one(request):
    """The run of the name given, made once."""
    if request.param not in runs:
        runs[request.param] = simulate(request.param)
    return runs[request.param]


def of(*names):
    """Cases of the runs with these names, of which one is quick."""
    quick = ("jumps",)
    return [pytest.param(name, marks=() if name in quick else pytest.mark.slow) for name in names]


def line(ax, label):
    (found,) = [drawn for drawn in ax.lines if drawn.get_label() == label]
    return found


def filled(simulation, name):
    return np.asarray(getattr(simulation.sticks, name))[np.asarray(simulation.sticks.mask)]


def names_of(simulation):
    return "motor" if isinstance(simulation.system, ss.MotorCart) else "mass"


base_velocity = jax.jit(ss.Simulation.base_velocity)


def history(simulation, **options):
    """The axes of the state, without those of the excitation."""
    return plot.time_history(simulation, **options)[: len(simulation.system.coordinates)]


def exact(simulation, times):
    """State and base velocity at `times`; always as many times, so that few sizes are compiled."""
    padded = np.concatenate([times, np.zeros(MOST_TIMES - len(times))])
    values = simulation.evaluate(padded), base_velocity(simulation, padded)
    return jax.tree.map(lambda values: np.asarray(values)[: len(times)], values)


def needed_position(name, times):
    """Where the mass would sit without friction if it moved with the base, written out for each case, m."""
    if name == "harmonic":
        velocity, rate = 0.8 * np.cos(1.7 * times + 0.3), -0.8 * 1.7 * np.sin(1.7 * times + 0.3)
        return (0.5 * np.cos(1.3 * times + 0.2) - rate - 0.2 * velocity) / 4
    if name == "recorded":
        slopes = np.diff(RECORD.values) / 0.5
        return -slopes[np.floor(times / 0.5).astype(int)] / 4
    if name == "jumps":
        return -0.5 * np.cos(times + 0.2 * times**2) * (1 + 0.4 * times) / 4
    assert name == "ground"
    return -np.interp(times, GROUND.times, GROUND.accelerations) / 40


@pytest.mark.parametrize("one", of(*MASSES, "motor"), indirect=True)
def test_history_is_the_trajectory(one):
    panels = history(one)
    states, _ = exact(one, line(panels[0], names_of(one)).get_xdata())
    for panel, state in zip(panels, states, strict=True):
        times, values = line(panel, names_of(one)).get_data()
        assert (times[0], times[-1]) == (0, float(one.t1))
        assert np.all(np.diff(times) >= 0)
        assert values == pytest.approx(state, abs=1e-12)
        # Every time step is drawn with five points between its ends, but for sticks that are straight lines.
        steps = np.unique([*np.asarray(one.step_starts), *filled(one, "start"), *filled(one, "end")])
        middles = (steps[:-1] + steps[1:]) / 2
        straight = np.any([(a < middles) & (middles < b) for a, b in zip(*ends_of(one), strict=True)], axis=0)
        bent = ~straight if isinstance(one.base, ss.VelocitySteps) else slice(None)
        assert np.all(np.histogram(times, steps)[0][bent] >= 6)


def ends_of(simulation):
    return filled(simulation, "start"), filled(simulation, "end")


@pytest.mark.parametrize("one", of(*MASSES, "motor"), indirect=True)
def test_each_stick_is_drawn_where_it_happens(one):
    assert int(one.sticks.count) >= 2
    for number, panel in enumerate(history(one)):
        drawn = line(panel, f"{names_of(one)}, stick")
        assert drawn.get_color() == _style.STICK
        pieces = segments(drawn)
        assert [piece[0, 0] for piece in pieces] == filled(one, "start").tolist()
        assert [piece[-1, 0] for piece in pieces] == filled(one, "end").tolist()
        for piece, position in zip(pieces, filled(one, "position"), strict=True):
            assert piece[:, 1] == pytest.approx(exact(one, piece[:, 0])[0][number], abs=1e-12)
            if number == 0:
                assert piece[0, 1] == pytest.approx(position, abs=1e-12)


@pytest.mark.parametrize("one", of(*MASSES), indirect=True)
def test_velocities_in_sticks_are_those_of_the_base(one):
    _, lower = history(one)
    for piece in segments(line(lower, "mass, stick")):
        inside = piece[1:-1]
        assert inside[:, 1] == pytest.approx(exact(one, inside[:, 0])[1], abs=1e-9)


@pytest.mark.parametrize("one", of(*MASSES), indirect=True)
def test_base_line_is_the_base_velocity(one):
    _, lower = history(one)
    label = "ground" if isinstance(one.base, ss.GroundAcceleration) else "base"
    times, velocity = line(lower, label).get_data()
    once = ~np.isin(times, times[:-1][np.diff(times) == 0])
    once[-1] = False
    assert velocity[once] == pytest.approx(exact(one, times[once])[1], abs=1e-12)
    if isinstance(one.base, ss.WithJumps):
        upright = (np.diff(times) == 0) & (np.abs(np.diff(velocity)) > 1e-9)
        switches = np.asarray(one.base.jumps.times)
        assert times[:-1][upright] == pytest.approx(switches[(switches > 0) & (switches < T1)], abs=1e-12)
        assert np.abs(np.diff(velocity))[upright] == pytest.approx(1.2, abs=1e-9)
    if isinstance(one.base, ss.GroundAcceleration):
        assert np.all(velocity == 0)


@pytest.mark.parametrize("one", of(*(name for name in MASSES if name != "weakening")), indirect=True)
def test_band_holds_where_the_mass_can_stick(one, request):
    name = request.node.callspec.id
    upper, _ = history(one)
    assert not upper.patches
    (band,) = upper.collections
    assert band.get_label() == "stick possible"
    (path,) = band.get_paths()
    times = np.random.default_rng(3).uniform(0, T1, 300)
    half_width = 1 / 4 if name != "ground" else 0.5 / 40
    for share, inside in ((0.99, True), (1.01, False)):
        for side in (-1, 1):
            points = np.column_stack([times, needed_position(name, times) + side * share * half_width])
            assert np.all(path.contains_points(points) == inside)
    # All of the trajectory is in view, and so is each stick, inside the band.
    low, high = upper.get_ylim()
    times, position = line(upper, "mass").get_data()
    assert low < position.min()
    assert high > position.max()
    for piece in segments(line(upper, "mass, stick")):
        between = (piece[1:] + piece[:-1]) / 2  # the edges are drawn there as straight as the position
        assert np.all(path.contains_points(between[1:-1]))


@pytest.mark.parametrize("one", of("weakening"), indirect=True)
def test_band_of_a_steady_base_stays(one):
    upper, _ = history(one)
    (band,) = upper.patches
    assert (band.get_y(), band.get_height()) == pytest.approx((-0.25, 0.5))
    assert band.get_label() == r"stick possible, $|x| \leq \mu_\mathrm{s} n/k$"
    assert not upper.collections


@pytest.mark.slow
@pytest.mark.parametrize("one", of("motor"), indirect=True)
def test_band_of_a_motor_holds_the_currents_of_its_sticks(one):
    *_, panel = history(one)
    (path,) = panel.collections[0].get_paths()
    times = np.random.default_rng(3).uniform(0, float(one.t1), 200)
    (angle, _, _), _ = exact(one, times)
    most = 0.3 * 5 * 9.81 * 0.01 * np.abs(np.sin(angle)) / 5.33e-2
    for share, inside in ((-0.99, True), (0.99, True), (-1.01, False), (1.01, False)):
        assert np.all(path.contains_points(np.column_stack([times, share * most])) == inside)
    for piece in segments(line(panel, "motor, stick")):
        assert np.all(path.contains_points(piece[1:-1]))


@pytest.mark.parametrize("one", of("jumps"), indirect=True)
def test_window_on_a_jump_shows_one_side_of_it(one):
    jump = next(float(time) for time in np.asarray(one.base.jumps.times) if time > 0.5)
    for window in ((jump * (1 - 1e-15), jump + 0.3), (jump - 0.3, jump * (1 + 1e-15))):
        _, lower = history(one, window=window)
        _, velocity = line(lower, "base").get_data()
        assert np.max(np.abs(np.diff(velocity))) < 0.2
        assert lower.get_xlim() == window


@pytest.mark.slow
@pytest.mark.parametrize("one", of("harmonic", "motor"), indirect=True)
def test_long_runs_are_drawn_with_fewer_points(one, monkeypatch):
    monkeypatch.setattr(_trajectory, "_MOST_POINTS", 50)
    for panel in history(one):
        times, _ = line(panel, names_of(one)).get_data()
        assert len(times) <= 3 * 50
        pieces = segments(line(panel, f"{names_of(one)}, stick"))
        assert [piece[0, 0] for piece in pieces] == filled(one, "start").tolist()
        assert [piece[-1, 0] for piece in pieces] == filled(one, "end").tolist()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("one", "labels"),
    [
        ("harmonic", {"slip", "stick"}),
        ("recorded", {"slip", "stick", r"centres, $x = \pm \mu n/k$"}),
        ("weakening", {"slip, base forward", "stick"}),
        ("ground", {"slip", "stick"}),
        ("motor", {"slip", "stick"}),
    ],
    indirect=["one"],
)
def test_portrait_distinguishes_what_differs(one, labels):
    ax = plot.phase_portrait(one)
    assert {text.get_text() for text in ax.get_legend().get_texts()} == labels


@pytest.mark.parametrize("one", of(*MASSES), indirect=True)
def test_portrait_is_the_trajectory(one):
    ax = plot.phase_portrait(one)
    sticks = segments(line(ax, "stick"))
    assert len(sticks) == int(one.sticks.count)
    for piece, *ends in zip(sticks, *ends_of(one), strict=True):
        assert piece[[0, -1]] == pytest.approx(np.column_stack(exact(one, ends)[0]), abs=1e-9)
    points = np.concatenate([piece for drawn in ax.lines if drawn.get_marker() != "x" for piece in segments(drawn)])
    states = np.column_stack(exact(one, np.unique(np.asarray(one.step_starts)))[0])
    nearest = np.min(np.linalg.norm(points[None] - states[:, None], axis=2), axis=1)
    assert np.all(nearest < 1e-12)


@pytest.mark.parametrize("one", of("recorded", "motor"), indirect=True)
def test_portrait_centers_and_abscissae(one, annotations_unchecked):
    if isinstance(one.system, ss.MotorCart):
        with pytest.raises(ValueError, match="Argument abscissa must be 'position' for a MotorCart, but"):
            plot.phase_portrait(one, abscissa="position_times_omega")
        return
    ax = plot.phase_portrait(one, abscissa="position_times_omega")
    # Of the friction of slips, which is smaller here.
    assert line(ax, r"centres, $x = \pm \mu n/k$").get_xdata() == pytest.approx([-0.4, 0.4])
    assert ax.get_xlabel() == r"position times frequency $\omega x$ (m/s)"


@pytest.mark.parametrize("one", of("motor"), indirect=True)
def test_portrait_of_a_motor_breaks_where_a_revolution_ends(one):
    (angle, speed, _), _ = exact(one, np.unique(np.asarray(one.step_starts)))
    assert angle[-1] > FULL_CIRCLE
    ax = plot.phase_portrait(one)
    pieces = segments(line(ax, "slip"))
    ends = [(before[-1], after[0]) for before, after in itertools.pairwise(pieces) if before[-1, 0] == FULL_CIRCLE]
    assert len(ends) == angle[-1] // FULL_CIRCLE
    for before, after in ends:
        assert after[0] == 0
        assert before[1] == after[1]
    points = np.concatenate([*pieces, *segments(line(ax, "stick"))])
    assert np.all((points[:, 0] >= 0) & (points[:, 0] <= FULL_CIRCLE))
    states = np.column_stack([np.mod(angle, FULL_CIRCLE), speed])
    assert np.max(np.min(np.linalg.norm(points[None] - states[:, None], axis=2), axis=1)) < 1e-9
    assert ax.get_xlim() == (0, FULL_CIRCLE)


@pytest.mark.parametrize("one", of("motor"), indirect=True)
def test_portrait_marks_the_sticks_of_a_motor(one):
    drawn = line(plot.phase_portrait(one), "stick")
    assert drawn.get_xdata() == pytest.approx(np.mod(filled(one, "position"), FULL_CIRCLE))
    assert np.all(drawn.get_ydata() == 0)
    assert (drawn.get_marker(), drawn.get_linestyle(), drawn.get_color()) == ("o", "None", _style.STICK)


@pytest.mark.parametrize("one", of("motor", "ground"), indirect=True)
def test_axes_name_quantity_and_unit_and_legends_hide_nothing(one):
    panels, portrait = plot.time_history(one), plot.phase_portrait(one)
    motor = names_of(one) == "motor"
    last = {
        True: ["angle $\\alpha$ (rad)", "angular velocity\n$\\dot\\alpha$ (rad/s)", "current $c$ (A)", "voltage (V)"],
        False: [
            "position $x$ (m)\nrelative to ground",
            "velocity (m/s)\nrelative to ground",
            "ground\nacceleration (m/s$^2$)",
        ],
    }
    assert [panel.get_ylabel() for panel in panels] == last[motor]
    assert [panel.get_xlabel() for panel in panels] == [""] * (len(panels) - 1) + ["time $t$ (s)"]
    assert portrait.get_xlabel() == (
        r"angle $\alpha$ modulo $2\pi$ (rad)" if motor else "position $x$ relative to ground (m)"
    )
    for ax in (panels[0], portrait):
        ax.figure.draw_without_rendering()
        legend, axes, figure = ax.get_legend().get_window_extent(), ax.get_window_extent(), ax.figure.bbox
        assert axes.y1 <= legend.y0 < legend.y1 <= figure.y1 + 1
        assert figure.x0 - 1 <= legend.x0 < legend.x1 <= figure.x1 + 1


@pytest.mark.parametrize("one", of("motor"), indirect=True)
def test_drawing_simulates_nothing(one, monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("a figure called the simulator")

    monkeypatch.setattr(importlib.import_module("stickslip_jax._dynamics.simulate"), "working_dtype", refuse)
    plot.time_history(one)
    plot.phase_portrait(one)


@pytest.mark.parametrize("one", of("motor"), indirect=True)
def test_a_motor_needs_three_axes(one):
    with pytest.raises(
        ValueError, match=r"Argument axes must hold three matplotlib Axes \(angle, angular velocity, cur"
    ):
        plot.time_history(one, axes=plt.figure().subplots(2))


class TwoMasses(ss.SwitchedSystem):
    """Two masses in a row on springs of 1 N/m, the second of which rubs on the base."""

    mass: float = 1.0  # kg, of each

    @property
    def state_names(self):
        return "position 1 in m", "velocity 1 in m/s", "position 2 in m", "velocity 2 in m/s"

    def rates(self, t, y, base, friction):
        pull = y[2] - y[0]
        return y[1], (pull - y[0]) / self.mass, y[3], (-pull - 0.3 * friction) / self.mass

    def relative_velocity(self, t, y, base):
        return y[3] - base.velocity

    @property
    def shortest_time(self):
        return 2 * np.pi / 1.618


@pytest.fixture(scope="module")
def two():
    return ss.simulate(TwoMasses(), ss.Harmonic(1.0, 0.8), t1=12.0, y0=(0.0, 0.0, 1.0, 0.0))


@pytest.mark.slow
def test_base_of_an_own_system_has_a_panel(two):
    *panels, last = plot.time_history(two)
    assert (len(panels), last.get_ylabel(), last.get_xlabel()) == (4, "base velocity (m/s)", "time $t$ (s)")
    times, velocity = line(last, "base").get_data()
    assert velocity == pytest.approx(np.cos(0.8 * times), abs=1e-12)
    assert "base" in [text.get_text() for text in panels[0].get_legend().get_texts()]
    assert len(plot.time_history(two, axes=plt.figure().subplots(4))) == 4


@pytest.mark.slow
@pytest.mark.parametrize(("x", "y", "pair"), [(None, None, (0, 1)), ("position 2", "velocity 2", (2, 3))])
def test_portrait_of_chosen_coordinates(two, x, y, pair):
    ax = plot.phase_portrait(two, x=x, y=y)
    names = two.system.state_names
    assert [ax.get_xlabel(), ax.get_ylabel()] == [names[at].replace(" in ", " (") + ")" for at in pair]
    points = np.concatenate([piece for drawn in ax.lines for piece in segments(drawn)])
    states = np.column_stack([exact(two, np.unique(np.asarray(two.step_starts)))[0][at] for at in pair])
    assert np.all(np.min(np.linalg.norm(points[None] - states[:, None], axis=2), axis=1) < 1e-9)


@pytest.mark.parametrize("one", of("motor"), indirect=True)
def test_portrait_of_a_current(one):
    ax = plot.phase_portrait(one, x="angular velocity", y="current")
    assert [ax.get_xlabel(), ax.get_ylabel()] == [r"angular velocity $\dot\alpha$ (rad/s)", "current $c$ (A)"]
    drawn = line(ax, "stick")
    assert len(segments(drawn)) == int(one.sticks.count)
    assert np.nanmax(np.abs(drawn.get_xdata())) == 0
    against_angle = plot.phase_portrait(one, y="current")
    assert against_angle.get_xlim() == (0, FULL_CIRCLE)


@pytest.mark.slow
def test_bad_coordinates(two, annotations_unchecked):
    for options, message in (
        (
            {"x": "angle"},
            "Argument x must be the name of a coordinate of the TwoMasses, one of 'position 1', 'velocity 1",
        ),
        ({"y": 2}, "Argument y must be the name of a coordinate of the TwoMasses, .* but 2 was given"),
        (
            {"x": "velocity 1"},
            "Arguments x and y must be two different .*'velocity 1' is both with x='velocity 1'; give",
        ),
        ({"x": "position 2", "y": "position 2"}, "Arguments x and y must be two different coordinates"),
    ):
        with pytest.raises(ValueError, match=message):
            plot.phase_portrait(two, **options)
    plain = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, COULOMB), ss.Constant(0.3), t1=2.0)
    with pytest.raises(ValueError, match=r"energy_regions must be False unless .* position against velocity"):
        plot.phase_portrait(plain, x="velocity", y="position", energy_regions=True)


@pytest.mark.parametrize(
    "law",
    [
        ss.Coulomb(0.3, mu_static=0.4), ss.Stribeck(mu=0.3, mu_static=0.5, stribeck_speed=0.1),
        ss.Directional(ss.Coulomb(0.4), ss.VelocityWeakening(0.2, 3.0)), ss.Coulomb(0.0),
    ],
)  # fmt: skip
def test_characteristic_of_a_friction_law(law):
    """Both branches, and at rest everything between the two limits."""
    ax = plot.friction_law(law, speed=0.5)
    x, y = ax.lines[0].get_data()
    assert np.all(np.diff(x) >= 0)
    assert (x[0], x[-1]) == (-0.5, 0.5)
    for velocity, coefficient in zip(x[::40], y[::40], strict=True):
        own = law.in_direction(jnp.asarray(velocity))
        if velocity != 0:
            assert coefficient == pytest.approx(np.sign(velocity) * float(own.kinetic(jnp.abs(velocity))))
    limits = [sign * float(law.in_direction(jnp.asarray(sign)).static) for sign in (-1.0, 1.0)]
    assert (min(y[x == 0]), max(y[x == 0])) == pytest.approx(limits)
    assert ax.get_xlabel() == "relative velocity (m/s)"
    plot.friction_law(ss.Coulomb(0.1), label="other", ax=ax)
    assert [text.get_text() for text in ax.get_legend().get_texts()][-1] == "other"
    plt.close(ax.figure)


@pytest.mark.parametrize(
    ("period", "labels"),
    [
        (None, ["below 0 m", "0 to 0.25 m", "above 0.25 m"]),
        (1.0, ["0 to 0.25 m, every 1 m", "0.25 to 1 m, every 1 m"]),
    ],
)
def test_characteristic_of_each_region(period, labels):
    laws = tuple(ss.Coulomb(0.1 + 0.1 * number) for number in range(len(labels)))
    ax = plot.friction_law(ss.FrictionByPlace((0.0, 0.25), laws, period))
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == [f"{law!r}, {label}" for law, label in zip(laws, labels, strict=True)]
    drawn = [line.get_ydata()[-1] for line in ax.lines if len(line.get_ydata()) > 2]
    assert drawn == pytest.approx([law.mu for law in laws])
    plt.close(ax.figure)


def test_usual_speeds_of_a_characteristic():
    ax = plot.friction_law(ss.Stribeck(mu=0.3, mu_static=0.5, stribeck_speed=0.1))
    scale = float(ss.Stribeck(mu=0.3, mu_static=0.5, stribeck_speed=0.1).speed_scale)
    assert ax.lines[0].get_xdata()[-1] == pytest.approx(6 * scale)
    assert plot.friction_law(COULOMB).lines[0].get_xdata()[-1] == 1.0
    plt.close("all")


@pytest.mark.parametrize(
    ("law", "speed", "message"),
    [
        (0.3, None, "Argument law must be a friction law"),
        (COULOMB, 0.0, "Argument speed must be"),
        (ss.Coulomb(ss.Uniform(0.1, 0.2)), None, "law"),
        (ss.Coulomb(np.array([0.1, 0.2])), None, "law.mu must be one number"),
    ],
)
@pytest.mark.usefixtures("annotations_unchecked")
def test_laws_that_have_no_characteristic(law, speed, message):
    with pytest.raises(ValueError, match=message):
        plot.friction_law(law, speed=speed)


def test_drawing_of_a_mechanism():
    """The body stands where the state says; a motor's pin is where its angle says."""
    ax = plot.mechanism(ss.MassSpring(1.0, 4.0, 1.0, COULOMB), (0.3, 0.0))
    boxes = [patch.get_x() + patch.get_width() / 2 for patch in ax.patches]
    assert any(abs(place - 0.3) < 1e-9 for place in boxes)
    assert ax.get_xlabel() == "position $x$ (m)"
    cart = ss.MotorCart()
    ax = plot.mechanism(cart, (0.7, 0.0, 0.0))
    d = float(cart.eccentricity)
    pins = [patch.center for patch in ax.patches if hasattr(patch, "center")]
    assert any(np.allclose(pin, (d * np.cos(0.7), d * np.sin(0.7))) for pin in pins)
    with pytest.raises(ValueError, match="Argument y0 must"):
        plot.mechanism(cart, (0.7, 0.0))
    plt.close("all")


def test_displacements_of_sliding_blocks(annotations_unchecked):
    """A curve for each record, in the order of yields, and the median; what did not slide is left out."""
    values = np.array([[[0.1, 0.5]], [[0.0, 0.3]], [[0.4, 0.9]]])
    table = ss.NewmarkDisplacements(("a", "b", "c"), np.ones(1), np.array([0.2, 0.1]), values)
    ax = plot.newmark_displacements(table)
    drawn = [line.get_ydata() for line in ax.lines]
    np.testing.assert_array_equal(drawn, [[0.5, 0.1], [0.3, np.nan], [0.9, 0.4], [0.5, 0.1]])
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["3 records", "median"]
    with pytest.raises(ValueError, match="Argument scale must be at most 0"):
        plot.newmark_displacements(table, scale=1)
    with pytest.raises(ValueError, match="Argument result must be what newmark_displacements returns"):
        plot.newmark_displacements(values)
