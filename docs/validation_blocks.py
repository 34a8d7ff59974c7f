"""Rigid blocks that slide down a slope under recorded earthquakes, against SLAMMER: three minutes.

``python docs/validation_blocks.py FOLDER``, where FOLDER is a copy of github.com/pySLAMMER/pySLAMMER: its records, and
the displacements that SLAMMER and pySLAMMER found with them, are read from there. What this prints, and what it means,
is in ``validation.md``; ``tests/validation/test_blocks.py`` tests the functions of this file without these records.
"""

import csv
import gzip
import json
import math
import sys
from pathlib import Path
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

GRAVITY = 9.80665  # m/s^2, pySLAMMER's
PULL = GRAVITY / 2  # m/s^2: of gravity down a slope of 30 degrees
SOFT = 1e-12  # N/m: a spring that pulls by 1e-12 of the weight at most, in place of none
RECORDS, RESULTS = "src/pyslammer/sample_ground_motions", "tests/verification_data/results"
FINER = (1, 2, 4, 8)  # parts of each step of a record


def slide(times, accelerations, yields):
    """Where blocks of 1 kg rest at last, m down the slope, (blocks,); by this package.

    - `accelerations`: of the ground, up the slope, m/s^2 at `times` (s), (blocks, points): the block lags behind.
    - `yields`: above which the block slides down, m/s^2, (blocks,). Uphill it needs ``2 PULL`` more.
    """

    @jax.jit
    @jax.vmap
    def last(acceleration, above):
        block = ss.MassSpring(1.0, SOFT, 1.0, ss.Coulomb(above + PULL), force=ss.Harmonic(0.0, 1e-6, offset=PULL))
        ground = ss.GroundAcceleration(times, -acceleration)  # positions are counted down the slope
        method = ss.Exact(solver=diffrax.Dopri8())  # whose slips are cubic in time: exact
        one = ss.simulate(block, ground, t1=float(times[-1]), y0=(0.0, 0.0), method=method)
        return jnp.where(one.status == ss.Status.FINISHED, one.final_state[0], jnp.nan)

    return np.asarray(last(jnp.asarray(accelerations), jnp.asarray(yields)))


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

    Where a block starts or stops in a step, the rule takes the step as it comes: an error of first order.
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
    step = times[1] - times[0]  # some records lack lines: pySLAMMER goes by this step
    return step * np.arange(len(times)), accelerations / np.max(np.abs(accelerations))


def published(path):
    """The cases of a file of results: record, yield and largest acceleration (g), displacement both ways (cm)."""
    with gzip.open(path, "rt", encoding="utf-8") as file:
        cases = [case for case in json.load(file)["analyses"] if case["analysis"]["method"] == "rigid"]
    found: dict[tuple[Any, ...], tuple[float, float]] = {}
    for case in cases:
        motion, results = case["ground_motion_parameters"], case["results"]
        key = motion["ground_motion_file"], case["site_parameters"]["ky_g"], motion["target_pga_g"]
        found[key] = results["normal_displacement_cm"], results["inverse_displacement_cm"]
    return found


def compare(folder):
    slammer = published(folder / RESULTS / "slammer_results.json.gz")
    python = published(folder / RESULTS / "pyslammer_0.2.3_results.json.gz")
    columns = ("slammer", "python", "ours", "events", *FINER)
    rows = []
    for name in dict.fromkeys(key[0] for key in slammer):
        times, shape = record(folder / RECORDS / name)
        keys = [key for key in slammer if key[0] == name]
        yields = np.repeat([GRAVITY * above for _, above, _ in keys], 2)
        ground = np.array([sign * GRAVITY * largest * shape for *_, largest in keys for sign in (1, -1)])
        both = [[value for key in keys for value in results[key]] for results in (slammer, python)]
        ours = slide(times, ground, yields)
        events = [slide_by_events(times, a, above)[-1] for a, above in zip(ground, yields, strict=True)]
        steps = [slide_by_steps(times, ground, yields, parts) for parts in FINER]
        rows.append(np.array([*both, 100 * ours, 100 * np.array(events), *(100 * x for x in steps)]))
        print(name,times[1], np.abs(rows[-1]-rows[-1][2]).max(1), flush=True)
    return dict(zip(columns, np.concatenate(rows, axis=1), strict=True)), [k for k in slammer]


if __name__ == "__main__":
    import time
    t0=time.time()
    r,k=compare(Path(sys.argv[1]))
    np.savez('/tmp/blocks.npz',**{str(a):b for a,b in r.items()})
    print(time.time()-t0)
