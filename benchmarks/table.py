"""Put the latest benchmark results into benchmarks/README.md: ``python -m benchmarks.table RESULTS.json``."""

import json
import platform
import sys
from importlib.metadata import version
from pathlib import Path

README = Path(__file__).with_name("README.md")
BEGIN, END = "<!-- table: written by `make bench` -->", "<!-- end of table -->"
BEGIN_CART, END_CART = "<!-- motor and cart: written by `make bench` -->", "<!-- end of motor and cart -->"
BEGIN_REGULARIZED, END_REGULARIZED = "<!-- regularised: written by `make bench` -->", "<!-- end of regularised -->"
BEGIN_SENSITIVITY, END_SENSITIVITY = "<!-- sensitivity: written by `make bench` -->", "<!-- end of sensitivity -->"


def heading(results: dict, rounds: int) -> str:
    """Where, when and how often it was measured."""
    cpu = results["machine_info"]["cpu"]
    machine = f"{cpu.get('brand_raw', 'unknown CPU')}, {cpu.get('count', '?')} cores"
    software = f"Python {platform.python_version()}, jax {version('jax')}"
    return f"Measured on {results['datetime'][:10]}: {machine}; {software}. Medians of {rounds} rounds."


def table(results: dict) -> str:
    """The interval engine's results as a Markdown table, in the order they were measured."""
    entries = [entry for entry in results["benchmarks"] if "ns_per_interval" in entry["extra_info"]]
    lines = [
        heading(results, entries[0]["stats"]["rounds"]),
        "",
        "| program | ns per base interval | times C by events | times C by intervals | compile, s |",
        "|---|---:|---:|---:|---:|",
    ]
    for info in (entry["extra_info"] for entry in entries):
        ratios = f"{info['times_events']:,.2f} | {info['times_intervals']:,.2f}"
        lines.append(f"| {info['label']} | {info['ns_per_interval']:,.1f} | {ratios} | {_compilation(info)} |")
    return "\n".join(lines)


def cart_table(results: dict) -> str:
    """The motor and cart's results as a Markdown table."""
    entries = [entry for entry in results["benchmarks"] if "us_per_second" in entry["extra_info"]]
    lines = [
        heading(results, entries[0]["stats"]["rounds"]),
        "",
        "| program | 20,000 runs, s | us per simulated second | speed, numba at 1e-4 s = 1 | compile, s | memory, GB |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for info in (entry["extra_info"] for entry in entries):
        memory = f"{info['memory_gb']:.2f}" if "memory_gb" in info else ""
        lines.append(
            f"| {info['label']} | {info['all_runs_s']:.2f} | {info['us_per_second']:.1f} | {info['speed']:.1f} | "
            f"{_compilation(info)} | {memory} |"
        )
    return "\n".join(lines)


def regularized_table(results: dict) -> str:
    """What regularised dynamics costs, as a Markdown table; of each kind the cheapest within 1 % is set in bold."""
    kinds = [
        entry["extra_info"]["regularized"] for entry in results["benchmarks"] if "regularized" in entry["extra_info"]
    ]
    lines = [
        heading(results, 3),
        "",
        "| method | error of the stick fraction | time of one trajectory | times the exact engine |",
        "|---|---:|---:|---:|",
    ]
    for rows in kinds:
        good = [row["trajectory_s"] for row in rows if row["error"] is not None and abs(row["error"]) <= 0.01]
        for row in rows:
            bold = "**" if row["trajectory_s"] == min(good, default=None) else ""
            error = "" if row["error"] is None else f"{100 * row['error']:+.2f} %"
            lines.append(
                f"| {bold}{row['label']}{bold} | {error} | {_time(row['trajectory_s'])} | {row['times']:,.0f} |"
            )
    return "\n".join(lines)


def sensitivity_table(results: dict) -> str:
    """What derivatives cost, as a Markdown table."""
    entries = [entry["extra_info"] for entry in results["benchmarks"] if "sensitivity" in entry["extra_info"]]
    lines = [
        heading(results, 5),
        "",
        "| program | time, s | times the value | relative standard error | time to an error of 1 %, s |",
        "|---|---:|---:|---:|---:|",
    ]
    for info in entries:
        error = f"{100 * info['relative_error']:.2f} % | {info['cost']:.2g}" if "cost" in info else " | "
        lines.append(f"| {info['sensitivity']} | {info['seconds']:.2f} | {info['times_value']:.1f} | {error} |")
    return "\n".join(lines)


def _time(seconds: float) -> str:
    return (
        f"{1e6 * seconds:,.1f} us"
        if seconds < 1e-3
        else f"{1e3 * seconds:,.1f} ms"
        if seconds < 1
        else f"{seconds:,.0f} s"
    )


def _compilation(info: dict) -> str:
    return f"{info['compile_seconds']:.1f}" if info.get("compile_seconds", 0) > 0.05 else ""


def main(path: str) -> None:
    """Replace what stands between the markers."""
    results = json.loads(Path(path).read_text())
    text = README.read_text()
    for begin, end, new in (
        (BEGIN, END, table(results)),
        (BEGIN_CART, END_CART, cart_table(results)),
        (BEGIN_REGULARIZED, END_REGULARIZED, regularized_table(results)),
        (BEGIN_SENSITIVITY, END_SENSITIVITY, sensitivity_table(results)),
    ):
        before, after = text.split(begin)[0], text.split(end)[1]
        text = f"{before}{begin}\n{new}\n{end}{after}"
        print(new, end="\n\n")
    README.write_text(text)


if __name__ == "__main__":
    main(sys.argv[1])
