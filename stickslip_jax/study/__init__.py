"""Studies: one ensemble described by a TOML file, simulated, and stored with its statistics and figures.

- `StudyConfig` describes a study; ``StudyConfig()`` is the default one.
- `read_config` reads one from a TOML file, and `run_study` runs it: a `Study`.

The command ``stickslip study`` does all of this; its ``--print-example`` prints files to start from.

Importing it raises ImportError if the extra ``study`` is not installed.
"""

from importlib import import_module
from importlib.util import find_spec

_missing = [name for name in ("pydantic", "cyclopts", "xarray", "h5netcdf", "h5py") if find_spec(name) is None]
if _missing:
    raise ImportError(f"Studies need {', '.join(_missing)}: pip install 'stickslip_jax[study]'.")

# Loaded when asked for: help and errors in a file come without what a simulation needs.
_HOMES = {
    "Study": "_run",
    "StudyConfig": "_config",
    "StudyError": "_errors",
    "read_config": "_reading",
    "run_study": "_run",
}


def __getattr__(name: str):
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
