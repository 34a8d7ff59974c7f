"""`stickslip explore` in a browser: what it shows is what the package computes, and nobody else can drive it."""

import html
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import jax
import pytest
from support.browser import resize
from support.explorer import Page

import stickslip_jax as ss

pytestmark = pytest.mark.browser
T1, SAMPLES, Y0 = 30.0, 400, (0.0, 1.0)
CONFIG = f"""
[system]
mu = 0.8
[base]
speed = 0.9
[run]
t1 = {T1}
"""
START = ["-c", "import sys; from stickslip_jax._cli import main; sys.exit(main())", "explore", "--no-browser"]


class Served:
    """The command as a process, and the address that it printed."""

    def __init__(self, folder, *options, **variables):
        (folder / "study.toml").write_text(CONFIG, encoding="utf-8")
        command = [sys.executable, *START, *(options or ("study.toml", "--samples", str(SAMPLES)))]
        self.process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env=os.environ | {"PYTHONUNBUFFERED": "1"} | variables,
        )  # fmt: skip
        line = self.process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+/\S+", line)
        assert found, line + self.process.stdout.read()
        self.address = found[0]

    def interrupt(self, number=signal.SIGINT, seconds=60):
        """Ctrl-C. The exit code, and what was printed since."""
        self.process.send_signal(number)
        said, _ = self.process.communicate(timeout=seconds)
        return self.process.returncode, said.lstrip()  # the end of the line before may have been read with it, or not

    def descendants(self):
        """The numbers of all processes that it has started, and of those that these have."""
        parents = {}
        for status in Path("/proc").glob("[0-9]*/stat"):
            with suppress(OSError):
                parents[int(status.parent.name)] = int(status.read_text().rpartition(")")[2].split()[1])
        own = {self.process.pid}
        while new := {number for number, above in parents.items() if above in own} - own:
            own |= new
        return own - {self.process.pid}


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    one = Served(tmp_path_factory.mktemp("explorer"))
    yield one
    if one.process.poll() is None:
        one.interrupt()


@pytest.fixture
def page(browser, served):
    resize(browser, 1280, 1400)
    browser.get(served.address)
    page = Page(browser)
    page.wait_for("mean stick duration", 300)
    return page


def row(statistic):
    return f"{statistic.name}\t{statistic.without_name().replace('+-', '±')}"


def ensemble(mu=0.8, speed=0.9, rate=1.0, mass=1.0, t1=T1):
    system = ss.MassSpring(mass, 4.0, 1.0, ss.Coulomb(mu))
    law = ss.PoissonSwitching(speed, rate)
    return ss.simulate_ensemble(
        system, law, t1=t1, samples=SAMPLES, key=jax.random.key(0), y0=Y0, keep="sticks", progress=False
    )


@pytest.mark.filterwarnings("ignore:The event part rests on")
def test_first_numbers_are_those_of_the_package(page):
    many = ensemble()
    for statistic in (ss.mean_stick_duration(many), ss.mean_stick_count(many), ss.stick_fraction(many)):
        assert row(statistic) in page.table()
    system, law = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.8)), ss.PoissonSwitching(0.9, 1.0)
    slope = ss.sensitivity(
        ss.mean_stick_duration, system, law, wrt="system.friction.mu", t1=T1, samples=SAMPLES,
        key=jax.random.key(0), y0=Y0,
    )  # fmt: skip
    number = str(slope).replace("+-", "±").partition(": ")[2]
    page.wait_for(f"Derivative of the mean stick duration (pooled) by friction coefficient: {number}")


def test_three_sliders_by_the_keyboard(page):
    """Each handle takes the focus and the arrow keys; the boxes say where the sliders are."""
    for name, key, times in (("friction coefficient", "ARROW_LEFT", 3), ("rate (1/s)", "ARROW_RIGHT", 2),
                             ("mass (kg)", "PAGE_UP", 1)):  # fmt: skip
        page.press(name, key, times)
    mu, rate, mass = (float(page.box(name)) for name in ("friction coefficient", "rate (1/s)", "mass (kg)"))
    assert mu < 0.8
    assert rate > 1.0
    assert mass > 1.0
    page.wait_for(row(ss.mean_stick_duration(ensemble(mu=mu, rate=rate, mass=mass))))
    page.wait_for("Derivative of the mean stick duration (pooled) by mass:")


