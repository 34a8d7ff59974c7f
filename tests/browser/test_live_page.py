"""The live page: its numbers are those of the package, to 1e-12, and its sliders, figures and code do what they say.

The page's body stands in a page of its own here, without the theme of the site.
"""

import contextlib
import io
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from support.browser import resize, served

import stickslip_jax as ss
from stickslip_jax._dynamics.interval.arcs import Scales, carry_across
from stickslip_jax.plot import _style

pytestmark = pytest.mark.browser
STATIC = Path(__file__).parents[2] / "docs" / "_static"
HEAD = '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width"><body>'
T1, SAMPLES, Y0 = 50.0, 2000, (0.0, 1.0)
CLOSE = 1e-12
PLACES = {
    "at first": (1.0, 1.0, 1.0),
    "all sliders at their lower ends": (0.0, 0.0, 0.1),
    "all sliders at their upper ends": (4.0, 3.0, 5.0),
    "no friction": (0.0, 1.0, 1.0),
    "a belt at rest": (0.6, 0.0, 1.0),
    "little friction, many switches": (0.2, 1.0, 5.0),
    "much friction, a slow belt": (4.0, 0.05, 0.1),
    "in between": (0.35, 0.65, 2.3),
}
"""Friction coefficient, speed (m/s) and rate (1/s)."""
STATISTICS = {
    "mean-stick-duration": ss.mean_stick_duration,
    "mean-stick-count": ss.mean_stick_count,
    "stick-fraction": ss.stick_fraction,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    (folder / "_static").symlink_to(STATIC)
    (folder / "live.html").write_text(HEAD + (STATIC / "live" / "live.html").read_text("utf-8"), "utf-8")
    return folder


@pytest.fixture(scope="module")
def opened(browser, folder):
    """The page in the browser, served from this machine."""
    with served(folder) as address:
        resize(browser, 1280)
        browser.get(f"{address}/live.html")
        yield browser


def move(browser, **sliders):
    """Move sliders by script, and wait until the page has been drawn again."""
    script = """
    const [sliders, done] = arguments;
    for (const [name, value] of Object.entries(sliders)) {
      const slider = document.getElementById(`live-${name}`);
      slider.value = value;
      slider.dispatchEvent(new Event("input", {bubbles: true}));
    }
    requestAnimationFrame(() => requestAnimationFrame(() => done()));
    """
    browser.execute_async_script(script, sliders)


def text(browser, name):
    return browser.execute_script(f"return document.getElementById('live-{name}').textContent")


def shown(browser, name):
    """Value and standard error of a statistic, all digits."""
    found = browser.execute_script(f"return {{...document.getElementById('live-{name}').dataset}}")
    return np.array([float(found["value"]), float(found["error"])])


def ensemble(mu, speed, rate):
    system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=mu))
    law = ss.PoissonSwitching(speed=speed, rate=rate) if speed else ss.Constant(speed=0.0)
    return ss.simulate_ensemble(system, law, t1=T1, samples=SAMPLES, key=jax.random.key(0), y0=Y0, keep="sticks")


@pytest.fixture(scope="module", params=PLACES.values(), ids=PLACES)
def both(request, opened):
    """The page with its sliders at one place, and the ensemble of the package."""
    mu, speed, rate = request.param
    move(opened, mu=mu, speed=speed, rate=rate, sample=0)
    return opened, ensemble(mu, speed, rate)


def close(found, expected, least=0.0):
    np.testing.assert_allclose(found, expected, rtol=CLOSE, atol=least)


def test_random_words_are_those_of_jax(opened):
    for seed, counter in ((0, 0), (1, 7), (2**32 - 1, 2**32 - 1), (12345, 2**31)):
        key = jax.random.fold_in(jax.random.key(seed), counter)
        script = "return stickslip.random.randomWords(stickslip.random.keyOf(arguments[0]), arguments[1])"
        assert opened.execute_script(script, seed, counter) == jax.random.key_data(key).tolist()


