"""Rigid blocks that slide down a slope under recorded earthquakes, against SLAMMER: four minutes.

``python docs/validation_blocks.py FOLDER``, where FOLDER is a copy of github.com/pySLAMMER/pySLAMMER: its records, and
the displacements that SLAMMER and pySLAMMER found with them, are read from there. With a second folder, a copy of
github.com/GeorgePapazafeiropoulos/OpenSeismoMatlab, sliding spectra of two of its records are printed too. What this
prints, and what it means, is in ``validation.md``; ``tests/validation/test_blocks.py`` tests the functions of this file
without these records.
"""

import csv
import gzip
import json
import math
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

GRAVITY = 9.80665  # m/s^2, pySLAMMER's
PULL = GRAVITY / 2  # m/s^2: of gravity down a slope of 30 degrees
RECORDS, RESULTS = "src/pyslammer/sample_ground_motions", "tests/verification_data/results"
PUBLISHED = {"SLAMMER 1.1": "slammer_results.json.gz", "pySLAMMER 0.2.3": "pyslammer_0.2.3_results.json.gz"}
OURS = "ours"
NEGLIGIBLE = 0.5  # cm: pySLAMMER's threshold of small displacements
SPECTRA = {  # of OpenSeismoMatlab: largest displacements (m) by friction coefficient, read from its figures by eye
    "Northridge_Sylmar_County": {0.05: 0.78, 0.1: 0.294, 0.15: 0.216, 0.3: 0.051, 0.4: 0.030, 0.7: 0.003},
    "elcentro_NS_trunc": {0.002: 0.226, 0.01: 0.208, 0.05: 0.086, 0.1: 0.047, 0.15: 0.0105, 0.3: 0.0015},
}
FINER = (1, 2, 4, 8)  # parts into which the trapezoidal rule cuts each step of a record


def slide(times, accelerations, yields, pull=PULL):
    """Positions of blocks of 1 kg at `times` (s), m down the slope, (blocks, points); by this package.

    - `accelerations`: of the ground, up the slope, m/s^2, (blocks, points): the block lags behind.
    - `yields`: above which the block slides down, m/s^2, (blocks,). Uphill it needs ``2 pull`` more.
    - `pull`: of gravity down the slope, m/s^2, (blocks,) or one for all; 0 on level ground.
    """

    @jax.jit
    @jax.vmap
    def positions(acceleration, above, pull):
        block = ss.MassSpring(1.0, 0.0, 1.0, ss.Coulomb(above + pull), force=ss.Harmonic(0.0, 1e-6, offset=pull))
        ground = ss.GroundAcceleration(times, -acceleration)  # positions are counted down the slope
        one = ss.simulate(block, ground, t1=float(times[-1]), y0=(0.0, 0.0))
        return jnp.where(one.status == ss.Status.FINISHED, one.evaluate(times)[0], jnp.nan)

    return np.asarray(positions(*map(jnp.asarray, (accelerations, yields, np.broadcast_to(pull, len(yields))))))


def slide_by_events(times, acceleration, above, back=math.inf):
    """The same of one block, without this package, event by event: positions at `times`, m, (points,).

    While the block slides, the relative velocity is a parabola in each step of the record. `back`: above which the
    block slides the other way, m/s^2.
    """
    x = v = 0.0
    positions = [x]
    for step, start, end in zip(np.diff(times), acceleration[:-1], acceleration[1:], strict=True):
        t, slope = 0.0, (end - start) / step
        while t < step:
            now, resists = start + slope * t, above if v > 0 else -back
            if v == 0:
                resists = above if slope > 0 else -back
                if now > above or now < -back:
                    resists = above if now > 0 else -back
                elif slope == 0 or t + (resists - now) / slope >= step:
                    break  # rests to the end of the step
                else:
                    t += (resists - now) / slope
                    now = resists
            lasts = min(_first_zero(v, now - resists, slope), step - t)
            stops = lasts < step - t
            x += lasts * (v + lasts * ((now - resists) / 2 + lasts * slope / 6))
            v = 0.0 if stops else v + lasts * (now - resists + lasts * slope / 2)
            t = t + lasts if stops else step
        positions.append(x)
    return np.array(positions)


def _first_zero(v, drive, slope):
    """The first time after 0 at which ``v + drive t + slope t^2 / 2`` is zero."""
    if v == 0:
        return -2 * drive / slope if drive * slope < 0 else math.inf
    discriminant = drive * drive - 2 * slope * v
    if discriminant < 0:
        return math.inf
    q = -(drive + math.copysign(math.sqrt(discriminant), drive))
    return min((t for t in (q / slope if slope else 0.0, 2 * v / q if q else 0.0) if t > 0), default=math.inf)


def slide_by_steps(times, accelerations, yields, parts=1):
    """The same of blocks, (blocks,), by the trapezoidal rule of pySLAMMER, with every step cut into `parts`.

    Where a block starts or stops inside a step, the rule does not look for the instant.
    """
    finer = np.interp(np.arange((len(times) - 1) * parts + 1) / parts, np.arange(len(times)), times)
    ground = np.stack([np.interp(finer, times, row) for row in accelerations], axis=1)
    half = (times[1] - times[0]) / parts / 2
    x, v, drive = np.zeros((3, len(yields)))
    for a in ground:
        rests = (v < 1e-5) & (np.abs(a) <= yields)
        new = np.where(rests, 0.0, a - np.where((v < 1e-5) & (a < 0), -yields, yields))
        faster = v + half * (new + drive)
        slides = faster > 0
        x = x + np.where(slides, half * (faster + v), 0.0)
        v, drive = np.where(slides, faster, 0.0), np.where(slides, new, 0.0)
    return x


