"""Lanes by the device: on another one than a CPU an ensemble is simulated in many, and its samples are the same."""

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._compiler import native
from stickslip_jax._ensemble import setup
from stickslip_jax._foundation import processes

BLOCKS = ss.block_row(2, mass=1.0, between=4.0, to_ground=2.0, normal_force=1.0, friction=ss.Coulomb(0.5))
OSCILLATOR = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(ss.Uniform(0.5, 1.0)))
CASES = {
    "intervals": (OSCILLATOR, ss.PoissonSwitching(1.0, 1.0), "sticks"),
    "totals": (OSCILLATOR, ss.PoissonSwitching(1.0, 1.0), "totals"),
    "steps": (OSCILLATOR, ss.RandomPhase(ss.Harmonic(1.0, 1.5)), "sticks"),
    "two blocks": (BLOCKS.of_contact(0), ss.PoissonSwitching(0.4, 1.0), "sticks"),
}


class Device:
    """Another kind of device, with so much memory."""

    platform = "gpu"

    def __init__(self, memory):
        self.memory = memory

    def memory_stats(self):
        return {"bytes_limit": self.memory + 1000, "bytes_in_use": 1000}


def simulated(case):
    system, law, keep = CASES[case]
    return ss.simulate_ensemble(system, law, 10.0, samples=1000, key=jax.random.key(1), keep=keep, progress=False)


@pytest.fixture
def lanes(monkeypatch):
    """A list of how many lanes were chosen, each time."""
    seen = []

    def noted(*arguments):
        seen.append(processes.lanes_at_once(*arguments))
        return seen[-1]

    monkeypatch.setattr(setup, "lanes_at_once", noted)
    return seen


@pytest.mark.parametrize("case", ["intervals", *(pytest.param(one, marks=pytest.mark.slow) for one in [*CASES][1:])])
def test_many_lanes_find_the_same_samples(case, lanes, monkeypatch):
    few = simulated(case)
    monkeypatch.setattr(processes, "device", lambda: Device(10**9))
    monkeypatch.setattr(native, "native_loops_work", lambda: False)  # as on another device
    many = simulated(case)
    assert lanes == [256, 1024]
    assert (many.threads, many.finished) == (1, 1000)
    for name in ("sticks", "slips", "stick_time", "status"):  # round-off may decide another near-grazing instant
        np.testing.assert_allclose(getattr(many.totals, name), getattr(few.totals, name), rtol=1e-9, err_msg=name)
    if few.keep == "sticks":
        np.testing.assert_allclose(many.sticks.start, few.sticks.start, rtol=1e-9)
    assert ss.mean_stick_duration(many).value == pytest.approx(ss.mean_stick_duration(few).value, rel=1e-9)


def test_lanes_fit_into_half_of_the_memory(monkeypatch):
    monkeypatch.setattr(processes, "device", lambda: Device(2**30))
    for size in (100, 1000, 10_000):
        found = processes.lanes_at_once(256, 10**8, lambda size=size: size)
        assert found == min(2**20, 1 << (2**29 // size).bit_length() - 1)
    assert processes.lanes_at_once(256, 3000, lambda: 1.0) == 4096
    monkeypatch.setattr(processes, "device", lambda: Device(0))
    assert processes.lanes_at_once(256, 10**8, lambda: 1.0) == 256
