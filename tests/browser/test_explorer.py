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

    def __init__(self, folder, *options):
        (folder / "study.toml").write_text(CONFIG, encoding="utf-8")
        command = [sys.executable, *START, "study.toml", "--samples", str(SAMPLES), *options]
        self.process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )  # fmt: skip
        line = self.process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+/\S+", line)
        assert found, line + self.process.stdout.read()
        self.address = found[0]

    def interrupt(self):
        """Ctrl-C. The exit code, and what was printed since."""
        self.process.send_signal(signal.SIGINT)
        said, _ = self.process.communicate(timeout=60)
        return self.process.returncode, said


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
    page.wait_for("mean stick duration")
    return page


def row(statistic):
    return f"{statistic.name}\t{statistic.without_name().replace('+-', '±')}"


def ensemble(mu=0.8, speed=0.9, rate=1.0, mass=1.0):
    system = ss.MassSpring(mass, 4.0, 1.0, ss.Coulomb(mu))
    law = ss.PoissonSwitching(speed, rate)
    return ss.simulate_ensemble(
        system, law, t1=T1, samples=SAMPLES, key=jax.random.key(0), y0=Y0, keep="sticks", progress=False
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
    page.wait_for(str(slope).replace("+-", "±"))


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
    page.wait_for("d / d system.mass of mean stick duration")


def test_bad_input_in_a_box(page):
    before = page.table()
    for text, why in (
        ("fast", "'fast' is not a number; write one such as 0.25 or 1e-3."),
        ("-1", "Argument law.speed must be positive (in m/s), but -1.0 was given."),
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
    page.wait_for("From one start at each value, after 100 periods.")


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


@pytest.mark.parametrize("width", [390, 1280])
def test_everything_fits_into_the_width(page, width):
    resize(page.browser, width, 900)
    time.sleep(1)
    assert page.browser.execute_script("return document.documentElement.scrollWidth") <= width
    for one in page.all("canvas"):
        box = one.rect
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width


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
