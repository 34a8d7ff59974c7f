"""Sweeps that are stopped by force: small ones, in this process and in others, and what is left of their folders."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

import stickslip_jax as ss

TESTS = Path(__file__).parents[1]
SYSTEM, LAW = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0)), ss.PoissonSwitching(speed=1.0, rate=1.0)


def sweep_of(system: Any = SYSTEM, law: Any = LAW, **changes: Any) -> ss.Sweep:
    """A sweep of two points, with two batches at each, unless `changes` say otherwise."""
    usual = {"over": {"mu": [0.5, 1.0]}, "t1": 20.0, "samples": 500, "batch": 256, "key": jax.random.key(0)}
    usual |= {"y0": (0.0, 1.0), "keep": "totals"}
    return ss.Sweep(system, law, **{**usual, **changes})


def long_sweep() -> ss.Sweep:
    """One with many batches, to be killed again and again."""
    return sweep_of(over={"mu": np.linspace(0.5, 1.2, 4)}, samples=30 * 256)


def run(sweep: ss.Sweep, folder: Path | None) -> Any:
    """The data set of a sweep run in two threads."""
    return sweep.run(folder, threads=2, progress=False)


def assert_same(one: Any, other: Any) -> None:
    """Assert that two data sets are the same to the last bit, but for the time that was spent."""
    assert set(one.variables) == set(other.variables)
    # What was asked for may differ: the sum of the manifest tells that.
    assert {**one.attrs, "manifest_sha256": ""} == {**other.attrs, "manifest_sha256": ""}
    for name in set(one.variables) - {"run_seconds"}:
        assert one[name].dims == other[name].dims, name
        assert one[name].dtype == other[name].dtype, name
        assert one[name].values.tobytes() == other[name].values.tobytes(), name


def files_in(folder: Path) -> dict[str, bytes]:
    """What all files hold, by name."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def one_sentence(error: Any, *parts: str) -> str:
    """The message of an error, asserted to be one sentence with these `parts`, which says what to do."""
    said = str(error.value)
    assert re.fullmatch(r"[^\n]*[^.\n]\.", said), said
    assert "; " in said, said  # what is wrong; what to do
    assert not re.search(r"\.\s+[A-Z]", said), said
    for part in parts:
        assert part in said, said
    return said


@contextmanager
def failing(folder: Path, fail: Callable[[int, str, Any], None]) -> Iterator[None]:
    """Call `fail` with the number, name and object of every operation that changes `folder`, before it is done.

    The operations are those of the store: what is between two of them leaves nothing on the disk but a part of a file
    with a temporary name, which is there when ``fsync`` is called.
    """
    from stickslip_jax._foundation import files as _files  # noqa: PLC0415

    number = 0

    def noted(name: str, of: Any) -> None:
        nonlocal number
        number += 1
        fail(number, name, of)

    def method(name: str) -> Callable[..., Any]:
        original = getattr(Path, name)

        def changed(self: Path, *more: Any, **options: Any) -> Any:
            if self == folder or folder in self.parents:
                noted(name, self)
            return original(self, *more, **options)

        return changed

    def fsync(handle: int) -> None:
        noted("fsync", handle)
        os.fsync(handle)

    with pytest.MonkeyPatch.context() as patch:
        for name in ("replace", "unlink", "mkdir"):
            patch.setattr(Path, name, method(name))
        patch.setattr(_files, "os", SimpleNamespace(**{**vars(os), "fsync": fsync}))
        yield


def halve_file(name: str, of: Any) -> None:
    """Leave half of a file that is being written."""
    if name == "fsync" and not os.path.isdir(f"/proc/self/fd/{of}"):
        try:
            os.ftruncate(of, os.fstat(of).st_size // 2)
        except OSError:  # of a folder, where there is no /proc
            return


# --- in a process of its own: python -m support.faults long FOLDER, or python -m support.faults NUMBER FOLDER


def started(what: str, folder: Path) -> subprocess.Popen[str]:
    """A process that runs the long sweep (`what` = "long"), or the small one and kills itself at operation `what`."""
    paths = [str(TESTS), str(TESTS.parent), os.environ.get("PYTHONPATH", "")]
    command = [sys.executable, "-m", "support.faults", what, str(folder)]
    return subprocess.Popen(
        command, env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)}, stderr=subprocess.PIPE, text=True
    )


def _main(what: str, folder: Path) -> None:
    jax.config.update("jax_enable_x64", True)
    if what == "long":
        run(long_sweep(), folder)
        return

    def fail(number: int, name: str, of: Any) -> None:
        if number == int(what):
            halve_file(name, of)
            os.kill(os.getpid(), signal.SIGKILL)

    with failing(folder, fail):
        run(sweep_of(), folder)


if __name__ == "__main__":
    _main(sys.argv[1], Path(sys.argv[2]))


def log_of(folder: Path | str) -> str:
    """The log of a sweep; empty if there is none yet."""
    log = Path(folder) / "log.txt"
    return log.read_text() if log.exists() else ""


def wait_for(true, seconds: float = 240.0) -> Any:
    """Wait until a function gives something true; its value."""
    end = time.monotonic() + seconds
    while not (value := true()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)
    return value
