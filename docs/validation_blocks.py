"""Blocks that slide down a slope under recorded earthquakes, against SLAMMER: rigid ones in four minutes.

``python docs/validation_blocks.py FOLDER``, where FOLDER is a copy of github.com/pySLAMMER/pySLAMMER: its records, and
the displacements that SLAMMER and pySLAMMER found with them, are read from there. ``python docs/validation_blocks.py
FOLDER coupled`` (or ``decoupled``) prints those of blocks of soil that vibrates, and with a number n after that every
n-th set of numbers. With a second folder, a copy of github.com/GeorgePapazafeiropoulos/OpenSeismoMatlab, sliding
spectra of two of its records are printed too. What this prints, and what it means, is in ``validation.md``;
``tests/validation/test_blocks.py`` and ``tests/systems/test_sliding_blocks.py`` test the functions of this file without
these records.
"""

import csv
import gzip
import itertools
import json
import math
import sys
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

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


FIRST_L, FIRST_M = 2 / math.pi, 1 / 2  # of the first mode of a column that shears, over its mass


def slide_coupled_by_events(times, acceleration, above, period, damping, cuts=4):
    """How far one coupled block slides, m, without this package, event by event.

    The column with its first mode sticks and slides by linear equations, which matrix exponentials follow exactly from
    point to point of a record that is linear between them; in `cuts` parts of its steps it looks for an event, and
    finds its instant. The state is the slip and its rate, the mode and its rate, the acceleration of the ground and its
    slope, and 1.
    """
    w, c, loads, free = (
        2 * math.pi / period,
        4 * math.pi * damping / period,
        FIRST_L / FIRST_M,
        1 - FIRST_L**2 / FIRST_M,
    )
    stick, slip = np.zeros((2, 7, 7))
    for matrix in (stick, slip):
        matrix[2, 3] = matrix[4, 5] = 1
    stick[3, [2, 3, 4]] = -(w**2), -c, loads
    slip[0, 1] = 1
    slip[3, [2, 3, 6]] = np.array([-(w**2), -c, loads * above]) / free
    slip[1] = -FIRST_L * slip[3]
    slip[1, [4, 6]] += 1, -above

    def beyond(z):
        return z[4] - FIRST_L * (stick[3] @ z) - above

    step = (times[1] - times[0]) / cuts
    whole = {slides: expm(matrix * step) for slides, matrix in ((False, stick), (True, slip))}
    z, slides = np.array([0, 0, 0, 0, 0, 0, 1.0]), False
    for begin, end in itertools.pairwise(acceleration):
        z[4:6] = begin, (end - begin) / (cuts * step)
        for _ in range(cuts):
            left = step
            while left > 1e-15:
                matrix, limit = (slip, lambda z: -z[1]) if slides else (stick, beyond)
                after = (whole[slides] if left == step else expm(matrix * left)) @ z
                if limit(after) <= 0:
                    z, left = after, 0.0
                    continue
                at = partial(lambda t, matrix, limit, z: limit(expm(matrix * t) @ z), matrix=matrix, limit=limit, z=z)
                first = min(1e-9, left / 2) if slides else 0.0  # a slip begins at zero, too
                instant = brentq(at, first, left, xtol=1e-16, rtol=1e-14) if at(first) < 0 else 0.0
                z, left, slides = expm(matrix * instant) @ z, left - instant, not slides
                z[1] = 0.0
    return z[0]


