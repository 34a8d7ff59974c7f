"""Programs kept from process to process: a wrong one is never run, and what is wrong with a file costs time alone."""

import contextlib
import functools
import io
import os
import signal
import subprocess
import sys
import textwrap
import time
import types
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache
from support.processes import in_processes

import stickslip_jax as ss
from stickslip_jax._compiler import identity as key
from stickslip_jax._compiler import programs as kept
from stickslip_jax._compiler.identity import Unidentified, identity
from stickslip_jax._compiler.programs import kept_jit

OSCILLATOR = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.5))


def module_of(code: str) -> types.ModuleType:
    """A module of a user, of this code."""
    module = types.ModuleType("of_a_user")
    sys.modules["of_a_user"] = module
    exec(textwrap.dedent(code), vars(module))
    return module


LAW = """
import functools
import io
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import stickslip_jax as ss

GLOBAL = 0.3
TABLE = {"a": [1.0, 2.0]}
ARRAY = np.array([1.0, 2.0])

def helper(x):
    return 2.0 * x

@jax.jit
def compiled(x):
    return 3.0 * x

class Above(eqx.Module):
    def inherited(self, x):
        return 4.0 * x

class Law(Above):
    low: float
    power: int = eqx.field(static=True, default=2)
    shared = 5.0

    def __call__(self, v, scale=1.5, *, extra=2.5):
        def inner(x):
            return x + 6.0
        found = GLOBAL + helper(v) + compiled(v) + self.inherited(v) + inner(v) + self.shared
        return found + TABLE["a"][0] + ARRAY[1] + closed(v) + bound(v) + scale + extra + self.low**self.power

def closing(number):
    return lambda x: number * x

closed = closing(7.0)
bound = functools.partial(lambda x, y: x * y, y=8.0)
law = Law(0.1)
"""

