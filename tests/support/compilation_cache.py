"""JAX's own persistent cache, for what the tests compile by ``jax.jit``; the package keeps its own programs."""

import os
import time
import warnings
from importlib.util import find_spec
from pathlib import Path

import jax

FOLDER = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stickslip_jax" / "of-tests"
SHORTEST = 0.1  # compilation that is kept, s
LARGEST = 2**30  # size of the folder, bytes


def use(folder: Path) -> None:
    """Switch the cache on for this process, unless it is on already. Processes share the folder: JAX locks it."""
    if jax.config.jax_compilation_cache_dir:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _remove_halves(folder)
    except OSError:
        return
    if find_spec("filelock") is not None:  # without a limit JAX does not lock the folder
        jax.config.update("jax_compilation_cache_max_size", LARGEST)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", SHORTEST)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache", UserWarning)


def _remove_halves(folder: Path) -> None:
    """Remove entries that a killed process left half-written: they have no time of use, which JAX writes last."""
    noted = {path.name.removesuffix("-atime") for path in folder.glob("*-atime")}
    for path in folder.glob("*-cache") if noted else ():
        if path.name.removesuffix("-cache") not in noted and path.stat().st_mtime < time.time() - 60:
            path.unlink(missing_ok=True)
