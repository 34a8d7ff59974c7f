"""Films: their times, the histories that grow in them, what is coloured in which frame, and the files."""

import base64
import io
import re
import sys
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_hex
from PIL import Image
from support.films import Pair, bodies, contact_rows, history

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax.plot import _style
from stickslip_jax.plot._trajectory import lasts_at

SYSTEM = ss.MassSpring(1.0, 2.0, 1.0, ss.Coulomb(1.0))
FLIPS = ss.SquareWave(1.0, 5.0)
T1 = 12.0
ROW = ss.block_row(3, mass=1.0, between=2.0, to_ground=1.0, normal_force=1.0, friction=ss.Coulomb(0.3, 0.5))


@pytest.fixture(scope="module")
def one():
    return ss.simulate(SYSTEM, FLIPS, t1=T1, y0=(0.0, 1.0))


@pytest.fixture(scope="module")
def several():
    return ss.simulate(ROW, ss.Constant(0.2), t1=10.0, y0=(0.1, 0.0, -0.1, 0.2, 0.2, 0.2))


def intervals(sticks):
    """The start and the end of each."""
    mask = np.asarray(sticks.mask)
    return list(zip(np.asarray(sticks.start)[mask], np.asarray(sticks.end)[mask], strict=True))


def sticks_at(sticks, time, t1):
    """Whether one of the `sticks` lasts, by their definition; one that the end of the simulation cuts, there too."""
    return any(start <= time < end or time == end == t1 for start, end in intervals(sticks))


def is_coloured(patch):
    return to_hex(patch.get_facecolor()).upper() == _style.STICK


def read(data):
    """Number of frames and total duration (s) of a GIF."""
    image = Image.open(io.BytesIO(data))
    durations = []
    for number in range(image.n_frames):
        image.seek(number)
        durations.append(image.info["duration"])
    return image, np.array(durations) / 1000


# Times.


@pytest.mark.slow
def test_frames_are_as_far_apart_as_speed_and_rate_say(one):
    film = plot.animate(one, window=(2.0, 8.0), speed=1.5, fps=10)
    assert film.times == pytest.approx(2.0 + 0.15 * np.arange(41), rel=1e-14)
    assert (film.speed, film.fps) == (1.5, 10.0)
    assert repr(film) == "Animation of 2 to 8 s: 41 frames, 4.1 s, 1.5 s of motion in each second"
    # The last frame is the last one inside the window.
    assert plot.animate(one, window=(2.0, 8.0), speed=4.0, fps=1).times.tolist() == [2.0, 6.0]


@pytest.mark.slow
def test_a_film_lasts_ten_seconds_unless_told_otherwise(one):
    film = plot.animate(one)
    assert (len(film.times), film.fps, film.speed) == (251, 25, pytest.approx(T1 / 10))
    assert (film.times[0], film.times[-1]) == (0, T1)


@pytest.mark.slow
def test_the_picture_tells_time_and_speed(one):
    film = plot.animate(one, window=(2.0, 8.0), speed=1.5, fps=10)
    for number, told in ((0, "t = 2.00 s"), (7, "t = 3.05 s"), (-1, "t = 8.00 s")):
        figure = film.frame(number)
        assert [text.get_text() for text in figure.axes[0].texts if text.get_text()] == [told, "1.5 \u00d7 real time"]
    told = plot.animate(one, speed=1.0, fps=2).frame(0).axes[0].texts[-1].get_text()
    assert told == "real time"


# Histories and colours.


@pytest.mark.slow
@pytest.mark.parametrize("coordinate", [pytest.param("position", marks=pytest.mark.slow), "velocity"])
def test_history_grows_to_the_time_of_the_frame(one, coordinate):
    film = plot.animate(one, window=(1.0, 11.0), speed=2.0, fps=5, coordinate=coordinate)
    number = ("position", "velocity").index(coordinate)
    for frame, time in enumerate(film.times):
        mass, stick = history(film.frame(frame))
        assert (mass.get_xdata()[0], mass.get_xdata()[-1]) == (1.0, time)
        assert mass.get_ydata() == pytest.approx(np.asarray(one.evaluate(mass.get_xdata())[number]), abs=1e-13)
        times, values = stick.get_data()
        known = np.isfinite(values)
        # Of a stick both ends are drawn, and nothing outside.
        assert all(sticks_at(one.sticks, t, T1) or t in np.asarray(one.sticks.end) for t in times[known])
        assert not any(sticks_at(one.sticks, t, T1) for t in times[~known])
        assert values[known] == pytest.approx(mass.get_ydata()[known])
    below = film.figure.axes[1]
    assert below.get_xlim() == (1.0, 11.0)
    assert below.get_xlabel() == "time $t$ (s)"
    low, high = below.get_ylim()
    assert low < np.min(mass.get_ydata()) < np.max(mass.get_ydata()) < high


