"""Settings of Sphinx; `make site` builds the site, `make docs` runs all code in it before."""

import sys
from pathlib import Path

import stickslip_jax

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))
import notebook_pages  # noqa: E402

project = "stickslip_jax"
author = "The stickslip_jax authors"
version = release = stickslip_jax.__version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "formulas",
    "reference",
]

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # the pages hold the outputs of a run
nb_ipywidgets_js: dict = {}  # nothing is loaded from the net, and there are no widgets
html_math_renderer = "mathml"
highlight_language = "text"  # what a document shows without naming a language is output, or a command
exclude_patterns = ["extensions"]

default_role = "py:obj"
add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"
python_use_unqualified_type_names = True
napoleon_use_ivar = True  # autodoc describes the attributes themselves besides
napoleon_attr_annotations = False  # shapes such as "*times" are no markup

html_theme = "pydata_sphinx_theme"
html_title = f"stickslip_jax {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
# Pages without pages beside them, and notebooks, whose code needs the room: their list is one level up.
BARE = """index install howto/first_hour gallery tutorial live theory notebooks notebooks/* search genindex""".split()  # noqa: SIM905
html_sidebars = {page: [] for page in BARE}
html_show_search_summary = False  # it is read with `fetch`, which browsers refuse for files
html_theme_options = {
    "show_prev_next": False,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "header_links_before_dropdown": 7,
}


def _link_to_pages(app, name, source) -> None:
    """Links to files outside of this folder become links to the pages that show them."""
    for file, page in {"../benchmarks/README.md": "benchmarks.md", "../README.md": "index.md"}.items():
        source[0] = source[0].replace(f"]({file}", f"]({page}")


def setup(app) -> None:
    """What Sphinx calls first."""
    notebook_pages.write_pages(HERE / "notebooks")
    app.connect("source-read", _link_to_pages)
