"""Check the built site in a browser: ``python tools/site_check.py results/docs``; needs chromium.

On every page no block of code or output, folded ones too, may be wider than its column in a window of 1,400 pixels,
and the page itself not wider than a phone's window of 390. Nothing may be loaded from the net. The search must find
what users look for.
"""

import argparse
import html
import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
WIDE, NARROW = 1400, 390  # pixels
LOADED = re.compile(
    r"<(?:script|img|link|iframe|source|audio|video)\b[^>]*?\b(?:src|href)=[\"']((?:https?:)?//[^\"']+)", re.I
)
STYLED = re.compile(r"(?:@import\s+|url\()\s*[\"']?((?:https?:)?//[^\"')]+)", re.I)
SEARCHED = {
    "animation": "animation",
    "bifurcation": "nonlinear",
    "explorer": "explore",
    "lugre": "friction_memory",
    "poincare": "nonlinear",
    "posterior": "posteriors",
    "two contacts": "contacts",
}
"""Words, and the page that must be among those found."""

MEASURE = """
<script>
window.addEventListener("load", () => setTimeout(async () => {
  const pages = PAGES, found = [];
  for (const page of pages) {
    const frame = document.createElement("iframe");
    frame.style.cssText = "border:0;width:WIDTHpx;height:2000px";
    const loaded = new Promise(done => { frame.onload = done; });
    frame.src = page;
    document.body.append(frame);
    await loaded;
    const inside = frame.contentDocument;
    inside.querySelectorAll("details").forEach(folded => { folded.open = true; });
    const blocks = [...inside.querySelectorAll("pre")].filter(block => block.clientWidth > 0);
    const cut = blocks.filter(block => block.scrollWidth > block.clientWidth + 1);
    found.push({page, blocks: blocks.length, width: inside.documentElement.scrollWidth,
                cut: cut.map(block => [block.scrollWidth, block.clientWidth,
                                       block.textContent.split("\\n").sort((a, b) => b.length - a.length)[0]])});
    frame.remove();
  }
  const told = document.createElement("div");
  told.id = "told";
  told.textContent = JSON.stringify(found);
  document.body.append(told);
}, 0));
</script>
"""


def browse(browser: str, address: str, milliseconds: int) -> str:
    """The page at this address after its scripts have run for so long, as HTML."""
    with tempfile.TemporaryDirectory() as profile:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files", "--hide-scrollbars"]
        options += [f"--user-data-dir={profile}", f"--virtual-time-budget={milliseconds}", "--dump-dom"]
        done = subprocess.run([browser, *options, address], capture_output=True, text=True, timeout=900, check=True)
    return done.stdout


def measured(browser: str, site: Path, pages: list[Path], width: int) -> list[dict[str, Any]]:
    """Of each page its width in a window of this width, and the blocks that are wider than their columns."""
    with tempfile.NamedTemporaryFile("w", suffix=".html", dir=site, encoding="utf-8") as frame:
        names = json.dumps([str(page.relative_to(site)) for page in pages])
        frame.write("<!doctype html><body>" + MEASURE.replace("PAGES", names).replace("WIDTH", str(width)))
        frame.flush()
        shown = browse(browser, f"file://{frame.name}", 3000 * len(pages))
    told = re.search(r'<div id="told">(.*?)</div>', shown, re.DOTALL)
    if told is None:
        raise RuntimeError(f"The browser did not measure the pages at {width} pixels.")
    return json.loads(html.unescape(told[1]))


def loaded_from_the_net(site: Path) -> list[str]:
    """What pages and styles load from other addresses than the site's own."""
    pages = [(file, LOADED) for file in site.rglob("*.html")]
    styles = [(file, STYLED) for file in [*site.rglob("*.css"), *site.rglob("*.html")]]
    texts = ((file, pattern, file.read_text("utf-8", "replace")) for file, pattern in (*pages, *styles))
    return [
        f"{file.relative_to(site)}: loads {found}" for file, pattern, text in texts for found in pattern.findall(text)
    ]


def not_found(browser: str, site: Path) -> list[str]:
    """The words whose search does not show the page that it should."""
    missing = []
    for words, page in SEARCHED.items():
        shown = browse(browser, f"file://{site}/search.html?q={words.replace(' ', '+')}", 20_000)
        results = shown.partition('id="search-results"')[2]
        if f"{page}.html" not in results:
            missing.append(f"search: {words!r} does not find {page}.html")
    return missing


def main() -> None:
    """Print what is wrong, and end with status 1 if anything is."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("site", type=Path, help="folder of the built site")
    site = options.parse_args().site.resolve()
    wrong = loaded_from_the_net(site)
    browser = next((name for name in BROWSERS if shutil.which(name)), None)
    if browser is None:
        sys.exit("\n".join([*wrong, f"There is no browser; install one of {', '.join(BROWSERS)}."]))
    pages = sorted(
        page for page in site.rglob("*.html") if "_modules" not in page.parts and "_static" not in page.parts
    )
    wide, narrow = (measured(browser, site, pages, width) for width in (WIDE, NARROW))
    for one in wide:
        wrong += [f"{one['page']}: {needs} px in a column of {has}: {line}" for needs, has, line in one["cut"]]
    wrong += [
        f"{one['page']}: {one['width']} px wide in a window of {NARROW}" for one in narrow if one["width"] > NARROW
    ]
    wrong += not_found(browser, site)
    print(
        "\n".join(wrong) or f"{len(pages)} pages, {sum(one['blocks'] for one in wide)} blocks: none is cut at {WIDE} px"
    )
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