def test_one_interval_from_any_state(opened):
    """From states that hardly any sample meets too: at rest, at edges of the band, on arcs tangent to the velocity."""
    rng, mu, span = np.random.default_rng(0), 1.0, 2.5
    x, v, base = rng.uniform(-1, 1, 300), rng.uniform(-1.5, 1.5, 300), rng.choice([-1.0, 0.0, 0.5], 300)
    angle = rng.uniform(np.pi / 2, 2 * np.pi, 100)
    x = np.append(x, [*(mu / 4 + 0.5 / 2 * np.cos(angle)), 0.25, -0.25, 0.1, 0.2])
    v = np.append(v, [*(0.5 * np.sin(angle)), 0.5, 0.5, 0.0, 0.0])
    base = np.append(base, [*np.full(100, 0.5), 0.5, 0.5, 0.0, 0.0])
    scales = Scales.of(jnp.asarray(4.0), jnp.asarray(mu), jnp.asarray(T1))
    began = jnp.asarray(30.0)
    expected = jax.vmap(carry_across, (0, 0, 0, None, None, None))(x, v, base, scales, jnp.asarray(span), began)
    script = """
    const [x, v, base, span] = arguments;
    const scales = stickslip.interval.scalesOf(stickslip.page.model(), 50);
    return x.map((x, index) => stickslip.interval.carryAcross(x, v[index], base[index], span, scales, 30));
    """
    move(opened, mu=mu, speed=1, rate=1, sample=0)
    found = opened.execute_script(script, x.tolist(), v.tolist(), base.tolist(), span)
    for name in ("stuck", "released"):
        np.testing.assert_array_equal([one[name] for one in found], getattr(expected, name))
    assert 100 < expected.stuck.sum() < 300
    for name in ("x", "v"):
        close([one[name] for one in found], getattr(expected, name), least=CLOSE)


def test_statistics(both):
    page, many = both
    for name, statistic in STATISTICS.items():
        estimate, (value, error) = statistic(many), shown(page, name)
        close(value, estimate.value)
        close(error, estimate.standard_error, least=CLOSE * abs(estimate.value))
        if estimate.standard_error > CLOSE:
            assert text(page, name) == estimate.without_name().replace("+-", "±")
    if not ss.mean_stick_count(many).value:
        assert text(page, "mean-stick-duration") == "not defined: no stick"


def test_every_stick_of_every_realisation(both):
    page, many = both
    found = page.execute_script("""
    const {page, ensemble} = stickslip;
    const sticks = page.draws.map((draws) => ensemble.simulateOne(page.model(), draws).sticks);
    const column = (name) => sticks.flat().map((stick) => stick[name]);
    return {count: sticks.map((own) => own.length), start: column("start"), end: column("end"),
            position: column("position"), ending: column("ending")};
    """)
    expected = many.sticks
    np.testing.assert_array_equal(found["count"], expected.mask.sum(axis=1))
    used = expected.mask
    for name in ("start", "end", "position"):
        close(found[name], getattr(expected, name)[used], least=CLOSE)
    endings = np.array(["released", "switched", "horizon"])
    np.testing.assert_array_equal(found["ending"], endings[expected.ending[used]] if used.any() else [])


def test_histogram(both):
    page, many = both
    found = page.execute_script("""
    const {page, ensemble, statistics} = stickslip;
    const {durations} = ensemble.simulateEnsemble(page.model(), page.draws);
    const {width, counts, density} = statistics.histogram(durations);
    return {number: durations.length, largest: Math.max(0, ...durations), width, counts: [...counts],
            density: [...density]};
    """)
    numbered = many.sticks.mask & ~(many.sticks.start == 0)
    durations = many.sticks.duration[numbered]
    assert found["number"] == len(durations) == int(text(page, "sticks").replace(",", ""))
    if len(durations):
        counts, edges = np.histogram(
            np.minimum(durations, found["largest"]), len(found["counts"]), (0, found["largest"])
        )
        at_edge = np.abs(durations[:, None] - edges[None, 1:-1]) < CLOSE  # round-off decides on which side
        assert np.abs(np.array(found["counts"]) - counts).sum() <= 2 * at_edge.sum()
        close(found["largest"], durations.max())
        close(sum(found["density"]) * found["width"], 1)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("place", ["in between", "a belt at rest"])
