"""Folders of sweeps whose batches are not joined yet, and what is in them."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np

import stickslip_jax as ss
from support.faults import failing, run


def unjoined(sweep: ss.Sweep, folder: Path) -> Any:
    """Run a sweep in a folder, and put the batches back that were joined; returns the data set.

    The data set is not in the folder any more, so that looks read the batches.
    """
    parts: dict[Path, bytes] = {}

    def keep(number: int, name: str, of: Any) -> None:
        if name == "unlink" and of.suffix == ".zip":
            parts[of] = of.read_bytes()

    with failing(folder, keep):
        dataset = run(sweep, folder)
    shutil.copytree(folder / "batches", folder.with_name("joined"))
    for path in (folder / "batches").glob("*.zip"):
        if path not in parts:
            path.unlink()
    for path, data in parts.items():
        path.write_bytes(data)
    (folder / "sweep.nc").unlink()
    return dataset


def join(folder: Path) -> None:
    """Do what a run does at the end of every point: the joined batch first, then its parts go."""
    for path in folder.with_name("joined").glob("*.zip"):
        identity = path.name.partition("-")[0]
        parts = [part for part in (folder / "batches").glob(f"{identity}-*.zip") if part.name != path.name]
        shutil.copy(path, folder / "batches" / path.name)
        for part in parts:
            part.unlink()


def assert_same_or_missing(found: Any, wanted: Any) -> None:
    """Assert that what a data set has of each point, all samples or a derivative, is what `wanted` has."""
    whole = (found["samples"] == wanted["samples"]).values
    for name in set(found.data_vars) - {"run_seconds"}:
        there = whole
        if name.startswith("d_"):
            there = ~np.isnan(found[name.removesuffix("_error").removesuffix("_is_corrected")].values)
        one, other = found[name].values[there], wanted[name].values[there]
        assert one.tobytes() == other.tobytes(), name
