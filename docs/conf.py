"""Settings of Sphinx; `make docs` builds the site."""

import shutil
from pathlib import Path

import stickslip_jax

HERE = Path(__file__).parent
RESULTS = HERE.parent / "results"

project = "stickslip_jax"
author = "The stickslip_jax authors"
version = release = stickslip_jax.__version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
]

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # `make docs` has run all code before

default_role = "py:obj"
add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"
python_use_unqualified_type_names = True
napoleon_use_ivar = True  # autodoc describes the attributes themselves besides
napoleon_attr_annotations = False  # shapes such as "*times" are no markup

html_theme = "pydata_sphinx_theme"
html_title = f"stickslip_jax {release}"
html_theme_options = {"show_prev_next": False, "navigation_with_keys": False, "secondary_sidebar_items": ["page-toc"]}


def _copy_notebooks() -> None:
    """Take the executed notebooks into the sources; those of full size where `make notebooks` made them."""
    into = HERE / "notebooks"
    shutil.rmtree(into, ignore_errors=True)
    into.mkdir()
    for folder in ("notebooks-small", "notebooks"):
        for notebook in sorted((RESULTS / folder).glob("*.ipynb")):
            shutil.copy(notebook, into)


def _link_to_pages(app, name, source) -> None:
    """Links to files outside of this folder become links to the pages that show them."""
    for file, page in {"../benchmarks/README.md": "benchmarks.md", "../README.md": "index.md"}.items():
        source[0] = source[0].replace(f"]({file}", f"]({page}")


def setup(app) -> None:
    """What Sphinx calls first."""
    _copy_notebooks()
    app.connect("source-read", _link_to_pages)
