"""Studies: one ensemble described by a TOML file, simulated, and stored with its statistics and figures.

- `StudyConfig` describes a study; ``StudyConfig()`` is the default one. `read_config` reads one from a TOML file.
- `run_study` simulates the ensemble, stores the results in a folder and returns a `StoredStudy`.
- `StudyError` is raised for mistakes in the file and for a folder that cannot be used.

The command ``stickslip study`` does all of this; its option ``--print-example`` prints files to start from.

Importing this module raises ImportError if the extra ``study`` is not installed.
"""

from importlib import import_module

from .._foundation.extras import require as _require

# Before any module of this folder is there: who asks again is told again.
_require("Studies and the command need", "study", "pydantic", "cyclopts", "xarray", "h5netcdf", "h5py", "filelock")


class StudyError(ValueError):
    """A mistake in a TOML file or an option of the command, or a folder that cannot hold the result of a study.

    The message is one sentence, which says what to do.
    """


# Loaded when asked for, so that help and messages about a file do not wait for what only a simulation needs.
_HOMES = {"StoredStudy": "_run", "StudyConfig": "_config", "read_config": "_reading", "run_study": "_run"}


def __getattr__(name: str):
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*_HOMES, "StudyError"})
