"""Studies and sweeps of structures with several contacts: what their files say is what is simulated."""

import re
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from support.bad_structures import BAD_STRUCTURES, CONTACT, HEAD, ROW_KEYS, STOREYS, changed
from support.study import TIMES, VALUES, config_file, write_records

import stickslip_jax as ss
from stickslip_jax.study import StudyError
from stickslip_jax.study._reading import read_config, read_sweep_config
from stickslip_jax.study._run import DATA, RESULT_FILES, STATISTICS, run_study, sweep_of

LOWER = ss.Contact.of_mass(0, 2, 5.0, ss.Coulomb(0.2))
VERTICAL = '{ law = "GroundAcceleration", file = "record.csv", value_column = "value" }'
HARMONIC = '{ law = "Harmonic", amplitude = 0.5, angular_frequency = 1.5 }'


def structure(*contacts, **more):
    return ss.LinearStructure([1.0, 0.5], [2.0, 1.0], contacts=contacts or (LOWER,), **more).of_contact(0)


ROW = {"mass": 2.0, "between": 3.0, "to_ground": 0.5, "normal_force": 1.0, "friction": ss.Coulomb(0.3, 0.4)}
SYSTEMS = {
    "diagonals": (HEAD + CONTACT, structure()),
    "matrices": (
        '[system]\nmodel = "LinearStructure"\nmass = [[1, 0.1], [0.1, 0.5]]\nstiffness = [[2, -1], [-1, 2]]\n'
        'damping = [[0.1, 0], [0, 0.2]]\nrotates = true\ncontact = "all"\n' + CONTACT,
        ss.LinearStructure(
            [[1.0, 0.1], [0.1, 0.5]], [[2.0, -1.0], [-1.0, 2.0]], [[0.1, 0.0], [0.0, 0.2]], (LOWER,), rotates=True
        ).of_all_contacts(),
    ),
    "masses on each other": (
        HEAD + CONTACT + "[[system.contacts]]\nbetween = [1, 0]\nnormal_force = 2\nmu = 0.3\n",
        structure(LOWER, ss.Contact.between(1, 0, 2, 2.0, ss.Coulomb(0.3))),
    ),
    "a direction": (
        HEAD + "[[system.contacts]]\ndirection = [1, -0.5]\non_base = 0.25\nnormal_force = 2\nmu = 0.3\n",
        structure(ss.Contact([1.0, -0.5], 2.0, ss.Coulomb(0.3), on_base=0.25)),
    ),
    "friction laws": (
        f"{HEAD}{CONTACT}[[system.contacts]]\nmass = 1\nnormal_force = 2.0\n[system.contacts.friction]\n"
        'law = "Stribeck"\n'
        "mu = 0.3\nmu_static = 0.4\nstribeck_speed = 0.1\n",
        structure(LOWER, ss.Contact.of_mass(1, 2, 2.0, ss.Stribeck(0.3, 0.4, 0.1))),
    ),
    "normal forces": (
        f"{HEAD}{CONTACT}[[system.contacts]]\nmass = 1\nmu = 0.3\nnormal_force = {HARMONIC}\n",
        structure(LOWER, ss.Contact.of_mass(1, 2, ss.Harmonic(0.5, 1.5), ss.Coulomb(0.3))),
    ),
    "normal force that jumps": (
        f"{HEAD}[[system.contacts]]\nmass = 1\nmu = 0.3\n"
        '[system.contacts.normal_force]\nlaw = "ForceSteps"\ntimes = [0, 1]\nvalues = [1, 0]\n',
        structure(ss.Contact.of_mass(1, 2, ss.ForceSteps([0.0, 1.0], [1.0, 0.0]), ss.Coulomb(0.3))),
    ),
    "recorded normal force": (
        f"{HEAD}[[system.contacts]]\nmass = 1\nmu = 0.3\n"
        '[system.contacts.normal_force]\nlaw = "Recorded"\nfile = "record.csv"\nvalue_column = "value"\n',
        structure(ss.Contact.of_mass(1, 2, ss.Recorded(TIMES, VALUES), ss.Coulomb(0.3))),
    ),
    "forces": (
        HEAD + f"force = [0.5, {HARMONIC}]\n" + CONTACT,
        structure(force=(0.5, ss.Harmonic(0.5, 1.5))),
    ),
    "forces in sections": (
        HEAD + CONTACT + 2 * '[[system.force]]\nlaw = "Harmonic"\namplitude = 0.5\nangular_frequency = 1.5\n',
        structure(force=(ss.Harmonic(0.5, 1.5), ss.Harmonic(0.5, 1.5))),
    ),
    "block_row": (
        f'[system]\nmodel = "block_row"\nblocks = 3\n{ROW_KEYS}normal_force = 1\ncontact = 2\n'
        "[system.friction]\nmu = 0.3\nmu_static = 0.4\n",
        ss.block_row(3, **ROW).of_contact(2),
    ),
    "block_row under a normal force that varies": (
        f'[system]\nmodel = "block_row"\nblocks = 3\n{ROW_KEYS}damping = 0.1\nmu = 0.3\ncontact = "all"\n'
        f"normal_force = {HARMONIC}\n",
        ss.block_row(
            3, **ROW | {"damping": 0.1, "friction": ss.Coulomb(0.3), "normal_force": ss.Harmonic(0.5, 1.5)}
        ).of_all_contacts(),
    ),
    "storeys_on_bearing": (
        STOREYS + "damping = [0.5, 0.4]\nbearing_stiffness = 2\ngravity = 9.81\n",
        ss.storeys_on_bearing(
            [3.0, 2.0, 1.0],
            [50.0, 40.0],
            friction=ss.Coulomb(0.1),
            damping=[0.5, 0.4],
            bearing_stiffness=2.0,
            gravity=9.81,
        ).of_contact(0),
    ),
    "storeys_on_bearing over pendulums": (
        STOREYS + f"radius = 2\nvertical = {VERTICAL}\n",
        ss.storeys_on_bearing(
            [3.0, 2.0, 1.0],
            [50.0, 40.0],
            friction=ss.Coulomb(0.1),
            radius=2.0,
            vertical=ss.GroundAcceleration(TIMES, VALUES),
        ).of_contact(0),
    ),
    "friction_pendulum": (
        '[system]\nmodel = "friction_pendulum"\nmass = 2\nradius = 1.5\n'
        'friction = { law = "VelocityDependent", mu_slow = 0.05, mu_fast = 0.1, rate = 20 }\n',
        ss.friction_pendulum(2.0, 1.5, ss.VelocityDependent(0.05, 0.1, 20.0)).of_contact(0),
    ),
    "flat slider": (
        '[system]\nmodel = "friction_pendulum"\nmass = 2\nmu = 0.1\n',
        ss.friction_pendulum(2.0, None, ss.Coulomb(0.1)).of_contact(0),
    ),
}


