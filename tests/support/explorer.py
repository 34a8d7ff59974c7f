"""The explorer's page in a browser: its controls by their labels, through the shadow trees in which they are."""

import time
from collections.abc import Callable
from typing import Any

_WALK = """
const found = [];
const walk = (root) => {
  for (const one of root.querySelectorAll("*")) {
    if (one.matches(arguments[0])) found.push(one);
    if (one.shadowRoot) walk(one.shadowRoot);
  }
};
walk(document);
return found;
"""
_TEXT = """
const found = [];
const walk = (root) => {
  for (const one of root.childNodes) {
    if (one.nodeType === Node.TEXT_NODE && one.textContent.trim()) found.push(one.textContent);
    if (one.tagName === "STYLE" || one.tagName === "SCRIPT") continue;
    if (one.shadowRoot) walk(one.shadowRoot);
    walk(one);
  }
};
walk(document.body);
return found.join(" ").replace(/\\s+/g, " ");
"""
_TABLES = """
const found = [];
const walk = (root) => {
  for (const one of root.querySelectorAll("*")) {
    if (one.tagName === "TABLE") found.push(one);
    if (one.shadowRoot) walk(one.shadowRoot);
  }
};
walk(document);
const cells = (row) => [...row.cells].map((cell) => cell.textContent.trim()).join("\\t");
return found.map((table) => [...table.rows].map(cells).join("\\n")).join("\\n");
"""


class Page:
    """What a reader sees and does."""

    def __init__(self, browser: Any):
        self.browser = browser

    def all(self, css: str) -> list[Any]:
        """All elements that match."""
        return self.browser.execute_script(_WALK, css)

    def text(self) -> str:
        """All text of the page, and of its table."""
        return self.browser.execute_script(_TEXT) + "\n" + self.table()

    def table(self) -> str:
        """The text of the table of statistics, tabs between cells."""
        # In one script: a table is replaced whenever its numbers change.
        return self.browser.execute_script(_TABLES)

    def wait_for(self, text: str, seconds: float = 60.0) -> None:
        """Wait until the page says this. Raises AssertionError if it does not."""
        self._wait(lambda: text in self.text(), f"{text!r} is not there", seconds)

    def _wait(self, holds: Callable[[], bool], problem: str, seconds: float = 60.0) -> None:
        end = time.monotonic() + seconds
        while not holds():
            assert time.monotonic() < end, f"{problem}: {self.text()}"
            time.sleep(0.2)

    def box(self, label: str) -> str:
        """What stands in the box of a number."""
        return self._row(label)[1].get_property("value")

    def write(self, label: str, text: str) -> None:
        """Write into the box of a number, and press Enter."""
        from selenium.webdriver.common.keys import Keys  # noqa: PLC0415

        box = self._row(label)[1]
        box.send_keys(Keys.END, Keys.BACKSPACE * len(box.get_property("value")), text, Keys.ENTER)

    def press(self, label: str, key: str, times: int = 1) -> None:
        """Press a key while the slider of a number has the focus."""
        from selenium.webdriver.common.keys import Keys  # noqa: PLC0415

        before = self.box(label)
        for _ in range(times):
            self._row(label)[0].send_keys(getattr(Keys, key))
        self._wait(lambda: self.box(label) != before, f"the box of {label} stays at {before}")

    def choose(self, label: str, option: str) -> None:
        """Choose from a list."""
        from selenium.webdriver.support.ui import Select  # noqa: PLC0415

        lists = {self._label_of(one): one for one in self.all("select")}
        Select(lists[label]).select_by_visible_text(option)

    def click(self, text: str) -> None:
        """Click a button or a tab."""
        (one, *_) = [one for one in self.all("button, .bk-tab") if one.text.strip() == text]
        one.click()

    def _row(self, label: str) -> tuple[Any, Any]:
        """Handle and box of a number."""
        script = """
        const titles = [];
        const walk = (root) => {
          for (const one of root.querySelectorAll("*")) {
            if (one.matches(".bk-slider-title")) titles.push(one);
            if (one.shadowRoot) walk(one.shadowRoot);
          }
        };
        walk(document);
        const title = titles.find((one) => one.textContent.replace(/:\\s*$/, "").trim() === arguments[0]);
        const slider = title.getRootNode();
        const box = slider.host.nextElementSibling.shadowRoot.querySelector("input");
        return [slider.querySelector(".noUi-handle"), box];
        """
        handle, box = self.browser.execute_script(script, label)
        return handle, box

    def _label_of(self, element: Any) -> str:
        script = "return arguments[0].getRootNode().querySelector('label').textContent.trim()"
        return self.browser.execute_script(script, element)
