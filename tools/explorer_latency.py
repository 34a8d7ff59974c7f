"""How soon the explorer's page follows a slider: ``python tools/explorer_latency.py [--moves N]``; needs chromium.

The default study with 2,000 realisations, in a browser on this machine, which shares its processors with the server. Of
each press of an arrow key on the slider of the friction coefficient are measured, in the page's own clock, how many
milliseconds pass until the means of all realisations are new in the page, until all pictures are painted, and until the
new derivative is there. Printed are medians, and the slowest.
"""

import argparse
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.browser import missing, resize, started  # pyright: ignore[reportMissingImports]
from support.explorer import Page  # pyright: ignore[reportMissingImports]

SERVER = "import sys; from stickslip_jax._cli import main; sys.exit(main())"
SLIDER = "friction coefficient"
WAIT = 3.0  # s, after each move: until the derivative has come
PAINTED = 150.0  # ms after the means: by then all is painted, and what comes later belongs to the derivative
EVENTS = ("means", "pictures", "derivative")
WATCH = """
window.seen = [];
const note = (what) => window.seen.push([what, performance.now()]);
document.addEventListener("keydown", () => note("key"), true);
const clear = CanvasRenderingContext2D.prototype.clearRect;
CanvasRenderingContext2D.prototype.clearRect = function (...area) { note("canvas"); return clear.apply(this, area); };
window.watch = (host, what) => {
  let last = host.shadowRoot.textContent;
  const look = () => {
    const now = host.shadowRoot.textContent;
    if (now !== last) { last = now; note(what); }
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
};
"""


def times_of(seen: list[tuple[str, float]]) -> dict[str, float]:
    """Milliseconds from the key to each of `EVENTS`. Raises RuntimeError where one did not come."""
    at = {what: [time for name, time in seen if name == what] for what in ("key", "canvas", "means", "derivative")}
    if not all(at.values()):
        raise RuntimeError(f"The page showed nothing new of {', '.join(what for what in at if not at[what])}.")
    key, means = at["key"][0], at["means"][0]
    painted = max(time for time in at["canvas"] if time < means + PAINTED)
    return {"means": means - key, "pictures": painted - key, "derivative": at["derivative"][-1] - key}


def measured(browser: Any, address: str, moves: int) -> list[dict[str, float]]:
    """The times of so many moves, after two that compile what the first ones need."""
    browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": WATCH})
    resize(browser, 1400, 1200)
    browser.get(address)
    page = Page(browser)
    page.wait_for("Derivative of", 300)
    for name, css in (("means", ".statistics"), ("derivative", ".slope")):
        browser.execute_script("window.watch(arguments[0], arguments[1])", page.all(css)[0], name)
    found = []
    for number in range(moves + 2):
        browser.execute_script("window.seen = []")
        page.press(SLIDER, "ARROW_RIGHT")
        time.sleep(WAIT)
        if number >= 2:
            found.append(times_of(browser.execute_script("return window.seen")))
    return found


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--moves", type=int, default=15)
    chosen = options.parse_args()
    if told := missing():
        sys.exit(told)
    command = [sys.executable, "-u", "-c", SERVER, "explore", "--no-browser"]
    with (
        tempfile.TemporaryDirectory() as profile,
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server,
    ):
        assert server.stdout is not None
        browser = started(Path(profile))
        try:
            address = re.search(r"http://\S+", server.stdout.readline())
            if address is None:
                raise RuntimeError("The explorer did not start.")
            found = measured(browser, address[0], chosen.moves)
        finally:
            browser.quit()
            server.terminate()
    for what in EVENTS:
        of_it = [one[what] for one in found]
        print(f"{what:12}{statistics.median(of_it):5.0f} ms, at most {max(of_it):.0f} ms")


if __name__ == "__main__":
    main()
