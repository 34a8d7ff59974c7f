"""Execute the notebooks and keep them with their figures: ``python tools/notebooks.py [NAME ...] [--out FOLDER]``."""

import argparse
import os
import time
from pathlib import Path
from typing import Any

import jupytext
import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[1] / "notebooks"
LONGEST = 3600  # s that one cell may take


def execute(notebook: Any, **environment: str) -> Any:
    """Execute a notebook in a kernel of its own, which draws its figures into it; it gets `environment` besides ours.

    Figures come only from the kernel's own backend, and MPLBACKEND in the environment would choose another.
    """
    ours = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
    return NotebookClient(notebook, timeout=LONGEST, kernel_name="python3").execute(env={**ours, **environment})


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
