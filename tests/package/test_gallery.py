"""The gallery has a picture and the code of every figure function, and draws by that code; notebooks have theirs."""

import ast
import inspect
import re
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib.axes import Axes
from support.scripts import loaded

from stickslip_jax import plot

mpl.use("Agg")

import matplotlib.pyplot as plt

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
LIST = (ROOT / "docs" / "notebooks.md").read_text(encoding="utf-8")
SOURCE = (ROOT / "docs" / "gallery.py").read_text(encoding="utf-8")
FUNCTIONS = [name for name in plot.__all__ if name[0].islower() and name != "save"]
NOTEBOOKS = sorted(path.stem for path in (ROOT / "notebooks").glob("*.py"))
WIDTH, SIZE = 88, 1_500_000
"""Characters of a line of code that the page shows whole; bytes of all pictures, which are twice as wide as shown."""


def script():
    return loaded("docs/gallery.py")


def pictures(text):
    return re.findall(r"!\[[^\]]+\]\(([\w./]+)\)", text)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_figure_function_has_its_picture_and_the_code_that_draws_it(name):
    part = re.search(rf"^### {name}\n(.*?)(?=^##|\Z)", PAGE, flags=re.DOTALL | re.MULTILINE)
    assert part, f"docs/gallery.md has no section {name}"
    (picture,) = pictures(part[1])
    assert (ROOT / "docs" / picture).exists()
    assert f"{{py:obj}}`~stickslip_jax.plot.{name}`" in part[1]
    if name == "animate":
        assert "{literalinclude} animation.py\n" in part[1]
        assert "plot.animate(" in (ROOT / "docs" / "animation.py").read_text(encoding="utf-8")
        return
    assert picture == f"gallery/{name}.png"
    assert f"```{{literalinclude}} gallery.py\n:language: python\n:pyobject: {name}\n```" in part[1]
    (code,) = [one for one in ast.parse(SOURCE).body if isinstance(one, ast.FunctionDef) and one.name == name]
    assert f"return plot.{name}(" in ast.unparse(code)


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_every_notebook_has_its_picture_and_leads_to_its_page(name):
    part = re.search(rf"\]\(gallery/notebook_{name}\.png\)\n\]\(notebooks/{name}\.ipynb\)\n\n(\S.{{40,}})\n", LIST)
    assert part, f"docs/notebooks.md has no picture of {name}, or no line of what it is about"
    assert LIST.count(f"\nnotebooks/{name}\n") == 1
    assert (ROOT / "docs" / "gallery" / f"notebook_{name}.png").exists()


def test_script_draws_what_the_page_shows():
    gallery = script()
    assert sorted([*gallery.FUNCTIONS, "animate"]) == sorted(FUNCTIONS)
    assert sorted(gallery.FIGURES) == NOTEBOOKS
    shown = {Path(one).name for one in pictures(PAGE + LIST)} - {"animation.gif"}
    assert shown == {path.name for path in (ROOT / "docs" / "gallery").iterdir()}


def test_pictures_are_small():
    files = list((ROOT / "docs" / "gallery").glob("*.png"))
    assert sum(file.stat().st_size for file in files) < SIZE


def test_code_that_the_page_shows_fits_its_column():
    gallery = script()
    shown = [inspect.getsource(getattr(gallery, name)) for name in re.findall(r":pyobject: (\w+)", PAGE)]
    shown.append(SOURCE.partition("import math")[2].partition("# Until here.")[0])
    shown.append((ROOT / "docs" / "animation.py").read_text(encoding="utf-8"))
    assert not [line for code in shown for line in code.splitlines() if len(line) > WIDTH]


@pytest.mark.slow
def test_the_quickest_picture():
    ax = script().stick_bounds()
    assert isinstance(ax, Axes)
    assert len(ax.lines) >= 3
    plt.close(ax.figure)