CHANGES = {
    "a global number": ("GLOBAL = 0.3", "GLOBAL = 0.4"),
    "an entry of a table": ("[1.0, 2.0]}", "[1.5, 2.0]}"),
    "an array": ("np.array([1.0, 2.0])", "np.array([1.0, 2.5])"),
    "the precision of an array": ("np.array([1.0, 2.0])", "np.array([1.0, 2.0], np.float32)"),
    "a function that is called": ("return 2.0 * x", "return 2.5 * x"),
    "its operation": ("return 2.0 * x", "return 2.0 + x"),
    "a function under jit": ("return 3.0 * x", "return 3.5 * x"),
    "a method of a superclass": ("return 4.0 * x", "return 4.5 * x"),
    "an attribute of the class": ("shared = 5.0", "shared = 5.5"),
    "a function within": ("x + 6.0", "x + 6.5"),
    "what a function encloses": ("closing(7.0)", "closing(7.5)"),
    "a bound argument": ("y=8.0", "y=8.5"),
    "a default": ("scale=1.5", "scale=1.75"),
    "a default by name": ("extra=2.5", "extra=2.75"),
    "a static field": ("law = Law(0.1)", "law = Law(0.1, power=3)"),
    "the default of a field": ("static=True, default=2", "static=True, default=3"),
    "a subclass": ("law = Law(0.1)", "class Other(Law): pass\nlaw = Other(0.1)"),
    "a method that a subclass overrides": (
        "law = Law(0.1)",
        "class Law(Law):\n    def inherited(self, x):\n        return x\nlaw = Law(0.1)",
    ),
    "the type of a number": ("law = Law(0.1)", "law = Law(1)"),
    "the shape of a number": ("law = Law(0.1)", "law = Law(jnp.ones(2))"),
    "a number that is strongly typed": ("law = Law(0.1)", "law = Law(jnp.asarray(0.1))"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_a_law_reads_is_part_of_the_key(change):
    old, new = CHANGES[change]
    assert LAW.count(old) == 1
    before = identity(arguments=module_of(LAW).law)
    assert before == identity(arguments=module_of(LAW).law)
    assert before != identity(arguments=module_of(LAW.replace(old, new)).law)


def test_numbers_in_arguments_are_not_part_of_the_key():
    module = module_of(LAW)
    assert identity(arguments=module.Law(0.1)) == identity(arguments=module.Law(0.2))
    assert identity(arguments=jnp.zeros(3)) == identity(arguments=jnp.ones(3))
    assert identity(arguments=OSCILLATOR) == identity(arguments=eqx.tree_at(lambda one: one.mass, OSCILLATOR, 2.0))


STICKING = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
LAWS = ss.PoissonSwitching(1.0, 2.6), ss.SquareWave(1.0, 2.6)
PAIRS = [
    (1, 1.0), (1, True), (0.0, -0.0), ("1", 1), (b"1", "1"), ((1, 2), [1, 2]), ((1, (2, 3)), (1, 2, 3)),
    (("ab", "c"), ("a", "bc")), ({1: 2}, {2: 1}), ({1, 2}, {1, 3}), (np.float32(1), np.float64(1)),
    (np.ones(2), np.ones((1, 2))), (np.ones(2), jnp.ones(2)), (jax.random.key(0), jax.random.key(1)),
    (None, ()), (ss.Coulomb, ss.Stribeck), (jnp.sin, jnp.cos), (np.sin, jnp.sin),
    (ss.Ending.HORIZON, ss.Ending.RELEASED),
    (functools.partial(jnp.add, 1), functools.partial(jnp.add, 2)), (1e300, float("inf")), (slice(1), slice(2)),
    (jax.tree.structure([1, 2]), jax.tree.structure([1, [2]])), (jax.tree.structure([1]), jax.tree.structure((1,))),
    (jax.tree.structure({"a": 1}), jax.tree.structure({"b": 1})), (jax.tree.structure(None), jax.tree.structure(())),
    (jax.tree.structure(ss.Coulomb(1.0)), jax.tree.structure(ss.VelocityWeakening(1.0, 1.0))),
    (jax.tree.structure(ss.Exact(1.0)), jax.tree.structure(ss.Exact(1.0, max_steps=5))),
    (jax.tree.structure(LAWS[0]), jax.tree.structure(LAWS[1])), (LAWS[0], LAWS[1]),
]  # fmt: skip


@pytest.mark.parametrize("pair", PAIRS, ids=range(len(PAIRS)))
def test_different_values_have_different_keys(pair):
    one, other = pair
    assert identity(one) != identity(other)
    assert identity(one) == identity(one)


def test_the_same_object_twice_is_not_two_equal_ones():
    one, other = [1.0], [1.0]
    assert identity([one, one]) != identity([one, other])
    ring: list = []
    ring.append(ring)
    assert identity(ring) == identity(ring)


UNIDENTIFIED = {
    "a clock": "import time\nlaw = lambda x: x * time.time()",
    "the environment": "import os\nlaw = lambda x: x * float(os.environ['A'])",
    "random numbers of NumPy": "import numpy as np\nlaw = lambda x: x * np.random.rand()",
    "a generator of NumPy": "import numpy as np\nrng = np.random.default_rng(0)\nlaw = lambda x: x * rng.random()",
    "random numbers under another name": "from numpy.random import rand\nlaw = lambda x: x * rand()",
    "random numbers of Python": "import random\nlaw = lambda x: x * random.random()",
    "an import within": "def law(x):\n    import random\n    return x * random.random()",
    "a file": "law = lambda x: x * float(open('a').read())",
    "a file of NumPy": "import numpy as np\nlaw = lambda x: x * np.load('a.npy')",
    "a file of equinox": "import equinox as eqx\nlaw = lambda x: x * eqx.tree_deserialise_leaves('a', x)",
    "a file of records": "import stickslip_jax as ss\nlaw = lambda x: x * ss.read_at2('a').times[0]",
    "a pattern": "import re\npattern = re.compile('a')\nlaw = lambda x: x * bool(pattern)",
    "a decimal": "import decimal\ntwo = decimal.Decimal(2)\nlaw = lambda x: x * float(two)",
    "a deque": "import collections\nheld = collections.deque([1.0])\nlaw = lambda x: x * held[0]",
    "a counter": "import itertools\nheld = itertools.count()\nlaw = lambda x: x * next(held)",
    "a device": "import jax\nheld = jax.devices()[0]\nlaw = lambda x: x * held.id",
    "a method of a file of NumPy": "from numpy import genfromtxt\nlaw = lambda x: x * genfromtxt('a')",
    "names by words": "law = lambda x: getattr(x, 'T')",
    "all globals": "law = lambda x: globals()['x']",
    "code in words": "law = lambda x: eval('x')",
    "an object of C": "import threading\nlock = threading.Lock()\nlaw = lambda x: x * lock.locked()",
    "a name that is missing": "law = lambda x: x * missing",
    "an iterator": "numbers = iter([1.0, 2.0])\nlaw = lambda x: x * next(numbers)",
    "objects in an array": "import numpy as np\nob = np.array([[], 1], object)\nlaw = lambda x: x * ob[1]",
    "masked entries": "import numpy as np\nma = np.ma.array([1.0, 2.0], mask=[0, 1])\nlaw = lambda x: x * ma[0]",
    "a dict of its own kind": "import os\nenvironment = os.environ\nlaw = lambda x: x * len(environment)",
}


@pytest.mark.parametrize("what", UNIDENTIFIED)
def test_what_may_change_unseen_is_not_identified(what):
    with pytest.raises(Unidentified):
        identity(module_of(UNIDENTIFIED[what]).law)


def test_modules_of_a_user_are_followed_by_the_names_that_are_asked_for(monkeypatch):
    other = types.ModuleType("other_of_a_user")
    monkeypatch.setitem(sys.modules, "other_of_a_user", other)
    other.used, other.unused = 1.0, 1.0  # pyright: ignore[reportAttributeAccessIssue]
    law = module_of("import other_of_a_user\nlaw = lambda x: x * other_of_a_user.used").law
    before = identity(law)
    other.unused = 2.0  # pyright: ignore[reportAttributeAccessIssue]
    assert identity(law) == before
    other.used = 2.0  # pyright: ignore[reportAttributeAccessIssue]
    assert identity(law) != before


def test_modules_of_a_user_may_have_names_of_the_library(monkeypatch, tmp_path):
    other = types.ModuleType("numbers")
    other.__file__ = str(tmp_path / "numbers.py")
    monkeypatch.setitem(sys.modules, "numbers", other)
    before = []
    for factor in (2.0, 3.0):
        exec(f"def half(x):\n    return x / {factor}\n", vars(other))
        with contextlib.suppress(Unidentified):
            before.append(identity(vars(other)["half"]))
    assert len(set(before)) in (0, 2)


def test_machine_and_options_are_part_of_the_key(monkeypatch):
    about, options = key.this_machine.__wrapped__(), key.options_now()
    with jax.enable_x64(False):
        assert key.options_now() != options
    with jax.default_matmul_precision("highest"):
        assert key.options_now() != options
    with jax.numpy_dtype_promotion("strict"):
        assert key.options_now() != options
    with jax.default_prng_impl("rbg"):
        assert key.options_now() != options
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=true")
    assert key.options_now() != options
    if hasattr(os, "sched_getaffinity"):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(99)))
        assert key.this_machine.__wrapped__() != about
        monkeypatch.undo()
    for name, value in (("version", lambda _: "0.0"), ("PACKAGES", frozenset(("jax",)))):
        monkeypatch.setattr(key, name, value)
        assert key.this_machine.__wrapped__() != about
        monkeypatch.undo()
    monkeypatch.setattr(Path, "read_bytes", lambda _: b"other source")
    assert key.this_machine.__wrapped__() != about