def test_bad_input_in_a_box(page):
    before = page.table()
    for text, why in (
        ("fast", "'fast' is not a number; write one such as 0.25 or 1e-3."),
        ("-1", "Speed must be positive (in m/s), but -1.0 was given."),
        ("<script>document.title = 'driven'</script>", "is not a number"),
    ):
        page.write("speed (m/s)", text)
        page.wait_for(why)
        assert page.table() == before
    page.write("speed (m/s)", "1.3")
    page.wait_for(row(ss.mean_stick_duration(ensemble(speed=1.3))))
    assert "is not a number" not in page.text()
    assert page.browser.title == "stickslip explorer"


def test_other_system(page):
    page.choose("System", "motor and cart")
    page.wait_for("motor constant (V s/rad)")
    many = ss.simulate_ensemble(
        ss.MotorCart(), ss.RandomPhase(ss.SourceVoltage()), t1=2.0, samples=SAMPLES, key=jax.random.key(0),
        y0=(ss.Uniform(0.0, 2 * 3.141592653589793), 0.0, 0.0), keep="sticks", progress=False,
    )  # fmt: skip
    page.wait_for(row(ss.mean_stick_duration(many)))
    assert "duration of a realisation (s)" in page.text()


def test_bifurcation_where_the_base_is_deterministic(page):
    assert "Bifurcation" not in page.text()
    page.choose("Base", "SquareWave")
    page.wait_for("Bifurcation")
    page.click("Bifurcation")
    page.wait_for("From one start at each value, after 100 periods.", 300)


def test_two_pages_at_once(page, served):
    browser = page.browser
    page.write("speed (m/s)", "1.1")
    first = browser.current_window_handle
    browser.switch_to.new_window("tab")
    browser.get(served.address)
    other = Page(browser)
    other.wait_for(row(ss.mean_stick_duration(ensemble())))
    other.write("speed (m/s)", "0.6")
    other.wait_for(row(ss.mean_stick_duration(ensemble(speed=0.6))))
    browser.close()
    browser.switch_to.window(first)
    page.wait_for(row(ss.mean_stick_duration(ensemble(speed=1.1))))


def test_program_is_copied(page):
    page.browser.execute_cdp_cmd(
        "Browser.grantPermissions", {"permissions": ["clipboardReadWrite", "clipboardSanitizedWrite"]}
    )
    page.write("speed (m/s)", "1.25")
    page.wait_for(row(ss.mean_stick_duration(ensemble(speed=1.25))))
    page.click("Copy as Python")
    page.wait_for("Copied")
    copied = page.browser.execute_async_script(
        "const done = arguments[0]; navigator.clipboard.readText().then(done, (error) => done(String(error)));"
    )
    assert "law = ss.PoissonSwitching(speed=1.25, rate=1.0)" in copied


def is_marked_old(page):
    """Whether the results are pale: those of numbers of before."""
    (results,) = page.all(".results")
    return float(results.value_of_css_property("opacity")) < 0.5


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize(("width", "columns"), [(390, 1), (800, 1), (1920, 2)])
def test_everything_fits_into_the_width(page, width, columns, theme):
    """In so many columns of pictures, and readable in the colours that the reader prefers."""
    preferred = {"features": [{"name": "prefers-color-scheme", "value": theme}]}
    page.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", preferred)
    resize(page.browser, width, 900)
    time.sleep(1)
    assert page.browser.execute_script("return document.documentElement.scrollWidth") <= width
    boxes = [one.rect for one in page.all("canvas") if one.rect["width"] > 200]  # not of legends
    for box in boxes:
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width
    assert len({round(box["x"] / 100) for box in boxes}) == columns
    assert page.browser.find_element("css selector", "meta[name=viewport]").get_attribute("content")

    def brightness(element, of):
        red, green, blue = re.findall(r"[0-9.]+", element.value_of_css_property(of))[:3]
        return 0.3 * float(red) + 0.6 * float(green) + 0.1 * float(blue)

    paper = brightness(page.browser.find_element("css selector", "html"), "background-color")
    texts = [page.all(css)[0] for css in ("h1", "table", ".bk-slider-title", "label", ".bk-tab", "select", "textarea")]
    texts += page.all(".bk-label")
    for one in texts:
        assert abs(brightness(one, "color") - paper) > 120, one.text
    page.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_no_warning_on_the_first_screen(browser, tmp_path):
    """Nor anything in the browser's log."""
    one = Served(tmp_path, "--port", "0")
    browser.get_log("browser")
    browser.get(one.address)
    page = Page(browser)
    page.wait_for("Derivative of the mean stick duration", 300)
    page.wait_for("±", 10)
    assert not any(word in page.text() for word in ("rests on", "exactly", "does not exist", "not begun"))
    assert [said for said in browser.get_log("browser") if said["source"] != "rendering"] == []
    browser.get("about:blank")
    assert one.interrupt()[1] == "The explorer has ended.\n"


