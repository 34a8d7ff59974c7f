"""Put results into benchmarks/README.md: ``python -m benchmarks.table [RESULTS.json] [--into README.md]``."""

import argparse
import json
from pathlib import Path
from typing import Any

from . import marks
from .parts import PARTS

HERE = Path(__file__).parent


def tables(results: dict[str, Any]) -> dict[str, list[str]]:
    """The lines of every table that was measured, by its name, and of the marks."""
    found = {}
    for name, rows in results["parts"].items():
        part = PARTS[name]
        rounds = min(results["rounds"], getattr(part, "MOST", results["rounds"]))
        head = f"Measured on {results['date']}: {results['machine']}. Medians of {rounds} rounds."
        found[name] = [head, "", *part.table(rows)]
    if found.keys() >= marks.NEEDED:
        found["marks"] = marks.table(results["parts"])
    return found


def put(text: str, name: str, lines: list[str]) -> str:
    """`text` with new lines between the markers of that name."""
    begin, end = f"<!-- {name}: written by `make bench` -->", f"<!-- end of {name} -->"
    before, _, rest = text.partition(begin)
    _, found, after = rest.partition(end)
    if not found:
        raise ValueError(f"there is no place for the table {name!r}, which begins with {begin} and ends with {end}")
    return "\n".join([before + begin, *lines, end + after])


def main() -> None:
    """Replace what stands between the markers; tables that were not measured stay."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.table", description=__doc__)
    options.add_argument("results", type=Path, nargs="?", default=HERE / ".build" / "latest.json")
    options.add_argument("--into", type=Path, default=HERE / "README.md")
    chosen = options.parse_args()
    text = chosen.into.read_text()
    for name, lines in tables(json.loads(chosen.results.read_text())).items():
        text = put(text, name, lines)
        print("\n".join(lines), end="\n\n")
    chosen.into.write_text(text)


if __name__ == "__main__":
    main()
