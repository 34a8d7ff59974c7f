"""Put the latest benchmark results into benchmarks/README.md: ``python -m benchmarks.table RESULTS.json``."""

import json
import platform
import sys
from importlib.metadata import version
from pathlib import Path

README = Path(__file__).with_name("README.md")
BEGIN, END = "<!-- table: written by `make bench` -->", "<!-- end of table -->"


def table(results: dict) -> str:
    """The results as a Markdown table, in the order they were measured."""
    cpu = results["machine_info"]["cpu"]
    machine = f"{cpu.get('brand_raw', 'unknown CPU')}, {cpu.get('count', '?')} cores"
    software = f"Python {platform.python_version()}, jax {version('jax')}"
    rounds = results["benchmarks"][0]["stats"]["rounds"]
    lines = [
        f"Measured on {results['datetime'][:10]}: {machine}; {software}. Medians of {rounds} rounds.",
        "",
        "| program | ns per base interval | times C by events | times C by intervals | compile, s |",
        "|---|---:|---:|---:|---:|",
    ]
    for entry in results["benchmarks"]:
        info = entry["extra_info"]
        seconds = f"{info['compile_seconds']:.1f}" if info.get("compile_seconds", 0) > 0.05 else ""
        ratios = f"{info['times_events']:,.2f} | {info['times_intervals']:,.2f}"
        lines.append(f"| {info['label']} | {info['ns_per_interval']:,.1f} | {ratios} | {seconds} |")
    return "\n".join(lines)


def main(path: str) -> None:
    """Replace what stands between the markers."""
    results = json.loads(Path(path).read_text())
    text = README.read_text()
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    README.write_text(f"{before}{BEGIN}\n{table(results)}\n{END}{after}")
    print(table(results))


if __name__ == "__main__":
    main(sys.argv[1])