def record(path):
    """Times (s) and accelerations (in units of the largest), (points,), of a record of pySLAMMER."""
    with path.open(encoding="utf-8-sig") as file:
        rows = [[float(entry) for entry in row[:2]] for row in csv.reader(file) if row and not row[0].startswith("#")]
    times, accelerations = np.array(rows).T
    return times, accelerations / np.max(np.abs(accelerations))


def published(path):
    """The rigid blocks of a file of results: both displacements (cm) by record, yield and largest acceleration (g)."""
    with gzip.open(path, "rt", encoding="utf-8") as file:
        cases = [case for case in json.load(file)["analyses"] if case["analysis"]["method"] == "rigid"]
    found: dict[tuple[Any, ...], tuple[float, float]] = {}
    for case in cases:
        motion, results = case["ground_motion_parameters"], case["results"]
        key = motion["ground_motion_file"], case["site_parameters"]["ky_g"], motion["target_pga_g"]
        found[key] = results["normal_displacement_cm"], results["inverse_displacement_cm"]
    return found


def displacements(folder):
    """Displacements in cm, (blocks,), by who found them; and yield and largest acceleration (g) of the blocks."""
    theirs = {name: published(folder / RESULTS / file) for name, file in PUBLISHED.items()}
    rows, pairs = [], []
    keys = list(next(iter(theirs.values())))
    for name in dict.fromkeys(key[0] for key in keys):
        times, shape = record(folder / RECORDS / name)
        here = [key for key in keys if key[0] == name]
        yields = np.repeat([GRAVITY * above for _, above, _ in here], 2)
        ground = np.array([sign * GRAVITY * largest * shape for *_, largest in here for sign in (1, -1)])
        events = [slide_by_events(times, a, above)[-1] for a, above in zip(ground, yields, strict=True)]
        steps = [slide_by_steps(times, ground, yields, parts) for parts in FINER]
        found = [[value for key in here for value in results[key]] for results in theirs.values()]
        rows.append([*found, *(100 * np.array([slide(times, ground, yields)[:, -1], events, *steps]))])
        pairs += [key[1:] for key in here for _ in range(2)]
    names = [*theirs, OURS, "event by event, no package", *(f"trapezoidal rule, steps / {n}" for n in FINER)]
    return dict(zip(names, np.concatenate(rows, axis=1), strict=True)), np.array(pairs)


def main(folder):
    found, pairs = displacements(folder)
    ours = found[OURS]
    large = ours > NEGLIGIBLE
    print(f"{len(ours)} displacements, {np.sum(large)} of them above {NEGLIGIBLE} cm; cm")
    print(f"  {'from ours':27}   at most   of those above: at most   median")
    for name, values in found.items():
        if name != OURS:
            apart = np.abs(values - ours)
            share = apart[large] / ours[large]
            print(f"  {name:27} {np.max(apart):9.1e} {np.max(share):25.1e} {np.median(share):8.1e}")
    print("The largest of each pair of yield and largest acceleration, cm")
    print("  yield/g   largest/g   SLAMMER   pySLAMMER      ours")
    for pair in dict.fromkeys(map(tuple, pairs.tolist())):
        best = np.argmax(np.where(np.all(pairs == pair, axis=1), ours, -1))
        slammer, python, here = (found[name][best] for name in (*PUBLISHED, OURS))
        print(f"  {pair[0]:7.2f} {pair[1]:11.2f} {slammer:9.3f} {python:11.3f} {here:9.3f}")
    slammer, python = (found[name] for name in PUBLISHED)
    for name, values in (("pySLAMMER's", python), ("Ours", ours)):
        allowed = np.where(slammer > NEGLIGIBLE, 0.02 * slammer, 0.05)
        near = np.sum(np.abs(values - slammer) <= allowed)
        print(f"{name} within 2 % of SLAMMER's, below {NEGLIGIBLE} cm within 0.05 cm: {near}")
    rule = found["trapezoidal rule, steps / 1"]
    print(f"The trapezoidal rule here and pySLAMMER: at most {np.max(np.abs(rule - python)):.0e} cm apart")


def sliding_spectra(folder):
    """Blocks on level ground under two records, with the displacements in the figures of OpenSeismoMatlab."""
    print("Largest displacements on level ground, m\n  friction   in the figure    ours   event by event")
    for name, read in SPECTRA.items():
        times, ground = np.loadtxt(folder / "lib/input" / f"{name}.dat", unpack=True)
        finer = np.linspace(times[0], times[-1], 4 * (len(times) - 1) + 1)
        ground = np.interp(finer, times, ground)
        yields = 9.81 * np.array(list(read))
        ours = slide(finer, np.broadcast_to(ground, (len(yields), len(ground))), yields, 0.0)
        print(name)
        for mu, above, positions in zip(read, yields, ours, strict=True):
            events = np.max(np.abs(slide_by_events(finer, ground, above, above)))
            print(f"  {mu:8} {read[mu]:15} {np.max(np.abs(positions)):7.4f} {events:16.4f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
    if len(sys.argv) > 2:
        sliding_spectra(Path(sys.argv[2]))
