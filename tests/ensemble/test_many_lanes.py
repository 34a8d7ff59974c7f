"""The layout for devices of many lanes, asked for on a CPU: sticks are collected and counted on the device.

What the loops of Numba find in the layout of a CPU is found there too: counts exactly, sums to round-off, sticks in the
same order with the same bits where the operations are the same.
"""

import os

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._ensemble import setup
from stickslip_jax._foundation import processes

OSCILLATOR = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))
BLOCKS = ss.block_row(2, mass=1.0, between=4.0, to_ground=2.0, normal_force=1.0, friction=ss.Coulomb(0.5))
POISSON = ss.PoissonSwitching(1.0, 1.0)
SHAKEN = ss.RandomPhase(ss.Harmonic(1.0, ss.Uniform(1.0, 2.5)))
CASES = {
    "closed form": {"y0": (0.0, 1.0)},
    "initial rest": {"y0": (0.0, 0.0), "law": ss.PoissonSwitching(0.2, 1.0)},
    "initial rest, counted": {"y0": (0.0, 0.0), "law": ss.PoissonSwitching(0.2, 1.0), "count_initial_rest": True},
    "unfinished": {"law": SHAKEN, "t1": 20.0, "y0": (0.0, 1.0), "method": ss.Exact(max_steps=120)},
    "cart": {
        "system": ss.MotorCart(mu=0.3),
        "law": ss.RandomPhase(ss.SourceVoltage(1.0, 0.5, 10.0)),
        "t1": 2.0,
        "samples": 300,
    },
}
SLOW = {"cart"}


@pytest.fixture
def wide():
    """Switches the layout of many lanes on. (Not by monkeypatch: programs of tests that use it are not kept.)"""

    def switch(lanes):
        os.environ[processes.VARIABLE] = str(lanes)

    yield switch
    os.environ.pop(processes.VARIABLE, None)


@pytest.fixture
def both(wide):
    """The same ensemble in the layout of a CPU and in that of many lanes."""

    def simulated(keep="sticks", **options):
        chosen = {"system": OSCILLATOR, "law": POISSON, "t1": 30.0, "samples": 700, "key": jax.random.key(1)}
        chosen |= {"keep": keep, "progress": False} | options
        os.environ.pop(processes.VARIABLE, None)
        few = ss.simulate_ensemble(**chosen)
        wide(256)
        return few, ss.simulate_ensemble(**chosen)

    return simulated


def assert_same(one, other, where=""):
    """Whole numbers and structures are equal, others to round-off of the largest of each array."""
    if isinstance(one, tuple):
        assert type(one) is type(other)
        assert len(one) == len(other)
        names = getattr(one, "_fields", range(len(one)))
        for name, mine, its in zip(names, one, other, strict=True):
            assert_same(mine, its, f"{where}.{name}")
    elif one is None or isinstance(one, int):
        assert one == other, where
    else:
        one, other = np.asarray(one), np.asarray(other)
        assert one.dtype == other.dtype, where
        if one.dtype.kind == "f":
            largest = np.max(np.abs(one), initial=0, where=np.isfinite(one))
            np.testing.assert_allclose(other, one, rtol=0, atol=1e-12 * largest, err_msg=where)
        else:
            np.testing.assert_array_equal(other, one, err_msg=where)


@pytest.mark.parametrize("case", [pytest.param(one, marks=[pytest.mark.slow] * (one in SLOW)) for one in CASES])
def test_sums_and_sticks_are_those_of_the_loops(case, both):
    few, many = both(**CASES[case])
    assert (many.threads, many.finished) == (1, few.finished)
    assert_same(few.accumulator, many.accumulator)
    assert_same(few.flat_sticks, many.flat_sticks)
    assert_same(few.totals, many.totals)
    if case == "unfinished":
        assert 0 < many.finished < many.samples


def test_statistics_keep_the_first_sticks(both):
    few, many = both("statistics", **CASES["closed form"])
    assert_same(few.accumulator, many.accumulator)
    assert_same(few.retained, many.retained)


def test_single_precision_is_counted_as_exactly(both):
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.warns(UserWarning, match="float32"):
            few, many = both(**CASES["closed form"])
    finally:
        jax.config.update("jax_enable_x64", True)
    assert many.flat_sticks.start.dtype == np.float32
    assert_same(few.accumulator, many.accumulator)
    assert_same(few.flat_sticks, many.flat_sticks)


@pytest.mark.slow
def test_every_contact_is_counted(wide):
    def found():
        return ss.simulate_contacts(
            BLOCKS, ss.PoissonSwitching(0.4, 1.0), t1=10.0, samples=300, key=jax.random.key(1), keep="sticks",
            progress=False,
        )  # fmt: skip

    few = found()
    wide(256)
    many = found()
    for one, other in zip(map(few._of_track, range(3)), map(many._of_track, range(3)), strict=True):
        assert one.flat_sticks.start.size > 300
        assert_same(one.accumulator, other.accumulator)
        assert_same(one.flat_sticks, other.flat_sticks)


def test_records_of_several_calls_are_joined(both, monkeypatch):
    monkeypatch.setattr(setup, "blocks_at_once", lambda lanes, steps: 1)
    few, many = both(**CASES["closed form"])
    assert_same(few.accumulator, many.accumulator)
    assert_same(few.flat_sticks, many.flat_sticks)


def test_outputs_are_the_same(both):
    few, many = both("totals", y0=(0.0, 1.0), outputs={"end": lambda one: one.final_state[0]})
    np.testing.assert_allclose(many.output_values["end"], few.output_values["end"], rtol=1e-12)


def test_a_sensitivity_is_the_same(wide):
    def found():
        return ss.sensitivity(
            ss.stick_fraction, OSCILLATOR, POISSON, wrt="mu", t1=10.0, samples=1000, key=jax.random.key(2),
            y0=(0.0, 0.5),
        )  # fmt: skip

    few = found()
    wide(1024)
    many = found()
    for name in ("value", "derivative", "standard_error"):
        assert getattr(many, name) == pytest.approx(getattr(few, name), rel=1e-9)


def test_where_memory_does_not_suffice_fewer_lanes_are_taken(both, monkeypatch):
    monkeypatch.setattr(processes, "_FEWEST", 64)
    recorder, failed = setup._device_recorder, []

    def failing(study, tasks):
        run = recorder(study, tasks)

        def once(first, number):
            if not failed:
                failed.append(tasks.lanes)
                raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory while trying to allocate 9 bytes")
            assert tasks.lanes == failed[0] // 2
            return run(first, number)

        return once

    monkeypatch.setattr(setup, "_device_recorder", failing)
    with pytest.warns(RuntimeWarning, match="lacks memory for 256 trajectories at a time; 128 are simulated") as told:
        few, many = both(**CASES["closed form"])
    assert len([one for one in told if one.category is RuntimeWarning]) == 1
    assert_same(few.accumulator, many.accumulator)
    assert_same(few.flat_sticks, many.flat_sticks)


def test_other_errors_of_the_device_are_raised():
    with pytest.raises(jax.errors.JaxRuntimeError, match="INTERNAL"):
        processes.fewer_lanes(jax.errors.JaxRuntimeError("INTERNAL: broken"), 65536)


@pytest.mark.parametrize("text", ["many", "-1", "1.5", "0x10"])
def test_what_is_no_number_of_lanes_is_refused(text, wide):
    wide(text)
    with pytest.raises(ValueError, match="Environment variable STICKSLIP_LANES must be a whole number of lanes"):
        processes.is_wide()