def same(one, other) -> bool:
    """Whether two systems are of the same kind and hold the same numbers."""
    alike = jax.tree.structure(one) == jax.tree.structure(other)
    return alike and jax.tree.all(jax.tree.map(np.array_equal, one, other))


@pytest.mark.parametrize("case", SYSTEMS)
def test_system(tmp_path, case):
    write_records(tmp_path)
    text, expected = SYSTEMS[case]
    config = read_config(config_file(tmp_path, text))
    assert same(config.system.build(), expected)
    assert read_config(config_file(tmp_path, config.to_toml())) == config


def test_initial_state(tmp_path):
    config = read_config(config_file(tmp_path, HEAD + CONTACT))
    assert config.run.y0() is None
    text = f'{HEAD}{CONTACT}[run]\ninitial_state = [{{ low = -1, high = 1 }}, 0.5, 0, 1]\nsolver = "Tsit5"\n'
    config = read_config(config_file(tmp_path, text))
    assert same(config.run.y0(), (ss.Uniform(-1.0, 1.0), 0.5, 0.0, 1.0))
    assert type(config.run.method().solver).__name__ == "Tsit5"
    assert read_config(config_file(tmp_path, config.to_toml())) == config


def test_file_of_the_how_to(tmp_path):
    page = Path(__file__).parents[2] / "docs/howto/contacts.md"
    (text,) = re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    config = read_config(config_file(tmp_path, text))
    upper = ss.Contact.between(1, 0, 2, ss.ForceSteps([0.0, 20.0], [2.0, 0.0]), ss.Stribeck(0.3, 0.4, 0.1))
    expected = ss.LinearStructure([1.0, 0.5], [[2.0, -1.0], [-1.0, 2.0]], contacts=(LOWER, upper))
    assert same(config.system.build(), expected.of_contact(0))