@pytest.mark.slow
def test_history_of_a_velocity_has_the_base(one):
    film = plot.animate(one, speed=2.0, fps=2, coordinate="velocity")
    (base,) = [line for line in film.frame(-1).axes[1].lines if line.get_linestyle() == "--"]
    assert set(base.get_ydata()) == {-1.0, 1.0}
    assert base.get_ydata() == pytest.approx(np.asarray(one.base_velocity(base.get_xdata())))


@pytest.mark.slow
def test_a_mass_is_coloured_in_exactly_the_frames_in_which_it_sticks(one):
    film = plot.animate(one)
    expected = [sticks_at(one.sticks, time, T1) for time in film.times]
    found = [is_coloured(bodies(film.frame(number))[-1]) for number in range(len(film.times))]
    assert found == expected
    assert 20 < sum(found) < 230


@pytest.mark.slow
def test_contacts_are_coloured_each_for_itself(several):
    film = plot.animate(several, fps=10)
    for number, time in enumerate(film.times):
        figure = film.frame(number)
        expected = [sticks_at(several.of_contact(i).sticks, time, 10.0) for i in range(3)]
        assert [is_coloured(patch) for patch in bodies(figure)[-3:]] == expected
        # Rows of sticks grow as well.
        drawn = contact_rows(figure)
        assert sorted(drawn) == sorted(
            (i, a, min(b, time)) for i in range(3) for a, b in intervals(several.of_contact(i).sticks) if a < time
        )
    assert {row for row, *_ in drawn} == {0, 1, 2}


def test_a_stick_without_length_is_in_no_frame_and_one_that_the_end_cuts_is_in_the_last():
    stuck = np.array([1.0, 2.0, 4.0]), np.array([1.0, 3.0, np.inf])
    times = np.array([0.5, 1.0, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0])
    assert lasts_at(stuck, times).tolist() == [False, False, True, True, False, False, True, True]
    assert not lasts_at((np.zeros(0), np.zeros(0)), times).any()


@pytest.mark.slow
def test_the_sticks_of_one_contact_or_of_all_together(several):
    """A system of which the sticks of one contact are counted colours that one; of all at once, all or none."""
    y0 = (0.1, 0.0, -0.1, 0.2, 0.2, 0.2)
    for system, coloured in ((ROW.of_contact(1), [1]), (ROW.of_all_contacts(), [0, 1, 2])):
        counted = ss.simulate(system, ss.Constant(0.2), t1=10.0, y0=y0)
        film = plot.animate(counted, fps=5)
        for number, time in enumerate(film.times):
            sticks = sticks_at(counted.sticks, time, 10.0)
            found = [is_coloured(patch) for patch in bodies(film.frame(number))[-3:]]
            assert found == [sticks and i in coloured for i in range(3)]
        assert len(film.figure.axes) == 2


# Results of all kinds.


@pytest.mark.slow
def test_regularised_motion():
    smoothed = ss.simulate(SYSTEM, FLIPS, t1=T1, y0=(0.0, 1.0), method=ss.Regularized(width=1e-2))
    film = plot.animate(smoothed, fps=5)
    assert int(smoothed.sticks.count) > 0
    found = [is_coloured(bodies(film.frame(number))[-1]) for number in range(len(film.times))]
    assert found == [sticks_at(smoothed.sticks, time, T1) for time in film.times]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32:UserWarning")