# With a folder.


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder for programs, private as it must be."""
    path, of_jax = tmp_path / "programs", jax.config.jax_compilation_cache_dir
    monkeypatch.setenv(kept.VARIABLE, str(path))
    jax.config.update("jax_compilation_cache_dir", None)  # programs from there are not kept
    compilation_cache.reset_cache()
    yield path
    jax.config.update("jax_compilation_cache_dir", of_jax)
    compilation_cache.reset_cache()


def entries(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if not path.name.startswith("half-")] if folder.exists() else []


@pytest.fixture
def compiled(monkeypatch):
    """The names of the programs that are compiled to be kept, in turn."""
    names, write = [], kept._write
    monkeypatch.setattr(kept, "_write", lambda path, *rest: names.append(path.name) or write(path, *rest))
    return names


def rooted(x, *, power):
    return {"root": jnp.sqrt(x), "power": (x**power, jnp.sum(x)), "no": None}


def test_a_program_is_loaded_and_gives_the_same_bits(folder, compiled):
    x = jnp.arange(1.0, 5.0)
    first, again = (kept_jit(rooted, static_argnames="power")(x, power=3) for _ in range(2))
    assert len(compiled) == len(entries(folder)) == 1
    assert jax.tree.structure(first) == jax.tree.structure(again) == jax.tree.structure(rooted(x, power=3))
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        assert (one.dtype, one.weak_type) == (other.dtype, other.weak_type)
        np.testing.assert_array_equal(one, other)
    kept_jit(rooted, static_argnames="power")(x, power=2)
    kept_jit(rooted, static_argnames="power")(x[:3], power=2)
    kept_jit(rooted, static_argnames="power")(x.astype(jnp.float32), power=2)
    with jax.enable_x64(False):
        kept_jit(rooted, static_argnames="power")(x.astype(jnp.float32), power=2)
    assert len(set(compiled)) == len(entries(folder)) == 5


def test_static_arguments_may_stand_anywhere(folder):
    def scaled(x, power, y=1.0, *, words):
        return x**power + y + len(words)

    one = kept_jit(scaled, static_argnames=("power", "words"))
    for _ in range(2):
        assert float(one(2.0, 3, words="ab")) == 11.0
        assert float(one(2.0, power=3, y=2.0, words="ab")) == 12.0
        assert float(one(words="abc", y=2.0, power=2, x=3)) == 14.0
    with pytest.raises(TypeError):
        one(2.0, words="ab")


def test_filtered_arguments_are_static_unless_they_are_arrays(folder, compiled):
    def applied(function, x, number):
        return function(x) * number

    for number in (2, 2, 3):
        one = kept_jit(applied, filtered=True)
        assert float(one(jnp.sqrt, jnp.asarray(4.0), number)) == 2.0 * number
        assert float(one(jnp.square, jnp.asarray(4.0), number)) == 16.0 * number
    assert len(compiled) == 4


def test_under_other_transformations_it_is_jit(folder, compiled):
    one = kept_jit(lambda x: jnp.sum(jnp.sin(x) ** 2))
    x = jnp.arange(3.0)
    np.testing.assert_allclose(jax.grad(one)(x), np.sin(2 * np.arange(3.0)))
    np.testing.assert_allclose(jax.vmap(jax.grad(one))(x), np.sin(2 * np.arange(3.0)))
    np.testing.assert_allclose(jax.jit(jax.vmap(one))(x), np.sin(np.arange(3.0)) ** 2)
    np.testing.assert_allclose(jax.jit(one)(x), one.lower(x).compile()(x))
    jax.jvp(one, (x,), (x,))
    assert not compiled
    with jax.disable_jit():
        one(x)
    with jax.debug_nans(True), pytest.raises(FloatingPointError):
        kept_jit(jnp.log)(jnp.asarray(-1.0))
    assert not compiled


BATCHES = {
    "one mapped": lambda f, x, y: jax.vmap(lambda x: f(x, y[0]))(x),
    "the other": lambda f, x, y: jax.vmap(lambda y: f(x[0], y))(y),
    "both": lambda f, x, y: jax.vmap(f)(x, y),
    "a batch of batches": lambda f, x, y: jax.vmap(lambda x: jax.vmap(lambda y: f(x, y))(y))(x),
    "nothing mapped": lambda f, x, y: jax.vmap(lambda _: f(x[0], y[0]))(x),
    "along another axis": lambda f, x, y: jax.vmap(lambda x: f(x, y), in_axes=0, out_axes=-1)(jnp.stack([x, y])),
}


@pytest.mark.slow
@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("batch", BATCHES)
def test_a_batch_is_a_program(batch, filtered, folder, compiled):
    """With the numbers of ``jax.jit``, compiled once; under derivatives it is ``jax.jit`` itself."""

    def function(x, y, *, power=2):
        return {"of": (x**power * y, y + 1)}

    def run(jitted):
        return BATCHES[batch](jitted, jnp.arange(1.0, 4.0), jnp.arange(2.0, 5.0))

    wanted, options = run(jax.jit(function)), {} if filtered else {"static_argnames": "power"}
    for _ in range(2):  # the second from the folder
        found = run(kept_jit(function, filtered=filtered, **options))
        assert jax.tree.structure(found) == jax.tree.structure(wanted)
        for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
            np.testing.assert_array_equal(one, other)
            assert isinstance(one, jax.Array)
    assert len(entries(folder)) == len(compiled) == 1
    slopes = jax.vmap(jax.grad(lambda x: kept_jit(function, **options)(x, 2.0)["of"][0]))(jnp.arange(3.0))
    np.testing.assert_array_equal(slopes, 4 * jnp.arange(3.0))


def test_programs_that_call_python_are_not_kept(folder, capfd):
    def printing(x):
        jax.debug.print("x = {}", x)
        return 2 * x

    def calling(x):
        return jax.pure_callback(lambda x: np.asarray(x) + 1, x, x)

    for _ in range(2):
        assert float(kept_jit(printing)(1.5)) == 3.0
        assert float(kept_jit(calling)(jnp.asarray(1.5))) == 2.5
    jax.effects_barrier()
    assert capfd.readouterr().out.count("x = 1.5") == 2
    assert not entries(folder)


def test_caches_that_are_cleared_are_cleared(folder, compiled):
    one = kept_jit(lambda x: 2 * x)
    one(1.0)
    assert one.programs
    jax.clear_caches()
    one(1)
    assert len(one.programs) == 1


def wrong(data: bytes) -> dict[str, bytes]:
    middle = len(data) // 2
    return {
        "empty": b"",
        "cut off": data[:middle],
        "a byte short": data[:-1],
        "one flipped bit": data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :],
        "one flipped bit of the sum": bytes([data[0] ^ 1]) + data[1:],
        "another file": b"#!/bin/sh\n",
        "zeros": bytes(len(data)),
    }


@pytest.mark.parametrize("what", wrong(b"12"))
def test_a_wrong_entry_costs_a_compilation_and_is_mended(what, folder, compiled):
    def doubled(x):
        return 2 * x

    kept_jit(doubled)(1.0)
    (path,) = entries(folder)
    path.write_bytes(wrong(path.read_bytes())[what])
    assert float(kept_jit(doubled)(1.0)) == float(kept_jit(doubled)(1.0)) == 2.0
    assert len(compiled) == 2
    assert kept._read(path, 1, []) is not None


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_a_folder_that_others_may_write_or_read_is_refused(folder, compiled):
    for mode in (0o777, 0o750, 0o705, 0o720):
        folder.mkdir(exist_ok=True)
        folder.chmod(mode)
        assert float(kept_jit(lambda x: 2 * x)(1.0)) == 2.0
        assert not compiled
    folder.chmod(0o700)
    kept_jit(lambda x: 2 * x)(1.0)
    assert len(compiled) == 1
    assert folder.stat().st_mode & 0o077 == 0
    assert all(path.stat().st_mode & 0o077 == 0 for path in entries(folder))


def test_a_folder_of_somebody_else_is_refused(folder, compiled, monkeypatch):
    folder.mkdir(mode=0o700)
    monkeypatch.setattr(os, "getuid", lambda: folder.stat().st_uid + 1)
    kept_jit(lambda x: 2 * x)(1.0)
    assert not compiled


@pytest.mark.parametrize("name", ["off", "OFF", "a file", "\0"])
def test_without_a_folder_nothing_is_kept(name, tmp_path, monkeypatch, compiled):
    (tmp_path / "a file").touch()
    monkeypatch.setattr(
        os, "environ", {**os.environ, kept.VARIABLE: str(tmp_path / name) if name == "a file" else name}
    )
    assert float(kept_jit(lambda x: 2 * x)(1.0)) == 2.0
    assert not compiled


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such limit")
def test_programs_go_where_memory_maps_run_out(folder, monkeypatch, compiled):
    def maps():
        return len(Path("/proc/self/maps").read_bytes().splitlines())

    @functools.partial(kept_jit, static_argnames="number")
    def power(x, *, number):
        return jax.lax.fori_loop(0, 3, lambda _, y: jnp.sin(y) ** number, x)

    found = [power(1.0, number=number) for number in range(2, 10)]
    assert len(power.programs) == 8
    before = maps()
    monkeypatch.setattr(kept, "_MOST_MAPS", 0)
    assert power(1.0, number=10) < found[0]
    assert len(power.programs) == 1
    assert maps() < before
    monkeypatch.undo()
    assert [power(1.0, number=number) for number in range(2, 10)] == found


def test_a_program_that_is_not_of_its_sum_is_not_run(folder, compiled):
    """Not even one that could be: that of another function."""

    def of(factor):
        return kept_jit(lambda x: factor * x)

    assert float(of(2.0)(1.0)) == 2.0
    (path,) = entries(folder)
    assert float(of(3.0)(1.0)) == 3.0
    (other,) = set(entries(folder)) - {path}
    path.write_bytes(path.read_bytes()[:32] + other.read_bytes()[32:])
    assert float(of(2.0)(1.0)) == 2.0
    assert compiled == [path.name, other.name, path.name]


def test_a_full_disk_costs_nothing(folder, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    assert float(kept_jit(lambda x: 2 * x)(1.0)) == 2.0
    assert not entries(folder)


def test_what_was_not_used_for_long_goes_first(folder, monkeypatch):
    for power in range(1, 6):
        kept_jit(rooted, static_argnames="power")(1.0, power=power)
        for number, path in enumerate(sorted(entries(folder), key=lambda one: one.stat().st_mtime)):
            os.utime(path, (number, number))
    by_age = sorted(entries(folder), key=lambda one: one.stat().st_mtime)
    half = folder / "half-of-a-killed-process"
    half.touch()
    os.utime(half, (1, 1))
    kept_jit(rooted, static_argnames="power")(1.0, power=1)  # the oldest is used
    monkeypatch.setattr(kept, "LARGEST", int(3.9 * by_age[0].stat().st_size))
    kept_jit(rooted, static_argnames="power")(1.0, power=7)
    left = set(entries(folder))
    assert len(left) == 3
    assert {by_age[0], by_age[-1]} < left
    assert not half.exists()


@pytest.mark.slow
def test_results_that_hold_functions_without_a_name_are_kept(folder, compiled):
    """A simulation holds its system, and that a curve: here a function that no other process could import."""
    ends = []
    for _ in range(2):
        jax.clear_caches()
        for factor in (0.1, 0.2):
            law = ss.FrictionCurve(lambda v, factor=factor: 1.0 - factor * jnp.tanh(v))
            system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=law)
            one = ss.simulate(system, ss.Harmonic(1.0, 2.6), t1=5.0, y0=(0.0, 1.0))
            assert one.system.friction.curve is law.curve
            ends.append([float(number) for number in (*one.final_state, one.peak())])
    assert ends[:2] == ends[2:]
    assert ends[0] != ends[1]
    assert len(compiled) == len(set(compiled)) == len(entries(folder))


@pytest.mark.slow
def test_laws_with_the_same_numbers_have_programs_of_their_own(folder):
    """A random one first, then one of the same speed and rate whose samples are all the same."""
    for _ in range(2):
        jax.clear_caches()
        for law, repeats in zip(LAWS, (0, 1), strict=True):
            many = ss.simulate_ensemble(
                STICKING,
                law,
                t1=40.0,
                samples=50,
                y0=(0.0, 1.0),
                chunk=64,
                key=None if repeats else jax.random.key(0),
            )
            assert many.statistics.duration.repeated_share.value == repeats
    assert entries(folder)


# In processes of their own.

STUDY = """
import sys
import jax
import numpy as np
jax.config.update("jax_enable_x64", True)
import stickslip_jax as ss
from stickslip_jax._compiler import programs as kept
compiled, write = [], kept._write
kept._write = lambda path, *rest: compiled.append(path.name) or write(path, *rest)
system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.5))
one = ss.simulate(system, ss.Constant(1.0), t1=20.0, y0=(0.0, 1.0))
print(np.asarray(one.final_state).tobytes().hex(), np.asarray(one.sticks.start).tobytes().hex(), len(compiled))
"""


def test_a_second_process_compiles_nothing(folder):
    (first,), (second,) = in_processes(1, STUDY, folder), in_processes(1, STUDY, folder)
    assert int(first.split()[-1]) == len(entries(folder)) > 0
    assert second.split()[-1] == "0"
    assert first.split()[:-1] == second.split()[:-1]


@pytest.mark.slow
def test_what_jax_has_from_its_own_cache_is_not_kept(folder, tmp_path):
    """Written again, such a program lacks functions, and ends the next process that runs it."""
    own = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "of jax"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "0",
    }
    (first,) = in_processes(1, STUDY, folder / "one", **own)
    second, third = (in_processes(1, STUDY, folder / "other", **own)[0] for _ in range(2))
    assert not entries(folder / "other")
    assert first.split()[:2] == second.split()[:2] == third.split()[:2]


WRITING = """
import os, sys
from stickslip_jax._compiler import programs as kept
replace = os.replace
def waiting(*args):
    print("written", flush=True)
    sys.stdin.read()