def test_code_on_the_page_prints_the_same(opened, place):
    move(opened, **dict(zip(("mu", "speed", "rate"), PLACES[place], strict=True)), sample=3)
    code = text(opened, "code")
    assert max(map(len, code.splitlines())) <= 88
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, {})
    plt.close("all")
    lines = printed.getvalue().splitlines()
    assert f" {text(opened, 'sticks-of-one')} stick" in lines[-1]
    for line, name in zip(lines, STATISTICS, strict=False):
        assert line.partition(": ")[2].split(" +- ")[0] == text(opened, name).split(" ± ")[0]


def test_arrow_keys_move_a_slider(opened):
    from selenium.webdriver.common.by import By  # noqa: PLC0415 - tests are collected without it too
    from selenium.webdriver.common.keys import Keys  # noqa: PLC0415

    move(opened, mu=1, speed=1, rate=1, sample=0)
    slider = opened.find_element(By.ID, "live-mu")
    slider.send_keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    move(opened)
    assert text(opened, "mu-value") == "1.05"
    close(shown(opened, "mean-stick-duration")[0], ss.mean_stick_duration(ensemble(1.05, 1.0, 1.0)).value)
    slider.send_keys(Keys.HOME)
    move(opened)
    assert text(opened, "mu-value") == "0.00"
    opened.find_element(By.CSS_SELECTOR, "#live-controls button").click()
    move(opened)
    assert text(opened, "mu-value") == "1.00"


def colored(browser, name, color):
    """How many pixels of a canvas have this colour."""
    script = """
    const canvas = document.getElementById(`live-${arguments[0]}`);
    const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let number = 0;
    for (let at = 0; at < data.length; at += 4) {
      number += data[at + 3] === 255 && arguments[1].every((part, index) => data[at + index] === part);
    }
    return number;
    """
    return browser.execute_script(script, name, [round(255 * part) for part in to_rgb(color)])


def test_figures_have_the_colours_of_the_package(opened):
    move(opened, mu=1, speed=1, rate=1, sample=0)
    for figure, color in (
        ("portrait", _style.STICK),
        ("portrait", _style.FORWARD),
        ("portrait", _style.BASE),
        ("history", _style.STICK),
        ("history", _style.BASE),
        ("histogram", _style.STICK),
    ):
        assert colored(opened, figure, color) > 10, (figure, color)
    move(opened, mu=0)
    assert [colored(opened, figure, _style.STICK) for figure in ("portrait", "history", "histogram")] == [0, 0, 0]
    move(opened, mu=1, speed=0)
    assert colored(opened, "portrait", _style.AT_REST) > 10
    assert colored(opened, "portrait", _style.STICK) > 10  # a point
    assert colored(opened, "histogram", _style.STICK) > 10  # all realisations are the same: one bar


def test_dark_and_narrow(opened):
    move(opened, mu=1, speed=1, rate=1, sample=0)
    light = colored(opened, "history", _style.BASE)
    opened.execute_script("document.documentElement.dataset.theme = 'dark'")
    move(opened)
    assert light > 10 > colored(opened, "history", _style.BASE)
    opened.execute_script("delete document.documentElement.dataset.theme")
    resize(opened, 390)
    move(opened, mu=4, speed=3, rate=5, sample=1999)
    assert opened.execute_script("return document.documentElement.scrollWidth") <= 390
    assert opened.execute_script("return document.getElementById('live-portrait').width") < 390
    resize(opened, 1280)


def test_nothing_comes_from_elsewhere(opened):
    loaded = opened.execute_script("return performance.getEntriesByType('resource').map((one) => one.name)")
    own = opened.execute_script("return location.origin")
    assert len(loaded) >= 8
    assert [name for name in loaded if not name.startswith(f"{own}/")] == []


def test_the_page_works_as_a_file_too(opened, folder):
    """The last test: without any server, as the site does that `make site` builds."""
    opened.get((folder / "live.html").as_uri())
    close(shown(opened, "mean-stick-duration")[0], ss.mean_stick_duration(ensemble(1.0, 1.0, 1.0)).value)