def test_single_precision(one):
    with jax.enable_x64(False):
        single = ss.simulate(SYSTEM, FLIPS, t1=T1, y0=(0.0, 1.0))
        film = plot.animate(single, fps=5)
        mass = bodies(film.frame(-1))[-1]
        assert film.times.dtype == np.float32
        assert film.times[-1] == np.float32(T1)
        assert mass.get_x() + mass.get_width() / 2 == pytest.approx(float(single.final_state[0]), abs=1e-5)
    assert float(single.final_state[0]) == pytest.approx(float(one.final_state[0]), abs=1e-3)


@pytest.mark.slow
def test_a_motion_without_sticks_and_one_without_motion():
    fast = ss.simulate(SYSTEM, ss.Constant(50.0), t1=2.0, y0=(0.5, 0.0))
    film = plot.animate(fast, fps=5)
    assert not any(is_coloured(bodies(film.frame(number))[-1]) for number in range(len(film.times)))
    still = plot.animate(ss.simulate(SYSTEM, ss.Constant(0.0), t1=2.0), fps=5)
    assert all(is_coloured(bodies(still.frame(number))[-1]) for number in range(len(still.times)))


@pytest.mark.slow
def test_what_cannot_be_animated(one, several, annotations_unchecked):
    batch = jax.tree.map(lambda *leaves: np.stack(leaves), one, one)
    stopped = eqx.tree_at(
        lambda of: (of.status, of.time_reached), one, (jnp.asarray(int(ss.Status.NOT_FINITE)), jnp.zeros(()))
    )
    contact = "must hold the sticks of all contacts, but one of of_contact or of_all_contacts was given; animate the"
    for result, options, message in (
        (SYSTEM, {}, "Argument result must be a result of simulate"),
        (batch, {}, r"must hold one trajectory, but a batch of shape \(2,\) was given; take one out"),
        (stopped, {}, "must hold a motion to draw, but one with this status was given: the state became NaN"),
        (several.of_contact(1), {}, contact),
        (several.of_all_contacts(), {}, contact),
        (one, {"window": (3.0, 20.0)}, "Argument window must be two times"),
        (one, {"coordinate": "angle"}, "Argument coordinate must be one of 'position', 'velocity', but 'angle'"),
        (one, {"speed": 0.0}, r"Argument speed must be positive \(in s of motion per s of film\), but 0.0"),
        (one, {"fps": -1}, "Argument fps must be positive"),
        (one, {"fps": 60}, "Argument fps must be at most 50"),
        (
            one,
            {"speed": 1e-3},
            "must make 2 to 3,000 frames, .* are 300,001; choose a higher speed or a shorter window",
        ),
        (one, {"speed": 1e6}, "are 1; choose a lower speed"),
        (one, {"figsize": (6.0,)}, r"Argument figsize must be two numbers \(width, height\)"),
        (one, {"figsize": (6.0, 0.5)}, r"Argument figsize\[1\] must be at least 2 \(in inches\), but 0.5"),
    ):
        with pytest.raises(ValueError, match=message):
            plot.animate(result, **options)
    with pytest.raises(ValueError, match="traced by a JAX transformation"):
        jax.jit(plot.animate)(one)
    film = plot.animate(one, fps=1)
    for number in (11, -12, 0.5):
        with pytest.raises(ValueError, match="Argument number must be"):
            film.frame(number)


# Files.


@pytest.mark.slow
@pytest.mark.parametrize("fps", [10, 30, 12.5])
def test_gif_has_all_frames_and_the_speed_of_the_film(one, fps, tmp_path):
    film = plot.animate(one, speed=6.0, fps=fps, figsize=(3.2, 2.4))
    film.save(tmp_path / "film.gif", dpi=50, progress=False)
    image, durations = read((tmp_path / "film.gif").read_bytes())
    assert image.size == (160, 120)
    assert len(durations) == len(film.times) == int(2 * fps) + 1
    # Frames begin at the right hundredth of a second, though none may last a third of ten.
    assert np.cumsum(durations) == pytest.approx(np.arange(1, len(durations) + 1) / fps, abs=0.0051)
    assert image.info["loop"] == 0


