"""JAX's persistent compilation cache in the user's cache folder, for the command and the tests, not the library."""

import hashlib
import os
import platform
import sys
import tempfile
import time
import warnings
from importlib.util import find_spec
from pathlib import Path

import jax

VARIABLE = "STICKSLIP_COMPILATION_CACHE"
"""The environment variable that chooses the folder; "off" turns the cache off."""
SHORTEST = 0.1
"""Shortest compilation that is kept, s."""
LARGEST = 2**30
"""Largest size of the folder, bytes; the least recently used entries are deleted first."""


def use() -> str:
    """Switch the cache on for this process, unless it is on already or turned off; returns what failed, or "".

    Several processes may share the folder: JAX locks it. A folder that cannot be written, or an entry that cannot be
    read, costs a compilation and nothing else.
    """
    wanted = os.environ.get(VARIABLE, "")
    if wanted.lower() == "off" or getattr(jax.config, "jax_compilation_cache_dir", None):
        return ""
    folder = Path(wanted).expanduser() if wanted else _caches() / "stickslip_jax" / f"compiled-{_processor()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        _remove_halves(folder)
    except (OSError, RuntimeError, ValueError) as error:  # no home folder, or not a folder name
        return f"Compilations are not kept ({error}); {VARIABLE} chooses a folder for them, or off."
    # Without a limit JAX does not lock the folder, and another process may read a half-written entry.
    if find_spec("filelock") is not None:
        jax.config.update("jax_compilation_cache_max_size", LARGEST)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", SHORTEST)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # Where an entry cannot be read JAX compiles again; a warning about that is of no use to the user.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache", UserWarning)
    return ""


def _caches() -> Path:
    """The user's cache folder, by the conventions of the operating system."""
    if sys.platform == "win32" and (folder := os.environ.get("LOCALAPPDATA")):
        return Path(folder)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _processor() -> str:
    """A name for the features of this processor: different machines may share a home folder, but not native code."""
    try:
        lines = Path("/proc/cpuinfo").read_bytes().splitlines()
        features = next(line for line in lines if line.lower().startswith((b"flags", b"features")))
    except (OSError, StopIteration):
        features = platform.processor().encode()
    return f"{platform.machine()}-{hashlib.sha256(features).hexdigest()[:8]}"


def _remove_halves(folder: Path) -> None:
    """Remove entries that a killed process left half-written: they have no time of use, which JAX writes last."""
    noted = {path.name.removesuffix("-atime") for path in folder.glob("*-atime")}
    for path in folder.glob("*-cache") if noted else ():
        if path.name.removesuffix("-cache") not in noted and path.stat().st_mtime < time.time() - 60:
            path.unlink(missing_ok=True)
