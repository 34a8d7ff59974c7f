"""Studies: one ensemble described by a TOML file, simulated, and stored with its statistics and figures.

- `stickslip_jax.study.config.StudyConfig` describes a study; ``StudyConfig()`` is the default one. Its sections are in
  `systems_config`, `bases_config` and `records_config`.
- `stickslip_jax.study.reading.read_config` reads it from a TOML file; `stickslip_jax.study.examples` has some to start
  from.
- `stickslip_jax.study.run.run_study` runs it. The command ``stickslip study`` does all of this.

Importing it raises ImportError if the extra ``study`` is not installed.
"""

from importlib.util import find_spec

_missing = [name for name in ("pydantic", "cyclopts", "xarray", "h5netcdf", "h5py") if find_spec(name) is None]
if _missing:
    raise ImportError(f"Studies need {', '.join(_missing)}: pip install 'stickslip_jax[study]'.")
