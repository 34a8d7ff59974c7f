"""Sections, diagrams, basins and exponents kept in a folder: interrupted, taken up again, and refused."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import stickslip_jax as ss
from stickslip_jax import nonlinear
from stickslip_jax.nonlinear import _following

SYSTEM = ss.MassSpring(1.0, 1.0, 1.0, ss.Stribeck(mu=0.4, mu_static=0.6, stribeck_speed=0.5), damping=0.05)
BASE = ss.Harmonic(amplitude=0.8, angular_frequency=1.3)
OVER = {"angular_frequency": np.linspace(0.9, 1.6, 40)}
COMMON = {"y0": (0.3, 0.1), "transient": 4, "kept": 4, "progress": False}


def short(**more):
    """Motions that have not settled do not go on here: how many blocks there are is asked."""
    given = COMMON | more
    return given | {"longest_transient": given["transient"]}


CALLS = {
    "section": lambda **more: nonlinear.stroboscopic_section(SYSTEM, BASE, over=OVER, **short(**more)),
    "diagram": lambda **more: nonlinear.bifurcation_diagram(
        SYSTEM, BASE, OVER, follow_attractor="both", **short(**more)
    ),
    "events": lambda **more: nonlinear.event_section(SYSTEM, BASE, "stick_start", over=OVER, **(COMMON | more)),
    "exponents": lambda **more: nonlinear.lyapunov_exponents(SYSTEM, BASE, over=OVER, **(COMMON | more)),
    "basins": lambda **more: nonlinear.basins(
        SYSTEM, BASE, **short(**({"y0": {"position": np.linspace(-1, 1, 40)}} | more))
    ),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.* fewer events were found")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in ("exponents", "basins", "section") else name
        for name in CALLS
    ],
)
def test_what_is_stored_is_not_simulated_again(name, tmp_path, monkeypatch):
    expected = CALLS[name]()
    first = CALLS[name](folder=tmp_path / "kept")
    xr.testing.assert_allclose(first, expected, atol=1e-9)  # blocks are of another size, and round off otherwise

    def fail(*_):
        raise AssertionError("it is simulated again")

    monkeypatch.setattr(_following, "_with_enough_steps", fail)
    xr.testing.assert_identical(CALLS[name](folder=tmp_path / "kept"), first)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["section", "diagram"])
def test_goes_on_after_an_interrupt(name, tmp_path, monkeypatch):
    expected = CALLS[name](folder=tmp_path / "at once")
    tmp_path /= "interrupted"
    whole, done = _following._with_enough_steps, []

    def interrupted(*given):
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(1)
        return whole(*given)

    monkeypatch.setattr(_following, "_with_enough_steps", interrupted)
    with pytest.raises(KeyboardInterrupt):
        CALLS[name](folder=tmp_path)
    stored = len(list(tmp_path.glob("*.block")))
    assert 3 <= stored <= 4
    monkeypatch.setattr(_following, "_with_enough_steps", lambda *given: (done.append(1), whole(*given))[1])
    xr.testing.assert_identical(CALLS[name](folder=tmp_path), expected)
    assert len(done) == len(list(tmp_path.glob("*.block")))  # none twice


@pytest.mark.slow
def test_damaged_blocks_are_done_again(tmp_path):
    expected = CALLS["section"](folder=tmp_path)
    path = tmp_path / "block-000001.block"
    data = bytearray(path.read_bytes())
    data[-10] ^= 1
    path.write_bytes(data)
    (tmp_path / "block-000002.block").write_bytes(b"")
    xr.testing.assert_identical(CALLS["section"](folder=tmp_path), expected)
    assert path.read_bytes() != bytes(data)


CHANGED = {
    "transient": ({"transient": 5}, "transient: 4 there, 5 here"),
    "start": ({"y0": (0.3, 0.2)}, r"y0: \[\[0.3, 0.1\]\] there, \[\[0.3, 0.2\]\] here"),
    "period": ({"period": 4 * np.pi / 1.3, "over": {"mu": [0.1]}}, "over: .* there, .* here; period: "),
    "method": ({"method": ss.Exact(max_steps=4000)}, "method: Exact .* there, Exact .* here"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGED)
def test_another_call_is_refused(name, tmp_path):
    CALLS["section"](folder=tmp_path)
    changed, said = CHANGED[name]
    given = {"over": OVER} | COMMON | changed
    with pytest.raises(ss.SweepError, match=f"holds results of another call .*{said}"):
        nonlinear.stroboscopic_section(SYSTEM, BASE, folder=tmp_path, **given)
    other = eqx.tree_at(lambda system: system.damping, SYSTEM, 0.06)
    with pytest.raises(ss.SweepError, match=r"system: MassSpring .* there, MassSpring .* here"):
        nonlinear.stroboscopic_section(other, BASE, over=OVER, folder=tmp_path, **COMMON)


@pytest.mark.slow
def test_other_code_of_a_class_is_noticed(tmp_path):
    def own(strength):
        class Own(ss.SwitchedSystem):
            @property
            def state_names(self):
                return ("position in m", "velocity in m/s")

            def rates(self, t, y, base, friction):
                return y[1], -y[0] - 0.3 * friction - strength * jnp.tanh(y[1])

            def relative_velocity(self, t, y, base):
                return y[1] - base.velocity

            @property
            def shortest_time(self):
                return 6.28

        return Own()

    for _ in range(2):
        nonlinear.stroboscopic_section(own(0.1), BASE, folder=tmp_path, **COMMON)
    with pytest.raises(ss.SweepError, match="code of your classes"):
        nonlinear.stroboscopic_section(own(0.2), BASE, folder=tmp_path, **COMMON)


def test_folders_that_hold_something_else_are_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ss.SweepError, match=r"is not empty and holds no results of such a call \(it has notes.txt\)"):
        CALLS["section"](folder=tmp_path)
    with pytest.raises(ss.SweepError, match="cannot be written"):
        CALLS["section"](folder=tmp_path / "notes.txt")
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "call.json").write_text("{")
    with pytest.raises(ss.SweepError, match="is damaged; choose another folder"):
        CALLS["section"](folder=tmp_path / "kept")
    with pytest.raises(ValueError, match="Argument folder must be"):
        CALLS["section"](folder="")


@pytest.mark.slow
def test_a_block_of_another_call_is_not_taken(tmp_path):
    """It may have been copied into the folder, and has the name and the sizes of the one that it replaced."""
    CALLS["section"](folder=tmp_path / "mine")
    CALLS["section"](folder=tmp_path / "other", y0=(0.3, 0.2))
    name = "block-000001.block"
    (tmp_path / "mine" / name).write_bytes((tmp_path / "other" / name).read_bytes())
    with pytest.raises(ss.SweepError, match=f"{name} cannot be read, or is of another call"):
        CALLS["section"](folder=tmp_path / "mine")


@pytest.mark.slow
def test_a_folder_in_use_is_refused(tmp_path):
    from stickslip_jax._ensemble.encoding import locked  # noqa: PLC0415

    CALLS["section"](folder=tmp_path)
    with locked(tmp_path / "lock", "busy"), pytest.raises(ss.SweepError, match="is in use by another call"):
        CALLS["section"](folder=tmp_path)
