"""The performance goals of this project beside what was measured."""

from typing import Any

from .parts import composed, intervals, motor_cart
from .setups import EVERY_STICK, OWN_ENGINES, STICK_TIME

ENGINE = "stickslip_jax, "
NEEDED = {"intervals", "composed", "motor cart", "sensitivity"}
"""The parts that the marks are read from."""


def table(parts: dict[str, list[dict[str, Any]]]) -> list[str]:
    """A row for each mark; the numbers are those of the other tables."""
    rows = {row["label"]: row for row in parts["intervals"]}
    vmapped = {row["label"]: row for row in parts["composed"]}
    one, two = rows[f"{ENGINE}totals, 1 thread"], rows[f"{ENGINE}totals, 2 threads"]
    on_two = [rows[label + intervals.TWO] for label in (intervals.EVENTS, intervals.INTERVALS)]
    c_gain = " and ".join(f"{1 / row['times_one_thread']:.2f}" for row in on_two)
    lines = ["| mark | asked | reached |", "|---|---:|---:|"]

    def add(what: str, asked: str, *reached: float) -> None:
        lines.append(f"| {what} | {asked} | {', '.join(f'{value:.2f}' for value in reached)} |")

    add("totals, one thread, times C by events", "2.0", one["times_events"])
    add("totals, one thread, times C by intervals", "1.5", one["times_intervals"])
    add("totals, two threads are faster by (the C programs)", c_gain, 1 / two["times_one_thread"])
    for name, asked in (("full statistics", "2.0"), ("every stick", "2.0"), ("totals, uncertain", "1.5")):
        both = [rows[f"{ENGINE}{name}, {threads}"]["times_totals"] for threads in composed.CORES]
        add(f"{name}, times totals; one and two threads", asked, *both)
    for program, asked in ((STICK_TIME, "1.5"), (EVERY_STICK, "3")):
        for engine in OWN_ENGINES:
            kinds = [vmapped[composed.label(engine, program, precision)] for precision in composed.PRECISIONS]
            reached = [row[threads]["times_totals"] for row in kinds for threads in composed.CORES]
            add(
                f"vmapped {engine}: {program}, times totals; float64, float32, each on one and two cores",
                asked,
                *reached,
            )
    for derivative in composed.DERIVATIVES:
        row = vmapped[composed.label(composed.CLOSED_FORM, derivative, "float64")]
        both = [row[threads]["times_value"] for threads in composed.CORES]
        add(f"vmapped {composed.CLOSED_FORM}: {derivative}, times the value; one and two cores", "3", *both)
    carts = {row["label"]: row["speed"] for row in parts["motor cart"]}
    both = [carts[f"{ENGINE}totals, {threads}"] for threads in composed.CORES]
    add(f"motor and cart, totals, times as fast as {motor_cart.BESIDE}; one and two threads", "10", *both)
    derivatives = {row["label"]: row for row in parts["sensitivity"]}
    for motion, error, cost in (
        ("", 2, 4),
        ("harmonic base of random phase: ", 2, 5),
        ("damped, Poisson switching: ", 2, 5),
    ):
        row = derivatives[f"{motion}corrected derivative"]
        reached = 100 * row["relative_error"], row["times_value"]
        add(
            f"{motion}corrected derivative, relative standard error in % and times the value",
            f"{error} and {cost}",
            *reached,
        )
    return lines
