"""Draw docs/sweeps_cost.png: time and memory of a parameter sweep against its points and its samples.

``make bench ONLY=sweeps`` first, then ``python docs/sweeps_figure.py``.
"""

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

HERE = Path(__file__).parent
RESULTS = HERE.parent / "benchmarks" / ".build" / "latest.json"
FIXED = {"points": ("samples", 2_500), "samples": ("points", 16)}


def draw(rows: list[dict[str, Any]]) -> plt.Figure:
    """Time and memory against points and samples; dashed: proportional to the last."""
    figure, axes = plt.subplots(2, 2, figsize=(8, 5), sharex="col", sharey="row", layout="constrained")
    for (varied, (held, value)), column in zip(FIXED.items(), axes.T, strict=True):
        chosen = [row for row in rows if row["program"] == "sweep" and row["keep"] == "totals" and row[held] == value]
        chosen.sort(key=lambda row: row[varied])
        x = np.array([row[varied] for row in chosen]) / (1 if varied == "points" else 1000)
        seconds, memory = (np.array([row[name] for row in chosen]) for name in ("seconds", "memory"))
        slope = (seconds[-1] - seconds[0]) / (x[-1] - x[0])
        column[0].plot(x, seconds, "o-", label="sweep, with compilation")
        column[0].plot(x, seconds[0] + slope * (x - x[0]), "k--", linewidth=0.8, label="straight line through the ends")
        column[1].plot(x, memory / 1e9, "o-")
        column[0].set_title(f"{value:,} {held}" + (" at each point" if held == "samples" else ""))
        column[1].set_xlabel("points" if varied == "points" else "thousand samples at each point")
    axes[0, 0].set_ylabel("time (s)")
    axes[1, 0].set_ylabel("largest memory (GB)")
    axes[1, 0].set_ylim(0, 1.3 * max(row["memory"] for row in rows if row["keep"] == "totals") / 1e9)
    axes[0, 0].set_ylim(bottom=0)
    axes[0, 0].legend()
    return figure


if __name__ == "__main__":
    draw(json.loads(RESULTS.read_text())["parts"]["sweeps"]).savefig(HERE / "sweeps_cost.png", dpi=120)