@pytest.mark.slow
def test_a_gif_shows_the_frames(one, tmp_path):
    """As `frame` shows them: only the axes are drawn once."""
    film = plot.animate(one, fps=1, figsize=(4.0, 3.0))
    film.save(tmp_path / "film.gif", dpi=50, progress=False)
    image, _ = read((tmp_path / "film.gif").read_bytes())
    for number in (0, 5, 10):
        written = io.BytesIO()
        film.frame(number).savefig(written, dpi=50)
        image.seek(number)
        expected = np.asarray(Image.open(written).convert("RGB"), float)
        found = np.asarray(image.convert("RGB"), float)
        assert np.mean(np.abs(found - expected)) < 1.5  # of 255: few colours
        stick = np.array([0xD5, 0x5E, 0x00])
        shown, expected_shown = (np.sum(np.abs(each - stick).max(-1) < 24) for each in (found, expected))
        assert shown == pytest.approx(expected_shown, rel=0.1, abs=5)
    assert film.figure.dpi == mpl.rcParams["figure.dpi"]


@pytest.mark.slow
def test_files_are_whole_or_not_there(one, tmp_path, monkeypatch):
    film = plot.animate(one, fps=1, figsize=(2.0, 2.0))
    path = tmp_path / "film.gif"
    with pytest.raises(ValueError, match=r"ends in \.gif or \.mp4, but '.*film.avi'"):
        film.save(tmp_path / "film.avi")
    with pytest.raises(FileNotFoundError):
        film.save(tmp_path / "missing" / "film.gif")
    with pytest.raises(ValueError, match="Argument dpi must be positive"):
        film.save(path, dpi=0)
    path.write_bytes(b"older")
    with pytest.raises(FileExistsError, match="overwrite=True"):
        film.save(path)
    move = film._move

    def broken(frame):
        if frame == 7:
            raise KeyboardInterrupt
        move(frame)

    monkeypatch.setattr(film, "_move", broken)
    with pytest.raises(KeyboardInterrupt):
        film.save(path, overwrite=True, progress=False)
    assert path.read_bytes() == b"older"
    assert [found.name for found in tmp_path.iterdir()] == ["film.gif"]
    monkeypatch.setattr(film, "_move", move)
    film.save(path, overwrite=True, progress=False)
    assert len(read(path.read_bytes())[1]) == 11
    assert [found.name for found in tmp_path.iterdir()] == ["film.gif"]


@pytest.mark.slow
def test_progress_counts_frames(one, tmp_path, capsys):
    plot.animate(one, fps=1, figsize=(2.0, 2.0)).save(tmp_path / "film.gif", progress=True)
    shown = capsys.readouterr().err
    assert "11.0/11.0" in shown
    assert "frame/s" in shown or "s/frame" in shown


@pytest.mark.slow
def test_mp4_needs_ffmpeg(one, tmp_path):
    film = plot.animate(one, fps=2, figsize=(2.0, 2.0))
    with (
        mpl.rc_context({"animation.ffmpeg_path": "no-such-ffmpeg"}),
        pytest.raises(ImportError, match=r"needs the program ffmpeg, but no 'no-such-ffmpeg' was found; install it"),
    ):
        film.save(tmp_path / "film.mp4")
    assert list(tmp_path.iterdir()) == []


FFMPEG = """#!{python}
import sys
data = sys.stdin.buffer.read()
if "{fails}":
    sys.exit("Unknown encoder")
with open(sys.argv[-1], "wb") as file:
    file.write(repr((sys.argv, len(data))).encode())
"""


@pytest.mark.slow
@pytest.mark.parametrize("fails", ["", "yes"])
def test_mp4_by_ffmpeg(one, tmp_path, fails):
    """A program in its place, which says what it was given."""
    program = tmp_path / "ffmpeg"
    program.write_text(FFMPEG.format(python=sys.executable, fails=fails))
    program.chmod(0o755)
    film, path = plot.animate(one, fps=12.5, speed=6.0, figsize=(2.0, 2.02)), tmp_path / "film.mp4"
    with mpl.rc_context({"animation.ffmpeg_path": str(program)}):
        if fails:
            with pytest.raises(OSError, match="ffmpeg could not make the film: Unknown encoder"):
                film.save(path, dpi=50, progress=False)
            assert not path.exists()
            return
        film.save(path, dpi=50, progress=False)
    arguments, size = eval(path.read_text())
    assert arguments[arguments.index("-framerate") + 1] == "12.5"
    assert arguments[arguments.index("-s") + 1] == "100x100"  # even numbers, as its codec needs them
    assert size == len(film.times) * 4 * 100 * 100