# --- what comes out

RUN = "[run]\nt1 = 20.0\nsamples = 20\nchunk = 64\nthreads = 1\n"


SHORT = {"samples": 20, "t1": 20.0, "chunk": 64, "threads": 1}


@pytest.mark.slow
def test_study_is_the_ensemble(tmp_path):
    """Every stick and every statistic of the example, to the last bit."""
    options = SHORT | {"out": str(tmp_path / "result"), "figures": False}
    study = run_study(read_config(None, options, example="two-blocks"), progress=False)
    friction = ss.Coulomb(0.8, 1.0)
    contacts = tuple(ss.Contact.of_mass(i, 2, force, friction) for i, force in enumerate((1.0, 1.3)))
    blocks = ss.LinearStructure([1.0, 1.0], [[2.2, -1.2], [-1.2, 2.2]], contacts=contacts)
    many = ss.simulate_ensemble(
        blocks.of_contact(0),
        ss.PoissonSwitching(0.3, 0.5),
        t1=20.0,
        samples=20,
        key=jax.random.key(0),
        y0=(ss.Uniform(-0.5, 0.5), 0.0, 0.0, 0.0),
        keep="sticks",
        chunk=64,
        threads=1,
        progress=False,
    )
    sticks = many.require_sticks()
    assert len(sticks.start) > 20
    with xr.open_dataset(study.directory / DATA) as dataset:
        for name in ("start", "end", "position", "ending"):
            np.testing.assert_array_equal(dataset[f"stick_{name}"], getattr(sticks, name))
        for name, estimate in STATISTICS.items():
            assert float(dataset[name]) == estimate(many).value
        assert dataset["stick_position"].attrs["long_name"] == "relative displacement when the stick starts"
        assert dataset.attrs["system_stiffness_1"].tolist() == [-1.2, 2.2]
        assert dataset.attrs["system_contacts_1_normal_force"] == 1.3
        assert dataset.attrs["run_initial_state_0_high"] == 0.5
        assert read_config(config_file(tmp_path, dataset.attrs["configuration"])) == study.config
    assert repr(ss.load(study.directory).summary()) == repr(many.summary())


@pytest.mark.slow
def test_figures(tmp_path):
    options = SHORT | {"out": str(tmp_path / "result")}
    study = run_study(read_config(None, options, example="two-blocks"), progress=False)
    plt.close("all")
    assert set(study.files) == set(RESULT_FILES)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "more", "method"),
    [
        ("diagonals", "width = 1e-3\nstep = 0.01\n", ss.Regularized(1e-3, step=0.01)),
        *(
            pytest.param(case, "", ss.Exact(), marks=pytest.mark.slow)
            for case in ("masses on each other", "normal force that jumps", "forces", "block_row")
        ),
    ],
)
def test_study_of_a_structure_is_its_ensemble(tmp_path, case, more, method):
    text, system = SYSTEMS[case]
    text = f"{text}[base]\nspeed = 0.3\n{RUN}{more}"
    config = read_config(config_file(tmp_path, text), {"out": str(tmp_path / "r")})
    study = run_study(config.model_copy(update={"output": config.output.model_copy(update={"figures": False})}))
    many = ss.simulate_ensemble(
        system,
        ss.PoissonSwitching(0.3, 1.0),
        t1=20.0,
        samples=20,
        key=jax.random.key(0),
        keep="sticks",
        chunk=64,
        threads=1,
        method=method,
    )
    for name in ("start", "end", "position", "ending"):
        found, expected = (getattr(one.require_sticks(), name) for one in (study.ensemble, many))
        np.testing.assert_array_equal(found, expected)


