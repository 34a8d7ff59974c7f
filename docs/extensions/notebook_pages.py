"""The pages of the notebooks: the text and code of today, the outputs of the last run, and what it was run with."""

import ast
import re
import shutil
from pathlib import Path
from typing import Any

import jupytext
import nbformat

ROOT = Path(__file__).parents[2]
RUNS = ("notebooks", "notebooks-small")  # below results; the first that has the notebook is shown
SIZE = r'"STICKSLIP_NOTEBOOK_SAMPLES", "([\d_]+)"'


def full_size(notebook: Any) -> int:
    """The number of samples that the notebook takes where nothing else is asked for."""
    return int(re.search(SIZE, "\n".join(cell.source for cell in _code(notebook)))[1])


def with_outputs(notebook: Any, executed: Any) -> bool:
    """Take over the outputs of a run; False, and nothing done, if another code was run than this notebook holds."""
    ours, theirs = _code(notebook), _code(executed)
    if [_meaning(cell) for cell in ours] != [_meaning(cell) for cell in theirs]:
        return False
    for cell, run in zip(ours, theirs, strict=True):
        cell.outputs, cell.execution_count = run.outputs, run.execution_count
    return True


def note(asked: int | None, full: int) -> str:
    """What the page was run with, as Markdown: `asked` samples (None: it was not run) where the code says `full`."""
    if asked is None:
        return (
            "```{note}\nThis page shows the code without its results: it was not run since it was last changed. "
            "`make notebooks` runs all notebooks at full size, `make site` then builds this site with the results.\n```"
        )
    if asked == full:
        return f"```{{note}}\nRun at full size: `SAMPLES` is what the code says ({full:,}).\n```"
    return (
        f"```{{note}}\n**Run at a reduced size: {asked:,} samples were asked for where the code says {full:,}** "
        "(some cells take no fewer than a number of their own, which they print). Numbers, errors and figures are "
        "those of this run. `make notebooks site` shows the full size.\n```"
    )


def write_pages(into: Path, sources: Path = ROOT / "notebooks", results: Path = ROOT / "results") -> None:
    """Write all notebooks into a folder, as pages."""
    shutil.rmtree(into, ignore_errors=True)
    into.mkdir()
    for source in sorted(sources.glob("*.py")):
        notebook, asked = jupytext.read(source), None
        full = full_size(notebook)
        for file in (results / folder / f"{source.stem}.ipynb" for folder in RUNS):
            if asked is None and file.exists():
                executed = nbformat.read(file, as_version=4)
                samples = executed.metadata.get("stickslip_jax", {}).get("samples")
                if samples and with_outputs(notebook, executed):
                    asked = int(samples)
        head, _, rest = notebook.cells[0].source.partition("\n")
        notebook.cells[0].source = f"{head}\n\n{note(asked, full)}\n{rest}"
        nbformat.write(notebook, into / f"{source.stem}.ipynb")


def _code(notebook: Any) -> list[Any]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def _meaning(cell: Any) -> str:
    """The code without its layout and comments."""
    return ast.dump(ast.parse(cell.source))
