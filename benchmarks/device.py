"""Times on the device that JAX finds: ``python -m benchmarks.device [--tiny] [--rounds 5] [--into README.md]``.

One row for each case and device; rows of other devices stay (docs/devices.md).
"""

import argparse
import datetime
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

import stickslip_jax as ss

from .rounds import Program, Rounds, here
from .setups import BELT, INTERVALS, LAW, START, T1, TWO_BLOCKS, system
from .table import put

HERE = Path(__file__).parent
HEAD = ("| device | case | samples | ns | first call, s | date |", "|---|---|---:|---:|---:|---|")


def cases(tiny: bool) -> dict[str, tuple[int, Callable[[int], float]]]:
    """By name: the samples, and what simulates them and returns the work done; more samples on another device."""
    is_cpu = jax.devices()[0].platform == "cpu"
    many, few = (64, 32) if tiny else (16_384, 1_024) if is_cpu else (1_048_576, 65_536)
    cart, anywhere = ss.MotorCart(mu=0.3), (ss.Uniform(-1.0, 1.0), ss.Uniform(-1.0, 1.0), 0.0, 0.0)

    def ensemble(keep: ss.Keep, samples: int, number: int) -> float:
        key = jax.random.key(number)
        ss.simulate_ensemble(system(), LAW, t1=T1, samples=samples, key=key, y0=START, keep=keep, progress=False)
        return samples * INTERVALS

    def stepped(model: Any, law: Any, y0: Any, t1: float, samples: int, number: int) -> float:
        key = jax.random.key(number)
        ss.simulate_ensemble(model, law, t1=t1, samples=samples, key=key, y0=y0, keep="totals", progress=False)
        return samples * t1

    def sensitivity(samples: int, number: int) -> float:
        key, statistic = jax.random.key(number), ss.mean_stick_duration
        ss.sensitivity(statistic, system(0.9), LAW, wrt="mu", t1=T1, samples=samples, key=key, y0=START)
        return samples * INTERVALS

    @partial(jax.jit, static_argnums=1)
    def vmapped(key: jax.Array, samples: int) -> jax.Array:
        def one(key: jax.Array) -> jax.Array:
            return ss.simulate(system(), LAW.sample(key, T1), t1=T1, y0=START).stick_time

        return jnp.mean(jax.vmap(one)(jax.random.split(key, samples)))

    def composed(samples: int, number: int) -> float:
        vmapped(jax.random.key(number), samples).block_until_ready()
        return samples * INTERVALS

    voltage = ss.RandomPhase(ss.SourceVoltage(mean=1.0, amplitude=0.5, angular_frequency=10.0))
    found: dict[str, tuple[int, Callable[[int], float]]] = {
        f"{keep}, of an interval": (many, partial(ensemble, keep, many)) for keep in ("totals", "statistics", "sticks")
    }
    return found | {
        "sensitivity, of an interval": (many, partial(sensitivity, many)),
        "vmap of simulate, of an interval": (many, partial(composed, many)),
        "motor and cart, of a second": (few, partial(stepped, cart, voltage, None, 0.2 if tiny else 2.0, few)),
        "two blocks, of a second": (
            few,
            partial(stepped, TWO_BLOCKS.of_contact(0), BELT, anywhere, 5.0 if tiny else 50.0, few),
        ),
    }


def main() -> None:
    """Time all cases, and put their rows into the table."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.device", description=__doc__)
    options.add_argument("--rounds", type=int, default=5, help="how often each case is timed")
    options.add_argument("--tiny", action="store_true", help="as little work as possible: shows that everything runs")
    options.add_argument("--into", type=Path, default=HERE / "README.md")
    chosen = options.parse_args()
    jax.config.update("jax_enable_x64", True)
    asked = os.environ.get("STICKSLIP_LANES")
    device = jax.devices()[0].device_kind + (f", STICKSLIP_LANES={asked}" if asked else "")
    programs, samples = [], {}
    for name, (number, run) in cases(chosen.tiny).items():
        started = time.perf_counter()
        run(0)
        programs.append(Program(name, here(run), time.perf_counter() - started))
        samples[name] = number
    rounds, today = Rounds(programs, chosen.rounds), datetime.datetime.now(datetime.UTC).date().isoformat()
    rows = []
    for one in programs:
        each, first = 1e9 * rounds.each(one.label), f"{one.compile_seconds:.1f}"
        rows.append(f"| {device} | {one.label} | {samples[one.label]:,} | {each:.3g} | {first} | {today} |")
    text = chosen.into.read_text()
    before = text.partition("<!-- device: written by")[2].partition("<!-- end of device -->")[0].splitlines()
    others = [row for row in before if row.startswith("| ") and row not in HEAD and not row.startswith(f"| {device} |")]
    print("\n".join(rows))
    chosen.into.write_text(put(text, "device", [*HEAD, *others, *rows]))


if __name__ == "__main__":
    main()