@pytest.mark.slow
def test_building_under_an_accelerogram(tmp_path):
    write_records(tmp_path)
    base = '[base]\nlaw = "GroundAcceleration"\nfile = "record.AT2"\nscale = 0.4\n[run]\nt1 = 10.0\nsamples = 2\n'
    config = read_config(config_file(tmp_path, STOREYS + base), {"out": str(tmp_path / "r"), "figures": False})
    sticks = run_study(config, progress=False).ensemble.require_sticks()
    building = ss.storeys_on_bearing([3.0, 2.0, 1.0], [50.0, 40.0], friction=ss.Coulomb(0.1))
    one = ss.simulate(building, ss.GroundAcceleration(TIMES, 0.4 * (9.80665 * VALUES)), t1=10.0).of_contact(0)
    count = int(one.sticks.count)
    assert len(sticks.start) == 2 * count > 4
    np.testing.assert_allclose(sticks.start[:count], one.sticks.start[:count], rtol=0, atol=1e-9)


SWEEP = '[sweep]\nkeep = "totals"\nstatistics = ["stick_fraction"]\n[sweep.over]\n'


@pytest.mark.slow
def test_sweep_over_numbers_of_a_structure(tmp_path):
    text = (
        f"{HEAD}{CONTACT}[base]\nspeed = 0.3\n[run]\nt1 = 20.0\nsamples = 30\ninitial_state = [0.1, 0.0, 0.0, 0.0]\n"
        f'{SWEEP}"contacts[0].friction.mu" = [0.1, 0.2]\n"initial_state[1]" = [0.0, 0.5]\n'
    )
    config = read_sweep_config(config_file(tmp_path, text))
    assert read_sweep_config(config_file(tmp_path, config.to_toml())) == config
    result = sweep_of(config).run(tmp_path / "sweep", threads=1, progress=False)
    assert result.stick_fraction.shape == (2, 2)
    many = ss.simulate_ensemble(
        structure(ss.Contact.of_mass(0, 2, 5.0, ss.Coulomb(0.1))),
        ss.PoissonSwitching(0.3, 1.0),
        t1=20.0,
        samples=30,
        key=jax.random.key(0),
        y0=(0.1, 0.5, 0.0, 0.0),
        keep="totals",
        threads=1,
    )
    assert float(result.stick_fraction[0, 1]) == pytest.approx(ss.stick_fraction(many).value, rel=1e-12)


# --- what is refused


@pytest.mark.parametrize("case", BAD_STRUCTURES)
def test_bad_file_is_one_sentence(tmp_path, case):
    text, expected = BAD_STRUCTURES[case]
    path = config_file(tmp_path, text)
    with pytest.raises(StudyError) as caught:
        read_config(path)
    message = str(caught.value)
    for part in [str(path), *expected]:
        assert part in message
    assert "\n" not in message
    assert "Argument" not in message
    assert message.endswith((".", "?"))


@pytest.mark.parametrize(
    ("normal_force", "run", "said"),
    [
        ('{ law = "Recorded", file = "record.csv", value_column = "force" }', "", "in [system], value_column must be"),
        ('{ law = "Recorded", times = [0, 9], values = [1, 2] }', "[run]\nt1 = 10.0", "normal_force must last until"),
        ("5.0", "[run]\nstep = 2.0", "step in [run] must be at most"),
    ],
)
def test_what_only_a_run_finds(tmp_path, normal_force, run, said):
    write_records(tmp_path)
    text = changed("5.0", normal_force) + run
    with pytest.raises(StudyError) as caught:
        run_study(read_config(config_file(tmp_path, text), {"out": str(tmp_path / "r")}))
    assert said in str(caught.value)
    assert "Argument" not in str(caught.value)
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    ("over", "said"),
    [
        ('"contacts[1].normal_force" = [1.0]', "must name one of"),
        ('"initial_state[4]" = [1.0]', "must name one of"),
        ('"contacts[0].normal_force" = [-1.0]', "must be positive"),
        ("stiffness = [1.0]", "must name one of"),
    ],
)
def test_bad_sweep(tmp_path, over, said):
    config = read_sweep_config(config_file(tmp_path, f"{HEAD}{CONTACT}{SWEEP}{over}\n"))
    with pytest.raises(StudyError) as caught:
        sweep_of(config)
    assert said in str(caught.value)