os.replace = waiting
kept.kept_jit(lambda x: 2 * x)(1.0)
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_kill_while_writing_leaves_no_entry(folder):
    environment, piped = {**os.environ, kept.VARIABLE: str(folder)}, subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", WRITING], stdin=piped, stdout=piped, env=environment) as one:
        assert one.stdout is not None
        assert one.stdout.readline() == b"written\n"
        one.send_signal(signal.SIGKILL)
    assert len(list(folder.iterdir())) == 1
    assert not entries(folder)


STARTS = """
import sys
import jax.numpy as jnp
from stickslip_jax._compiler import programs as kept
for number in range(int(sys.argv[1])):
    power = number % 7
    def raised(x, *, power):
        return jnp.sum(x**power)
    found = float(kept.kept_jit(raised, static_argnames="power")(jnp.arange(3.0), power=power))
    assert found == float(0**power + 1 + 2**power), (found, power)
"""


@pytest.mark.parametrize(
    ("processes", "starts"), [(2, 20), pytest.param(8, 125, marks=pytest.mark.slow)], ids=["forty", "a thousand"]
)
def test_starts_of_many_processes_at_once(folder, processes, starts):
    """Each start of a program asks the folder anew; bits of entries flip meanwhile, and entries go."""
    environment = {**os.environ, kept.VARIABLE: str(folder)}
    started = [subprocess.Popen([sys.executable, "-c", STARTS, str(starts)], env=environment) for _ in range(processes)]
    rng = np.random.default_rng(0)
    while any(one.poll() is None for one in started):
        time.sleep(0.05)
        for path in entries(folder):
            with contextlib.suppress(OSError):
                data = bytearray(path.read_bytes())
                if data and rng.random() < 0.3:
                    data[rng.integers(len(data))] ^= 1 << rng.integers(8)
                    path.write_bytes(data)
                elif rng.random() < 0.1:
                    path.unlink()
    assert [one.returncode for one in started] == [0] * processes


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("seconds", [0.0, 0.2])
def test_a_line_tells_of_long_compilations_and_goes(seconds, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(kept, "_PATIENCE", 0.05)
    with kept._telling_that_it_compiles():
        time.sleep(seconds)
    said = terminal.getvalue()
    assert ("compiling" in said) == (seconds > 0)
    assert said.endswith("\r\033[K" if said else "")


def test_files_and_notebooks_are_told_nothing(monkeypatch):
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    monkeypatch.setattr(kept, "_PATIENCE", 0.01)
    with kept._telling_that_it_compiles():
        time.sleep(0.05)
    assert sys.stderr.getvalue() == ""
