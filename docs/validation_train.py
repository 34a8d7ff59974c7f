"""The train of Burridge and Knopoff with a thousand blocks, and its catalogue of earthquakes: a quarter of an hour.

``python docs/validation_train.py`` lets the train of Carlson, Langer, Shaw and Tang ("Intrinsic properties of a
Burridge-Knopoff model of an earthquake fault", Phys. Rev. A 44, 884, 1991) forget a random start in small fixed steps,
without this package. From there it goes on by this package, and in fixed steps, and prints both catalogues.
``python docs/validation_train.py BLOCKS BEFORE T1`` takes other numbers; what it prints, and what it means, is in
``validation.md``. ``tests/validation/test_train.py`` tests the functions of this file with few blocks.
"""

import sys
import time

import jax
import numpy as np
from scipy.optimize import brentq

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

ALPHA, SIGMA, STIFF, SPEED = 3.0, 0.01, 10.0, 0.01  # alpha, sigma, l and nu of Carlson, Langer, Shaw and Tang
SPREAD = 0.1  # m: first positions are uniform in +- this
STEP = 1e-3  # s, of the fixed steps
RANGES = (3e-4, 1e-2), (3e-4, 1e-1), (1e-3, 1e-1)  # m: of moments, above those of single blocks


def weakened(speed):
    """The coefficient of friction of a block that slips at `speed` (m/s) forward."""
    return (1 - SIGMA) / (1 + 2 * ALPHA * speed / (1 - SIGMA))


def starts(blocks, seed=0):
    """First positions, m, (blocks,)."""
    return np.random.default_rng(seed).uniform(-SPREAD, SPREAD, blocks)


def simulated(positions, t1):
    """The catalogue from these first positions, m, until `t1` (s), by this package; nothing slips backward."""
    law = ss.OneWay(ss.FrictionCurve(weakened, mu_static=1.0), capacity=100.0)
    train = ss.block_row(
        len(positions), mass=1.0, between=STIFF**2, to_ground=1.0, normal_force=1.0, friction=law
    )  # fmt: skip
    many = ss.simulate_contacts(
        train,
        ss.Constant(-SPEED),
        t1=t1,
        samples=1,
        key=jax.random.key(0),
        y0=(*positions, *np.full(len(positions), -SPEED)),
        keep="sticks",
    )
    found = ss.catalogue(many)
    return found.begin, found.size, found.moment


def by_steps(positions, t1, step=STEP):
    """The same without this package: begins (s), sizes and moments (m) of its events, (events,), and last positions.

    Midpoint steps of `step` (s). Where every block sticks, the floor drags all alike, and the load grows by `SPEED` in
    unit time: the next begin is known. It ends where this is so for the first time after `t1` (s).
    """
    u, w, t = np.array(positions, float), np.zeros(len(positions)), 0.0
    slips, since, path = [], np.full(len(u), np.nan), np.zeros(len(u))

    def pull(u):
        stretched = np.diff(u, prepend=u[0], append=u[-1])
        return STIFF**2 * np.diff(stretched) - u

    while True:
        load = pull(u)
        slipping = (w > 0) | (load > 1)
        begins, ends = slipping & np.isnan(since), ~slipping & ~np.isnan(since)
        since[begins], path[begins] = t, 0.0
        for block in np.flatnonzero(ends):
            slips.append((since[block], t, block, path[block]))
        since[ends] = np.nan
        if not slipping.any():
            if t >= t1:
                return events_of(slips), u
            wait = (1 - load.max()) / SPEED + 1e-12
            t, u = t + wait, u - SPEED * wait
            continue
        middle = np.maximum(w + step / 2 * (load - weakened(w)), 0) * slipping
        faster = w + step * (pull(u + step / 2 * (w - SPEED)) - weakened(middle))
        faster = np.where(slipping, np.maximum(faster, 0), 0.0)
        path += step / 2 * (w + faster)
        u = u + step * ((w + faster) / 2 - SPEED)
        w, t = faster, t + step


def events_of(slips):
    """Begins, sizes and moments of the connected events of slips, each (begin, end, block, distance).

    Slips of the same block or of neighbours that overlap in time are of one event.
    """
    slips = sorted(slips)
    parent = list(range(len(slips)))

    def root(i):
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    last: dict[int, int] = {}  # the latest slip of each block
    for i, (begin, _, block, _) in enumerate(slips):
        for near in (block - 1, block + 1):
            if near in last and slips[last[near]][1] >= begin:
                parent[root(i)] = root(last[near])
        last[block] = i
    events: dict[int, list] = {}
    for i, (begin, _, block, path) in enumerate(slips):
        first, blocks, moment = events.get(root(i), (begin, set(), 0.0))
        events[root(i)] = [first, blocks | {block}, moment + path]
    found = sorted((begin, len(blocks), moment) for begin, blocks, moment in events.values())
    return tuple(np.array(column) for column in zip(*found, strict=True))


def slope_between(moments, least, most):
    """The Gutenberg-Richter slope b of the moments from `least` to `most`, its standard error, and their number.

    Of maximum likelihood, as `Catalogue.slope`, but of a law that is cut off at `most`: with ``x = ln(M / least)`` and
    ``X = ln(most / least)`` the density is ``b exp(-b x) / (1 - exp(-b X))``.
    """
    x, width = np.log(moments[(moments >= least) & (moments < most)] / least), np.log(most / least)
    b = brentq(lambda b: 1 / b - width / np.expm1(b * width) - x.mean(), 1e-6, 50.0)
    information = 1 / b**2 - (width / (2 * np.sinh(b * width / 2))) ** 2
    return b, (len(x) * information) ** -0.5, len(x)


def alike(some, others):
    """How many events two catalogues begin with that are the same: sizes, begins within 0.01 s, moments within 1 %."""
    number = min(len(some[0]), len(others[0]))
    (begin, size, moment), (begins, sizes, moments) = ([c[:number] for c in each] for each in (some, others))
    same = (size == sizes) & (np.abs(begin - begins) < 0.01) & (np.abs(moment / moments - 1) < 0.01)
    return number if same.all() else int(np.argmin(same))


def told(name, events):
    """Prints a catalogue."""
    begin, size, moment = events
    few = [int(np.sum(size == n)) for n in range(1, 5)]
    print(f"{name}: {len(begin)} events, of 1, 2, 3, 4 blocks {few}, of at most {size.max()} blocks")
    for least, most in RANGES:
        b, error, number = slope_between(moment, least, most)
        print(f"  moments of {least:g} to {most:g} m: {number} events, b = {b:.3f} +- {error:.3f}")
    counts, edges = np.histogram(np.log10(moment), np.arange(-4, 4.1))
    print("  magnitudes", *(f"{edge:+.0f}: {count}," for edge, count in zip(edges, counts, strict=False)))


def main(blocks=1000, before=500.0, t1=400.0):
    _, positions = by_steps(starts(blocks), before)
    print(f"{blocks} blocks, {t1:g} s, after {before:g} s from a random start")
    slow, _ = by_steps(positions, t1)
    told("fixed steps", slow)
    since = time.perf_counter()
    events = simulated(positions, t1)
    told("this package", events)
    print(f"  in {time.perf_counter() - since:.0f} s; the first {alike(events, slow)} events are the same", flush=True)


if __name__ == "__main__":
    given = sys.argv[1:]
    main(*(int(given[0]), float(given[1]), float(given[2])) if given else ())
