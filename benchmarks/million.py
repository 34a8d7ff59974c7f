"""One million trajectories of the conference paper's study, with all their statistics: time and memory.

``python -m benchmarks.million``; with ``totals`` as an argument, the engine alone.
"""

import sys
from typing import Any

import jax

import stickslip_jax as ss
from stickslip_jax import papers

from .memory import largest_memory

jax.config.update("jax_enable_x64", True)
keep: Any = sys.argv[1] if len(sys.argv) > 1 else "statistics"
many = ss.simulate_ensemble(
    papers.belt_oscillator(),
    ss.PoissonSwitching(speed=1.0, rate=1.0),
    t1=200.0,
    samples=1_000_000,
    key=jax.random.key(0),
    y0=(0.0, 1.0),
    keep=keep,
)
print(many)
print(ss.mean_stick_duration(many))
if keep != "totals":
    print(many.summary())
    print(many.statistics.joint("duration", "position"))
print(f"largest memory: {largest_memory() / 1e9:.2f} GB")