@pytest.mark.slow
def test_notebooks_play_it_without_the_net(one):
    film = plot.animate(one, fps=1, figsize=(2.0, 2.0))
    shown = film._repr_html_()
    (data,) = re.findall('src="data:image/gif;base64,([^"]*)"', shown)
    assert len(read(base64.b64decode(data))[1]) == 11
    assert "http" not in shown.replace(data, "")
    assert film._repr_html_() is shown  # drawn once


# Systems of one's own.


class Own(Pair):
    """Two masses that are drawn as a test says, by default as bars."""

    draws: ClassVar = []

    @property
    def look(self):
        return plot.Look(mechanism=self.draws[0] if self.draws else None)


@pytest.fixture(scope="module")
def own():
    system = Own(stiffness=1.0, mass=1.0, normal_force=1.0, mu=0.3, mu_static=0.4)
    return ss.simulate(system, ss.Harmonic(1.0, 0.8), t1=20.0, y0=(0.0, 0.0, 1.0, 0.0))


@pytest.mark.slow
def test_a_system_of_ones_own_as_bars(own):
    """Each coordinate over its largest size among the frames; all coloured while the contact sticks."""
    film = plot.animate(own, fps=5, coordinate="velocity 2")
    state = np.asarray(own.evaluate(film.times))
    largest = np.abs(state).max(1)
    for number, time in enumerate(film.times):
        drawn = bodies(film.frame(number))
        heights = [patch.get_height() * (1 if patch.get_y() > -1e-12 else -1) for patch in drawn]
        assert heights == pytest.approx(state[:, number] / largest, abs=1e-12)
        assert [is_coloured(patch) for patch in drawn] == [sticks_at(own.sticks, time, 20.0)] * 4
    names = [label.get_text() for label in film.figure.axes[0].get_xticklabels()]
    assert names[2] == f"position 2\n±{largest[2]:.3g} m"
    assert film.figure.axes[1].get_ylabel() == "velocity 2 (m/s)"


@pytest.mark.slow
def test_a_system_of_ones_own_as_it_says(own, monkeypatch):
    def parts(state, base):
        belt, spring = plot.Belt(0.0, base, (-2.0, 2.0)), plot.Spring((-2.0, 0.5), (state[2], 0.5))
        mass = plot.Body((state[2], 0.5), 0.5, 1.0, (0,), label="m")
        return plot.Mechanism((belt, spring, mass), (-2.0, 2.0), (-0.5, 1.5), "position 2 (m)")

    monkeypatch.setattr(Own, "draws", [parts])
    film = plot.animate(own, fps=5)
    for number in (0, 20, 50):
        (mass,) = bodies(film.frame(number))
        assert mass.get_x() + 0.25 == pytest.approx(float(own.evaluate(film.times[number])[2]))
    assert film.figure.axes[0].get_xlabel() == "position 2 (m)"
    assert "m" in [text.get_text() for text in film.figure.axes[0].texts]


def of(part):
    return lambda state, base: plot.Mechanism((part(state[2]),), (0.0, 1.0), (0.0, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "message"),
    {
        lambda state, base: list(state): "The mechanism in the look of Own must return a plot.Mechanism of Body",
        of(lambda x: x): "must return a plot.Mechanism of Body",
        of(lambda x: plot.Body((x[1:], 0.0), 1.0, 1.0)): "arrays of 51 of them, one for each frame, but a Body has",
        of(lambda x: plot.Disk((0.0, 0.0), 1.0, np.nan * x)): "must return finite numbers .* but a Disk has",
        of(lambda x: plot.Rod((0.0, x), (0.0, "up"))): "Argument mechanism must be real numbers",
        of(lambda x: plot.Body((x, 0.0), 1.0, 1.0, (1,))): r"of contacts from 0 to 0, but a Body has .* \(1,\)",
    }.items(),
)
def test_mechanisms_that_cannot_be_drawn(own, made, message, monkeypatch, annotations_unchecked):
    monkeypatch.setattr(Own, "draws", [made])
    with pytest.raises(ValueError, match=message):
        plot.animate(own, fps=5)