def test_no_number_stands_as_new_that_is_old(page):
    """From the first change of which the page knows on: in its state, change by change, and in each frame drawn.

    A short run may end between two frames, so that none is pale: the state alone must have been.
    """
    number = page.table().splitlines()[1].split("\t")[1]
    watch = """
    window.states_seen = [];
    window.frames_seen = [];
    const [results, statistics] = arguments;
    const models = [...Bokeh.documents[0]._all_models.values()];
    const of = (name) => models.find((one) => (one.css_classes ?? []).includes(name));
    const [results_model, statistics_model] = [of("results"), of("statistics")];
    Bokeh.documents[0].on_change(() => states_seen.push([results_model.styles.opacity, statistics_model.text]));
    const look = () => {
      frames_seen.push([getComputedStyle(results).opacity, statistics.shadowRoot.textContent]);
      requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
    """
    page.browser.execute_script(watch, page.all(".results")[0], page.all(".statistics")[0])
    page.write("rate (1/s)", "1.75")
    page.wait_for(row(ss.mean_stick_duration(ensemble(rate=1.75))))
    assert not is_marked_old(page)
    states, frames = page.browser.execute_script("return [window.states_seen, window.frames_seen]")
    assert "pale" in kinds_seen(states, number)
    for seen in (states, frames):
        assert re.fullmatch("(before )*(pale )*(new )+", kinds_seen(seen, number))


def kinds_seen(states, number):
    """Of each state: `before` if this number of before stands as new, `pale` if what is seen is marked as old."""
    kinds = ["pale" if float(opacity) < 0.5 else "before" if number in said else "new" for opacity, said in states]
    return "".join(f"{one} " for one in kinds)


@pytest.mark.parametrize(
    ("label", "text", "name"), [("rate (1/s)", "110001", "rate"), ("duration of a realisation (s)", "1e9", "t1")]
)
def test_overload_is_told_and_not_begun(page, label, text, name):
    page.write(label, text)
    page.wait_for("This was not begun: it would take about", 30)
    assert is_marked_old(page)
    page.write(label, "40")
    page.wait_for(row(ss.mean_stick_duration(ensemble(**{name: 40.0}))), 300)
    assert "not begun" not in page.text()


def test_thousand_quick_moves(page):
    """The page follows the last; those in between are left out."""
    move = """
    const models = [...Bokeh.documents[0]._all_models.values()];
    const slider = models.find((one) => one.title === "speed (m/s)" && one.type.endsWith("Slider"));
    for (let at = 0; at < 1000; at++) slider.value = 0.5 + at * 0.001;
    slider.value = 1.25;
    """
    page.browser.execute_script(move)
    page.wait_for(row(ss.mean_stick_duration(ensemble(speed=1.25))))
    assert page.box("speed (m/s)") == "1.25"


def test_fifty_pages(page, served):
    """Opened at once; the one that is used does not wait for what the others show."""
    with ThreadPoolExecutor(8) as threads:
        answers = threads.map(lambda _: urllib.request.urlopen(served.address).status, range(50))
        assert set(answers) == {200}
    page.write("speed (m/s)", "1.35")
    page.wait_for(row(ss.mean_stick_duration(ensemble(speed=1.35))))


def test_newer_choice_overtakes_and_work_is_ended(browser, tmp_path):
    """Of programs that are not compiled yet: what is shown, a choice that overtakes, Cancel, and Ctrl-C meanwhile."""
    (tmp_path / "programs").mkdir(mode=0o700)
    one = Served(tmp_path, STICKSLIP_PROGRAMS=str(tmp_path / "programs"))
    resize(browser, 1280, 1400)
    browser.get(one.address)
    page, first = Page(browser), row(ss.mean_stick_duration(ensemble()))
    page.wait_for(first, 300)
    page.choose("System", "building on isolators")
    page.wait_for("Compiling, ")
    assert first.partition("\t")[2] not in page.text()
    assert is_marked_old(page)
    page.choose("System", "as given")
    page.wait_for(first, 10)  # known: the compilation is not waited for
    page.choose("System", "two blocks")
    page.wait_for("Compiling, ")
    page.click("Cancel")
    page.wait_for("Cancelled. Pale pictures and numbers are those of before.", 10)
    page.choose("System", "motor and cart")
    page.wait_for("Compiling, ")
    others = one.descendants()
    assert others
    code, said = one.interrupt(seconds=5)
    assert (code, said) == (0, "The explorer has ended.\n")
    time.sleep(2)
    assert [number for number in others if Path(f"/proc/{number}/cmdline").exists()
            and Path(f"/proc/{number}/cmdline").read_bytes()] == []  # fmt: skip


