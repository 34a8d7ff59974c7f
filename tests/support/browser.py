"""A browser for tests: chromium without a window, driven by Selenium, and files served to it from this machine."""

import importlib.util
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
           "--disable-background-networking", "--disable-component-update", "--disable-sync")  # fmt: skip


def missing() -> str | None:
    """What the tests need and this machine does not have, in a sentence that says what to do; None: nothing."""
    programs = [name for name in ("chromium", "chromedriver") if shutil.which(name) is None]
    if programs:
        return f"Browser tests need {' and '.join(programs)}: apt install chromium chromium-driver"
    if importlib.util.find_spec("selenium") is None:
        return "Browser tests need selenium, which the extra dev has: pip install -c constraints.txt -e '.[dev]'"
    return None


def started(profile: Path) -> Any:
    """Chromium, with the folder `profile` for its settings; downloads nothing. A webdriver: end it with ``quit()``."""
    from selenium import webdriver  # noqa: PLC0415 - tests are collected without it too
    from selenium.webdriver.chrome.service import Service  # noqa: PLC0415

    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for option in (*OPTIONS, f"--user-data-dir={profile}"):
        options.add_argument(option)
    return webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))


def resize(browser: Any, width: int, height: int = 900) -> None:
    """Give the page so many pixels, fewer than a window of chromium can have too."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format, *args):
        pass


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address, on this machine only, at which the files of `folder` are served meanwhile."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(folder))) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()
