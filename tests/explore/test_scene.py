"""What the explorer shows: its numbers with their bounds, as Python, and as a study's file."""

import equinox as eqx
import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax.study import StudyError, read_config
from stickslip_jax.study._config import config_of
from stickslip_jax.study._explorer_scene import (
    FRICTIONS,
    SYSTEMS,
    NotWritable,
    Scene,
    as_python,
    bases_for,
    friction_called,
    numbers_of,
    quantity_of,
    read_number,
    scene_called,
    with_friction,
)


def every_scene():
    """Each system with each friction law, and with each base."""
    for name in SYSTEMS:
        start = scene_called(name)
        for friction in FRICTIONS:
            yield (
                f"{name}, {friction}",
                start._replace(system=with_friction(start.system, friction_called(friction, start.system))),
            )
        for base, law in bases_for(start).items():
            yield f"{name}, {base}", start._replace(law=law)


EVERY = dict(every_scene())


def test_catalogue_is_what_it_says():
    assert len(EVERY) == len(SYSTEMS) * len(FRICTIONS) + 3 * 9 + 2
    for name, scene in EVERY.items():
        law = name.rpartition(", ")[2]
        if law in ("Stribeck", "VelocityWeakening", "Directional", "Ageing"):
            assert f"{law}(" in repr(scene.system)


@pytest.mark.parametrize("name", EVERY)
def test_program_has_the_same_system_and_base(name):
    scene = EVERY[name]
    written = {}
    exec(as_python(scene).partition("many =")[0], written)
    assert eqx.tree_equal(written["system"], scene.system)
    assert eqx.tree_equal(written["law"], scene.law)
    assert written["y0"] == scene.y0


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_study_file_has_the_same_system_and_base(name, tmp_path):
    scene = EVERY[name]
    config = config_of(scene.system, scene.law, y0=scene.y0, t1=scene.t1, samples=77, seed=5)
    (tmp_path / "study.toml").write_text(config.to_toml(), encoding="utf-8")
    read = read_config(tmp_path / "study.toml")
    assert eqx.tree_equal(read.system.build(), scene.system)
    assert eqx.tree_equal(read.base.build(), scene.law)
    assert (read.run.y0(), read.run.t1, read.run.samples, read.run.seed) == (scene.y0, scene.t1, 77, 5)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_sliders_stay_inside_the_bounds(name):
    """Both ends of each slider are taken, but where other numbers bound it."""
    scene = EVERY[name]
    numbers = numbers_of(scene)
    assert len({one.name for one in numbers}) == len(numbers)
    for one in numbers:
        assert one.low <= one.value <= one.high
        assert one.low < one.high
        about = quantity_of(scene, one.path)
        for end in (one.low, one.high):
            about.check(one.name, end)
            if one.path[-1] in ("mu", "mu_static", "low", "high", "speed"):  # others bound them too
                continue
            moved = scene.with_number(one.path, end)
            (there,) = (again.value for again in numbers_of(moved) if again.path == one.path)
            assert there == end


def test_labels():
    labels = {one.name: one.label for one in numbers_of(scene_called("two blocks"))}
    assert labels["system.contacts[1].friction.mu"] == "friction coefficient, contact 1"
    assert labels["y0[0].low"] == "initial position 0, lowest (m)"
    assert labels["law.rate"] == "rate (1/s)"
    assert labels["t1"] == "duration of a realisation (s)"
    labels = {one.name: one.label for one in numbers_of(scene_called("motor and cart"))}
    assert labels["law.signal.angular_frequency"] == "angular frequency (rad/s)"
    assert "law.signal.phase" not in labels  # it is drawn


def test_damping_can_be_added():
    scene = scene_called("mass on a spring")
    assert scene.with_number(("system", "damping"), 0.25).system.damping == 0.25


def test_number_outside_its_bounds_is_refused():
    scene = scene_called("mass on a spring")
    with pytest.raises(ValueError, match=r"\AArgument mass must be positive \(in kg\), but -1\.0 was given"):
        scene.with_number(("system", "mass"), -1.0)
    static = scene._replace(system=with_friction(scene.system, ss.Coulomb(0.5, 0.7)))
    with pytest.raises(ValueError, match="mu_static"):
        static.with_number(("system", "friction", "mu"), 0.9)