def test_page_takes_nothing_from_elsewhere(page, served):
    """Scripts, styles and fonts are those of this server."""
    names = page.browser.execute_script("return performance.getEntriesByType('resource').map((one) => one.name)")
    assert names
    assert {urlsplit(name).netloc for name in names if name.startswith("http")} == {urlsplit(served.address).netloc}


@pytest.mark.parametrize("path", ["", "autoload.js", "ws", "static/js/bokeh.min.js"])
def test_address_without_the_secret_is_unknown(served, path):
    place = urlsplit(served.address)
    for secret in ("", "x" * 32 + "/"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"http://{place.netloc}/{secret}{path}")


def test_another_origin_is_refused(served):
    """Even with the whole address and a session of the page, which another page cannot have."""
    from tornado.httpclient import HTTPClientError, HTTPRequest  # noqa: PLC0415
    from tornado.ioloop import IOLoop  # noqa: PLC0415
    from tornado.websocket import websocket_connect  # noqa: PLC0415

    place = urlsplit(served.address)
    body = html.unescape(urllib.request.urlopen(served.address).read().decode())
    (token,) = set(re.findall(r'"token":"([^"]+)"', body))

    def status(origin):
        async def connect():
            request = HTTPRequest(f"ws://{place.netloc}{place.path}ws", headers={"Origin": origin})
            try:
                connection = await websocket_connect(request, subprotocols=["bokeh", token])
            except HTTPClientError as error:
                return error.code
            connection.close()
            return 101

        return IOLoop().run_sync(connect)

    assert status(f"http://{place.netloc}") == 101
    for other in ("http://evil.example", "http://127.0.0.1:1", "http://localhost:" + str(place.port), "null"):
        assert status(other) == 403


def test_another_host_is_not_answered(served):
    """A name that was made to lead here, with the whole address; and no other page can hold this one in a frame."""
    place = urlsplit(served.address)
    for host in ("evil.example", f"evil.example:{place.port}", "localhost", "127.0.0.1.evil.example"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(urllib.request.Request(served.address, headers={"Host": host}))
    headers = urllib.request.urlopen(served.address).headers
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert (headers["X-Frame-Options"], headers["Referrer-Policy"]) == ("DENY", "no-referrer")


def test_only_this_machine_is_served(served):
    port = urlsplit(served.address).port
    with open("/proc/net/tcp", encoding="ascii") as table:
        listening = [line.split()[1] for line in table.readlines()[1:] if line.split()[3] == "0A"]
    assert [where for where in listening if int(where.rpartition(":")[2], 16) == port] == [f"0100007F:{port:04X}"]


def test_interrupt_ends_the_server(tmp_path):
    one = Served(tmp_path)
    code, said = one.interrupt()
    assert code == 0
    assert said.endswith("The explorer has ended.\n")
    assert "Traceback" not in said
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(one.address)


@pytest.mark.parametrize("seconds", [0.0, 0.5])
def test_terminated_server_says_so(tmp_path, seconds):
    """At once it is within a callback, which would swallow the exception."""
    one = Served(tmp_path)
    time.sleep(seconds)
    code, said = one.interrupt(signal.SIGTERM, 20)
    assert (code, said.splitlines()[-1]) == (143, "stickslip: Terminated; the explorer has ended.")


def test_closed_page_leaves_no_traceback(browser, tmp_path):
    """While its pictures and derivative are computed; what is computed for it then ends."""
    one = Served(tmp_path)
    browser.get(one.address)
    page = Page(browser)
    page.wait_for("mean stick duration", 300)
    page.write("speed (m/s)", "1.4")
    browser.get("about:blank")
    time.sleep(40)  # until the server forgets a page that has gone
    code, said = one.interrupt()
    assert (code, said.strip()) == (0, "The explorer has ended.")


def test_taken_port_is_told(served, tmp_path):
    port = urlsplit(served.address).port
    done = subprocess.run(
        [sys.executable, *START, "--port", str(port)], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert done.returncode == 1
    assert f"Port {port} cannot be used" in done.stderr
    assert done.stdout == ""


def test_latency_is_measured():
    """Not how long: that the tool sees means, pictures and derivative come."""
    tool = Path(__file__).parents[2] / "tools" / "explorer_latency.py"
    done = subprocess.run(
        [sys.executable, tool, "--moves", "1"], capture_output=True, text=True, check=True, timeout=300
    )
    assert re.findall(r"^(\w+) +\d+ ms, at most \d+ ms$", done.stdout, re.M) == ["means", "pictures", "derivative"]
