"""Execute the notebooks and keep them with their figures: ``python tools/notebooks.py [NAME ...] [--out FOLDER]``."""

import argparse
import os
import re
import time
from pathlib import Path
from typing import Any

import jupytext
import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[1] / "notebooks"
LONGEST = 3600  # s that one cell may take


SIZE = "STICKSLIP_NOTEBOOK_SAMPLES"  # in the environment; the notebooks say what they take without it


def execute(notebook: Any, folder: Path | None = None, **environment: str) -> Any:
    """Execute a notebook in a kernel of its own, which draws its figures into it; it gets `environment` besides ours.

    It runs in `folder`, by default in the present one. The number of samples asked for goes into the metadata, from
    where the site tells it. Figures come only from the kernel's own backend, and MPLBACKEND in the environment would
    choose another.
    """
    around = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"} | environment
    notebook.metadata["stickslip_jax"] = {"samples": around.get(SIZE) or _full_size(notebook)}
    resources = {} if folder is None else {"metadata": {"path": str(folder)}}
    client = NotebookClient(notebook, timeout=LONGEST, kernel_name="python3", resources=resources)
    client.extra_arguments = ["--InlineBackend.figure_formats={'retina'}"]  # twice the pixels: sharp on all screens
    return client.execute(env=around)


def _full_size(notebook: Any) -> str:
    """The number of samples that the code takes by default; empty where it takes none from the environment."""
    code = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "code")
    found = re.search(rf'"{SIZE}", "([\d_]+)"', code)
    return found[1].replace("_", "") if found else ""


def main() -> None:
    """Execute those named, by default all, one after the other."""
    names = sorted(path.stem for path in FOLDER.glob("*.py"))
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("names", nargs="*", metavar="NAME", help=f"one of {', '.join(names)}; by default all")
    options.add_argument("--out", type=Path, default=Path("results/notebooks"), help="where the .ipynb files go")
    chosen = options.parse_args()
    if unknown := set(chosen.names) - set(names):
        options.error(f"there is no notebook {', '.join(sorted(unknown))}; there are {', '.join(names)}")
    chosen.out.mkdir(parents=True, exist_ok=True)
    for name in chosen.names or names:
        began, path = time.perf_counter(), chosen.out / f"{name}.ipynb"
        notebook = jupytext.read(FOLDER / f"{name}.py")
        try:
            execute(notebook)
        finally:
            nbformat.write(notebook, path)  # of one that failed, what came out until then
        print(f"{path}: {time.perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