def slide_coupled_by_steps(times, accelerations, yields, periods, damping, parts=1):
    """How far coupled blocks slide, (blocks,), m, by the rule of pySLAMMER (`coupled_analysis.py`), as it stands there.

    Newmark's average acceleration for the mode and the trapezoidal rule for the slip, in steps of the record that are
    cut into `parts`. Of a stop inside a step it finds the instant, but goes on from the state of the mode at the end of
    the step: an error of the first order in the step.
    """
    finer = np.interp(np.arange((len(times) - 1) * parts + 1) / parts, np.arange(len(times)), times)
    h, w, c = (times[1] - times[0]) / parts, 2 * math.pi / periods, 4 * math.pi * damping / periods
    ground = -np.stack([np.interp(finer, times, row) for row in accelerations], axis=1)
    loads, free = FIRST_L / FIRST_M, 1 - FIRST_L**2 / FIRST_M
    s, sv, sa, u, uv, ua = np.zeros((6, len(yields)))
    slides, before = np.zeros(len(yields), bool), np.zeros(len(yields))
    for b in ground:
        old, new = np.where(slides, -yields, before), np.where(slides, -yields, b)
        inertia = np.where(slides, free, 1.0)
        change = -loads * (new - old) + (4 * inertia / h + 2 * c) * uv + 2 * inertia * ua
        change = change / (w**2 + 2 * c / h + 4 * inertia / h**2)
        u2, uv2 = u + change, uv + 2 / h * change - 2 * uv
        ua2 = (-loads * new - c * uv2 - w**2 * u2) / inertia
        sa2 = np.where(slides, -b - yields - FIRST_L * ua2, sa)
        sv2 = np.where(slides, sv + h / 2 * (sa2 + sa), sv)
        s2 = np.where(slides, s + h / 2 * (sv2 + sv), s)
        starts, stops = ~slides & (-b - FIRST_L * ua2 > yields), slides & (sv2 <= 0)
        if np.any(stops & (sv != 0)):
            part = np.where(stops, -sv / np.where(stops, sv2 - sv, 1), 0)
            within, here = stops & (sv != 0), before + part * (b - before)
            stop_sa = -here - yields - FIRST_L * ua2
            s2 = np.where(within, s + part * h / 2 * (2 * sv + part * h / 2 * (stop_sa + sa)), s2)
            left = (1 - part) * h
            push = -loads * (b + yields) + (free - c * left / 2 - w**2 * left**2 / 4) * ua2 - w**2 * left * uv2
            after = push / (1 + c * left / 2 + w**2 * left**2 / 4)
            u2 = np.where(within, u2 + uv2 * left + left**2 / 4 * (ua2 + after), u2)
            uv2 = np.where(within, uv2 + left / 2 * (ua2 + after), uv2)
            ua2 = np.where(within, after, ua2)
        sv2, sa2 = np.where(stops, 0, sv2), np.where(stops, 0, sa2)
        slides = (slides & ~stops) | starts
        s, sv, sa, u, uv, ua, before = s2, sv2, sa2, u2, uv2, ua2, b
    return s


def slide_decoupled_by_steps(times, accelerations, yields, periods, damping, parts=1):
    """The same by the rule of its `decoupled_analysis.py`: the mode on a base that does not slide, then a block."""
    finer = np.interp(np.arange((len(times) - 1) * parts + 1) / parts, np.arange(len(times)), times)
    h, w, c = (times[1] - times[0]) / parts, 2 * math.pi / periods, 4 * math.pi * damping / periods
    ground = np.stack([np.interp(finer, times, row) for row in accelerations], axis=1)
    loads = FIRST_L / FIRST_M
    u, uv, ua, s, v = np.zeros((5, len(yields)))
    slides, before, last = np.zeros(len(yields), bool), ground[0], ground[0]
    for b in ground:
        change = -loads * (b - before) + (4 / h + 2 * c) * uv + 2 * ua
        change = change / (w**2 + 2 * c / h + 4 / h**2)
        u, uv, ua = u + change, 2 / h * change - uv, 4 / h**2 * change - 4 / h * uv - ua
        here = b + FIRST_L * ua
        excess, more = yields - last, here - last
        s = np.where(slides, s - v * h - (excess + more / 6) * h**2 / 2, s)
        v = np.where(slides, v + (excess - more / 2) * h, 0)
        slides = np.where(slides, v < 0, here > yields)
        before, last = b, here
    return s


def record(path):
    """Times (s) and accelerations (in units of the largest), (points,), of a record of pySLAMMER."""
    with path.open(encoding="utf-8-sig") as file:
        rows = [[float(entry) for entry in row[:2]] for row in csv.reader(file) if row and not row[0].startswith("#")]
    times, accelerations = np.array(rows).T
    return times, accelerations / np.max(np.abs(accelerations))


def published(path, method="rigid"):
    """The blocks of a file of results, with linear soil: both displacements (cm) by record, yield and largest
    acceleration (g); of soil that vibrates by its period (s) and damping ratio, too.

    SLAMMER adds the damping by waves that go down into the base, ``0.55 (V_base / V_slope)^-0.99`` and at most 0.2, to
    the damping ratio that is given, which is therefore negative in some of its cases.
    """
    with gzip.open(path, "rt", encoding="utf-8") as file:
        cases = [case for case in json.load(file)["analyses"] if case["analysis"]["method"] == method]
    found: dict[tuple[Any, ...], tuple[float, float]] = {}
    for case in cases:
        motion, results, site = case["ground_motion_parameters"], case["results"], case["site_parameters"]
        key = motion["ground_motion_file"], site["ky_g"], motion["target_pga_g"]
        if method != "rigid":
            if case["analysis"]["mode"] != "linear_elastic":
                continue
            radiated = min(0.55016 * (site["vs_base_mps"] / site["vs_slope_mps"]) ** -0.9904, 0.2)
            key = *key, 4 * site["height_m"] / site["vs_slope_mps"], site["damping_ratio"] + radiated
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


BY_EVENTS, MOST_POINTS = 103, 9000  # every 103rd coupled block, of records up to this length, is followed in Python
SHORTEST = 0.00125  # s: into steps of this length the equivalent acceleration of decoupled blocks is cut


