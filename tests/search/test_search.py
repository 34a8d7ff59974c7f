"""The random search: 10,000 set-ups by kind and family, each against a reference; none silently wrong.

What that means: `support/search.py`. Batches of set-ups share compiled programs. With the other files of this folder
there are some 13,000: 9,000 against a reference, 4,000 against themselves in other units, bit for bit.
"""

import jax
import numpy as np
import pytest
from support.search import Batch, Case, follow, judged, single
from support.search_cases import FAMILIES, drawn, switching
from support.search_scales import in_units, random_units, same_in_units
from support.search_ties import first_release, tie

# The bound where nothing amplifies errors. In float32 the state of every step, some hundred, is rounded.
CLOSED, INTEGRATED, SINGLE = 1e-10, 1e-7, 1e-4
EACH, SCALED = 70, 200


def wrong_ones(cases: list[Case], least: float, dtype=np.float64) -> dict[int, object]:
    batch = follow(cases, dtype=dtype)
    verdicts = [judged(case, batch, i, least, dtype) for i, case in enumerate(cases)]
    # The comparison must not be empty: most set-ups are not told about.
    assert np.mean([verdict.told for verdict in verdicts]) < (0.5 if dtype == np.float64 else 0.8)
    return {i: verdict for i, verdict in enumerate(verdicts) if verdict.wrong}


def in_other_units(cases: list[Case], dtype=np.float64) -> list[int]:
    """Which set-ups change when their units do."""
    units = [random_units(np.random.default_rng([7, i]), dtype) for i in range(len(cases))]
    one = follow(cases, dtype=dtype)
    other = follow([in_units(case, unit) for case, unit in zip(cases, units, strict=True)], dtype=dtype)
    return [i for i, unit in enumerate(units) if not same_in_units(one, other, i, unit)]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["harmonic", "sums", "record", "steps", "jumps", "ground"])
def test_closed_forms(kind):
    for family in FAMILIES:
        if family == "clinging" and kind in ("jumps", "ground"):  # which have no static friction
            continue
        assert not wrong_ones(drawn(kind, family, EACH), CLOSED), family
    assert not in_other_units(drawn(kind, "everyday", SCALED))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["weakening", "stribeck", "hump"])
def test_integrated_slips(kind):
    for family in ("everyday", "damped"):
        assert not wrong_ones(drawn(kind, family, EACH), INTEGRATED), family
    assert not in_other_units(drawn(kind, "everyday", SCALED))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
@pytest.mark.parametrize("kind", ["harmonic", "record", "ground", "weakening"])
def test_single_precision(kind):
    # Heavily damped slips that are integrated run out of steps in float32, which the status tells.
    families = ["everyday"] if kind == "weakening" else [name for name in FAMILIES if name != "clinging"]
    with jax.enable_x64(False):
        for family in families:
            # In float32 an instant is near-grazing within a thousandth of the scale: long motions nearly all have one.
            share = 0.3 if kind == "weakening" else 1.0
            cases = [single(case._replace(t1=share * case.t1)) for case in drawn(kind, family, EACH)]
            assert not wrong_ones(cases, SINGLE, np.float32), family
        assert not in_other_units([single(case) for case in drawn(kind, "everyday", SCALED)], np.float32)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
@pytest.mark.parametrize("family", ["everyday", "frictionless", "lattice", "slow"])
def test_whole_intervals(family):
    cases = switching(family, SCALED)
    assert not wrong_ones(cases, CLOSED)
    assert not in_other_units(cases)
    with jax.enable_x64(False):
        cases = [single(case) for case in cases]
        assert not in_other_units(cases, np.float32)


def end_of_first(batch: Batch, i: int) -> float:
    """When the stick that begins at 0 ends; 0 if there is none."""
    sticks = batch.sticks(i)
    return float(sticks[0, 1]) if len(sticks) and sticks[0, 0] == 0 else 0.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["base", "ground", "force"])
def test_ties_with_the_friction_limit(kind):
    cases = [tie(kind, seed) for seed in range(500)]
    batch, wrong, released = follow(cases), [], 0
    for i, case in enumerate(cases):
        exact = first_release(case)
        released += exact is not None
        error = abs(end_of_first(batch, i) - (case.t1 if exact is None else exact))
        if error > 1e-7 * case.t1 and not batch.tells(i):
            wrong.append(i)
    assert not wrong
    assert 20 < released < 480
