"""JAX's persistent compilation cache in the user's cache folder: for the command and the tests, not for the library."""

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
"""Compilations that take less are not kept, s."""
LARGEST = 2**30
"""Bytes that the folder may take; what was not used for longest goes first."""


def use() -> str:
    """Switch the cache on for this process, unless it is chosen already or not wanted; returns what went wrong, if so.

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
    except (OSError, RuntimeError, ValueError) as error:  # no home, or no name of a folder
        return f"Compilations are not kept ({error}); {VARIABLE} chooses a folder for them, or off."
    # Without a limit JAX does not lock the folder, and another process may read a half-written entry.
    if find_spec("filelock") is not None:
        jax.config.update("jax_compilation_cache_max_size", LARGEST)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", SHORTEST)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # JAX compiles anew where an entry cannot be read; who only wanted a result need not hear of it.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache", UserWarning)
    return ""


def _caches() -> Path:
    """Where programs keep what they can make again."""
    if sys.platform == "win32" and (folder := os.environ.get("LOCALAPPDATA")):
        return Path(folder)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _processor() -> str:
    """A name for what this processor can do: machines of different kinds may share a home, but not native code."""
    try:
        lines = Path("/proc/cpuinfo").read_bytes().splitlines()
        features = next(line for line in lines if line.lower().startswith((b"flags", b"features")))
    except (OSError, StopIteration):
        features = platform.processor().encode()
    return f"{platform.machine()}-{hashlib.sha256(features).hexdigest()[:8]}"


def _remove_halves(folder: Path) -> None:
    """Remove what a process wrote that was killed meanwhile: JAX notes when each entry was used, after writing it."""
    noted = {path.name.removesuffix("-atime") for path in folder.glob("*-atime")}
    for path in folder.glob("*-cache") if noted else ():
        if path.name.removesuffix("-cache") not in noted and path.stat().st_mtime < time.time() - 60:
            path.unlink(missing_ok=True)