def vibrating(folder, method, every):
    """Displacements in cm of soil that vibrates, (blocks,), by who found them; of every n-th set of numbers."""
    theirs = {name: published(folder / RESULTS / file, method) for name, file in PUBLISHED.items()}
    rule = slide_coupled_by_steps if method == "coupled" else slide_decoupled_by_steps
    keys = list(next(iter(theirs.values())))
    sets = list(dict.fromkeys(key[1:] for key in keys))[::every]
    motions = {name: record(folder / RECORDS / name) for name in dict.fromkeys(key[0] for key in keys)}
    signs = np.tile([1.0, -1.0], len(sets))
    above, largest, periods, damping = np.repeat(np.array(sets), 2, axis=0).T
    found = {name: [results[motion, *one] for motion in motions for one in sets] for name, results in theirs.items()}
    found[OURS] = [100 * slide_soil(motions, method, *one) for one in sets]
    found[OURS] = np.stack(found[OURS], axis=1)  # (records, sets, directions)
    for parts in FINER:
        steps = []
        for times, shape in motions.values():
            ground = (signs * GRAVITY * largest)[:, None] * shape
            steps.append(100 * rule(times, ground, GRAVITY * above, periods, damping, parts))
        found[f"their rule, steps / {parts}"] = steps
    if method == "coupled":
        blocks = list(itertools.product(motions.values(), sets, (1, -1)))
        few = [i for i in range(0, len(blocks), BY_EVENTS) if len(blocks[i][0][0]) < MOST_POINTS]
        apart = []
        for i in few:
            (times, shape), (above, largest, *soil), sign = blocks[i]
            exact = slide_coupled_by_events(times, sign * GRAVITY * largest * shape, GRAVITY * above, *soil)
            apart.append(abs(100 * exact - np.ravel(found[OURS])[i]))
        print(f"{len(few)} of them event by event, without the package: at most {max(apart):.0e} cm from ours")
    return {name: np.ravel(values) for name, values in found.items()}


def slide_soil(motions, method, above, largest, period, damping):
    """Displacements of blocks of soil under all records and their reverses, m, (records, 2), by this package.

    SLAMMER stops where the record ends; here the ground then rests until the longest record has ended.
    """
    soil, block = {"period": period, "damping_ratio": damping}, ss.rigid_block
    records = {name: ss.GroundAcceleration(times, GRAVITY * shape) for name, (times, shape) in motions.items()}
    if method == "coupled":
        block = partial(ss.coupled_block, **soil)
    else:
        for name, one in records.items():
            parts = max(1, round(float(one.times[1]) / SHORTEST))
            records[name] = ss.equivalent_acceleration(one, **soil, parts=parts)
    block, scales = partial(block, gravity=GRAVITY), [largest, -largest]
    print(f"  {above} {largest} {period:.3f} {damping:.2f}", file=sys.stderr, flush=True)
    return ss.newmark_displacements(records, above, scales=scales, block=block, rest=0.0).values[:, :, 0]


def print_vibrating(folder, method, every=1):
    found = vibrating(folder, method, every)
    ours, slammer = found[OURS], found["SLAMMER 1.1"]
    large = ours > NEGLIGIBLE
    print(f"{method}: {len(ours)} displacements, {np.sum(large)} of them above {NEGLIGIBLE} cm; cm")
    print(f"  {'from ours':27}   at most    mean   of those above: at most   median   within 2 %")
    for name, values in found.items():
        apart = np.abs(values - ours)
        share = apart[large] / ours[large]
        near = np.mean(apart <= np.where(ours > NEGLIGIBLE, 0.02 * ours, 0.05))
        if name != OURS:
            ends = f"{np.max(share):25.1e} {np.median(share):8.1e} {100 * near:10.1f} %"
            print(f"  {name:27} {np.max(apart):9.1e} {np.mean(apart):7.1e} {ends}")
    apart = np.max(np.abs(found["their rule, steps / 1"] - found["pySLAMMER 0.2.3"]))
    print(f"Their rule here and pySLAMMER: at most {apart:.0e} cm apart")
    near = np.abs(found["pySLAMMER 0.2.3"] - slammer) <= np.where(slammer > NEGLIGIBLE, 0.02 * slammer, 0.05)
    print(f"pySLAMMER's within 2 % of SLAMMER's, below {NEGLIGIBLE} cm within 0.05 cm: {100 * np.mean(near):.1f} %")
    return found


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
    if sys.argv[2:] and sys.argv[2] in ("coupled", "decoupled"):
        print_vibrating(Path(sys.argv[1]), sys.argv[2], *map(int, sys.argv[3:]))
    else:
        main(Path(sys.argv[1]))
        if len(sys.argv) > 2:
            sliding_spectra(Path(sys.argv[2]))
