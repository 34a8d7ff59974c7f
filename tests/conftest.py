"""Settings of the whole test session: float64, annotations checked at run time, repeatable property tests."""

import gc
import itertools
import os
import signal
from importlib import import_module
from pathlib import Path

import jax
import jaxtyping
import pytest
from hypothesis import HealthCheck, settings

# A shell that starts the tests in the background has them ignore Ctrl-C, and every process that they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Tracing makes many objects that stay: to look for garbage after every 700 new ones took a fifth of the time it takes.
gc.set_threshold(100_000, 50, 50)

jax.config.update("jax_enable_x64", True)
# Arrays of different ranks combine only where the code says how: broadcasting that nobody meant is an error.
jax.config.update("jax_numpy_rank_promotion", "raise")

# Comparisons in the shared helpers explain themselves as those in the test files do.
pytest.register_assert_rewrite("support")

# The hook must be in place before the package is first imported.
import_module("support.annotations").check_annotations("stickslip_jax")

# The package's first import, annotations checked.
_programs = import_module("stickslip_jax._compiler.programs")

# Processes of pytest-xdist, and runs one after another, share what one of them has compiled: what the package keeps,
# and what tests compile themselves.
_compilation_cache = import_module("support.compilation_cache")
_compilation_cache.use(_compilation_cache.FOLDER)
os.environ.setdefault(_programs.VARIABLE, str(_compilation_cache.FOLDER.with_name("programs-of-tests")))

settings.register_profile(
    "repeatable", deadline=None, derandomize=True, max_examples=100, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("repeatable")


@pytest.fixture
def annotations_unchecked():
    """Switch the annotation checks off, so that the package's own argument checks answer, as they do for users."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(autouse=True)
def _programs_of_changed_code_are_not_kept(request):
    """A test that changes the package in place must not leave its programs to others, nor get theirs."""
    chosen = os.environ.get(_programs.VARIABLE)
    if "monkeypatch" in request.fixturenames:
        os.environ[_programs.VARIABLE] = "off"
    yield
    os.environ.pop(_programs.VARIABLE, None)
    if chosen is not None:
        os.environ[_programs.VARIABLE] = chosen


# What `make test-device` leaves out (docs/devices.md), by the beginning of the test's name, and why.
CPUS_ALONE = {
    "compiler/": "native loops, options of the compiler and kept programs are those of CPUs",
    "package/": "the package's shape, its pages and its processes are the same on any device, and tested on CPUs",
    "browser/": "pages in a browser compute nothing on the device",
    "ensemble/test_native.py": "native loops are those of CPUs",
    "ensemble/test_devices.py": "compares the layout of CPUs with that of a device that it makes up",
    "ensemble/test_many_lanes.py": "compares the layout of CPUs with that of many lanes",
    "ensemble/test_ensemble.py::test_one_compilation": "counts the native loops of CPUs",
    "sweep/test_executors.py": "processes would share one device",
}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Of a test that is `slow_for` some of its cases, these are slow; `slow_but_for` them, all others."""
    unused = {}
    for item in items:
        name = f"{item.path.relative_to(Path(__file__).parent).as_posix()}::{item.name}"
        why = [reason for begin, reason in CPUS_ALONE.items() if name.startswith(begin)]
        if why and os.environ.get("STICKSLIP_TESTED_DEVICE"):
            item.add_marker(pytest.mark.skip(reason=why[0]))
        for marker in (one for one in item.iter_markers() if one.name in ("slow_for", "slow_but_for")):
            case, asked = item.callspec.id, unused.setdefault(item.nodeid.partition("[")[0], set(marker.args))
            asked.discard(case)
            if (case in marker.args) == (marker.name == "slow_for"):
                item.add_marker(pytest.mark.slow)
    if any(unused.values()) and not any("::" in argument for argument in config.args):
        raise pytest.UsageError(f"slow_for and slow_but_for name cases that there are not: {unused}")


_tests = itertools.count()


@pytest.fixture(autouse=True)
def _compiled_code_is_let_go(request):
    """Compiled code takes memory maps. Linux allows a process 65,530; XLA ends it where there are no more.

    Looking takes up to 20 ms; of the tests that are not slow, eight add at most 12,000.
    """
    yield
    maps = Path("/proc/self/maps")
    looks = request.node.get_closest_marker("slow") or next(_tests) % 8 == 0
    if looks and maps.exists() and len(maps.read_bytes().splitlines()) > 30_000:
        jax.clear_caches()


@pytest.fixture
def in_an_empty_folder(tmp_path, monkeypatch):
    """Let the command work in an empty folder, without settings of its own: all tests of a process share theirs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("stickslip_jax.study._commands.prepare_jax", lambda dtype: None)