@pytest.mark.parametrize("text", ["", "one", "nan", "inf", "1,5", "__import__('os')", "1e999"])
def test_text_that_is_no_number(text):
    with pytest.raises(ValueError, match=r"is not a number; write one such as 0\.25"):
        read_number(text)


def test_text_that_is_a_number():
    assert [read_number(text) for text in (" 1e-3 ", "\N{MINUS SIGN}2", "3", "1_000")] == [0.001, -2.0, 3.0, 1000.0]


class Own(ss.Coulomb):
    """A law of a user."""


def test_what_no_file_describes_is_refused_by_name():
    scene = scene_called("mass on a spring")
    own = scene.system.__class__(1.0, 4.0, 1.0, Own(0.3))
    with pytest.raises(StudyError, match=r"Own has no section in a study's file; copy it as Python instead"):
        config_of(own, scene.law, y0=scene.y0, t1=1.0, samples=2, seed=0)


def test_method_is_written_into_the_file():
    """And one that no file can describe is refused, as are structures of a user's class."""
    scene, given = scene_called("mass on a spring"), {"t1": 1.0, "samples": 2, "seed": 0}
    for method in (ss.Exact(step=0.01), ss.Exact(max_steps=500), ss.Regularized(0.01), ss.Regularized(0.02, "tanh")):
        config = config_of(scene.system, scene.law, y0=scene.y0, method=method, **given)
        assert eqx.tree_equal(config.run.method(), method)
    with pytest.raises(StudyError, match="No study's file can hold this method, but one that differs"):
        config_of(scene.system, scene.law, y0=scene.y0, method=ss.Regularized(0.01, rtol=1e-9), **given)


def test_all_contacts_and_structures_of_a_user():
    scene = scene_called("two blocks")
    every = scene.system.of_all_contacts()
    config = config_of(every, scene.law, y0=scene.y0, t1=1.0, samples=2, seed=0)
    assert eqx.tree_equal(config.system.build(), every)

    class Moved(ss.LinearStructure):
        pass

    moved = Moved(every.mass, every.stiffness, contacts=every.contacts)
    with pytest.raises(StudyError, match="Moved has no section in"):
        config_of(moved, scene.law, y0=scene.y0, t1=1.0, samples=2, seed=0)


def test_subclass_of_the_same_name_is_refused():
    class Ageing(ss.Ageing):
        pass

    scene = scene_called("mass on a spring")
    law = Ageing(ss.Coulomb(0.3), ss.ExponentialGrowth(0.1, 1.0))
    with pytest.raises(StudyError, match="No study's file can hold this system, but one that differs"):
        config_of(ss.MassSpring(1.0, 4.0, 1.0, law), scene.law, y0=scene.y0, t1=1.0, samples=2, seed=0)


def test_record_is_written_into_the_file():
    scene = scene_called("mass on a spring")
    recorded = ss.Recorded(np.linspace(0, 1, 5), np.sin(np.arange(5.0)))
    config = config_of(scene.system, recorded, y0=scene.y0, t1=1.0, samples=2, seed=0)
    assert eqx.tree_equal(config.base.build(), recorded)


def test_program_of_a_users_class_imports_it():
    code = as_python(scene_called("mass on a spring")._replace(system=ss.MassSpring(1.0, 4.0, 1.0, Own(0.3))))
    assert f"from {Own.__module__} import Own\n" in code
    assert "friction=Own(mu=0.3)" in code

    class Inside(ss.Coulomb):
        pass

    with pytest.raises(NotWritable, match="defined in a function"):
        as_python(scene_called("mass on a spring")._replace(system=ss.MassSpring(1.0, 4.0, 1.0, Inside(0.3))))


def test_scene_of_float32_says_so(monkeypatch):
    monkeypatch.setattr("stickslip_jax.study._explorer_scene.jnp.result_type", lambda kind: np.dtype("float32"))
    assert '"jax_enable_x64", False' in as_python(scene_called("mass on a spring"))


@pytest.mark.slow
def test_program_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    scene = Scene(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.6)), ss.PoissonSwitching(1.0, 1.0), (0.1, 0.0), 20.0, 50, 3)
    exec(compile(as_python(scene), "program", "exec"), {"__name__": "program"})
    many = ss.simulate_ensemble(
        scene.system, scene.law, t1=20.0, samples=50, key=jax.random.key(3), y0=(0.1, 0.0), progress=False
    )
    assert str(ss.mean_stick_duration(many)) in capsys.readouterr().out
    assert (tmp_path / "phase_portrait.png").exists()
