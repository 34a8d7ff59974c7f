"""The pages of the site: code fits into its column, formulas and notebooks are shown as they should be."""

import ast
import inspect
import re
from pathlib import Path

import jupytext
import nbformat
import pytest
from support.scripts import loaded

import stickslip_jax as ss

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
CODE, OUTPUT = 88, 100
"""Characters of a line that a page shows whole in a window of 1,400 pixels (``docs/_static/site.css``): of code, with a
margin for other fonts, and of what it prints. `tools/site_check.py` measures it in a browser. Pages of notebooks have
no list of other pages beside them, and hold the 120 that the formatter allows."""


def extension(name):
    return loaded(f"docs/extensions/{name}.py")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_code_in_documents_fits_its_column(document):
    text = document.read_text(encoding="utf-8")
    for language, code in re.findall(r"^```([^\n]*)\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE):
        most = CODE if language else OUTPUT
        assert language.startswith("{") or not [line for line in code.splitlines() if len(line) > most]


def docstrings(file):
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, kinds) and (text := ast.get_docstring(node)):
            yield text


def test_code_in_docstrings_fits_its_column():
    lines = [
        line.strip()
        for file in sorted((ROOT / "stickslip_jax").rglob("*.py"))
        for text in docstrings(file)
        for line in text.splitlines()
        if line.strip().startswith((">>> ", "... "))
    ]
    assert len(lines) > 30
    assert not [line for line in lines if len(line) > CODE + 4]


def test_no_summary_in_the_reference_ends_at_an_abbreviation():
    """Tables of the reference show the first sentence, and a full stop before a blank ends it."""
    cut = re.compile(r"\b(eqs?|s|p|pp|figs?|cf|ch)\. [\d(]|\.\.\. ", re.IGNORECASE)
    shown = [getattr(module, name) for module in (ss, ss.plot, ss.design) for name in module.__all__]
    shown += [one for name, one in vars(ss.papers).items() if inspect.isfunction(one) and not name.startswith("_")]
    first = [" ".join(text.split("\n\n")[0].split()) for one in shown if (text := inspect.getdoc(one))]
    assert len(first) > 100
    assert not [line for line in first if cut.search(line)]


def test_no_argument_is_described_by_a_function_that_the_reference_does_not_show():
    for name in ("read_recorded_csv", "read_acceleration_csv"):
        (text,) = (
            ast.get_docstring(node)
            for node in ast.parse((ROOT / "stickslip_jax/_excitation/reading.py").read_text(encoding="utf-8")).body
            if isinstance(node, ast.FunctionDef) and node.name == name
        )
        for argument in ("path", "time_column", "value_column", "scale", "delimiter", "shift"):
            assert f"\n    {argument}: " in text
        assert "Returns:" in text
        assert "OSError" in text


def test_formulas_need_no_script():
    """Of all documents and notebooks; a formula that cannot be shown stops the build, and names itself."""
    mathml = pytest.importorskip("sphinx") and extension("formulas").mathml
    texts = [document.read_text(encoding="utf-8") for document in DOCUMENTS]
    for file in sorted((ROOT / "notebooks").glob("*.py")):
        texts += [cell.source for cell in jupytext.read(file).cells if cell.cell_type == "markdown"]
    found = []
    for text in texts:
        plain = re.sub(r"```.*?```|`[^`]*`", "", text, flags=re.DOTALL)
        blocks = re.findall(r"\$\$(.*?)\$\$", plain, flags=re.DOTALL)
        inline = re.findall(r"\$([^$\n]+)\$", re.sub(r"\$\$.*?\$\$", "", plain, flags=re.DOTALL))
        found += [mathml(formula, as_block=True) for formula in blocks] + [mathml(formula) for formula in inline]
    assert len(found) > 50
    assert all(one.startswith("<math") for one in found)
    assert "<msqrt>" in mathml(r"\sqrt{k / m}")
    with pytest.raises(Exception, match=r"The formula .*nosuch.* cannot be shown"):
        mathml(r"\nosuch{x}")


def notebook(code, printed=None):
    outputs = [] if printed is None else [nbformat.v4.new_output("stream", text=printed)]
    cells = [nbformat.v4.new_markdown_cell("# Title\n\nText."), nbformat.v4.new_code_cell(code, outputs=outputs)]
    return nbformat.v4.new_notebook(cells=cells)


SIZED = 'SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "10_000"))'


@pytest.mark.parametrize(("folder", "samples", "told"), [
    ("notebooks", "10000", "Run at full size"),
    ("notebooks-small", "100", "Run at a reduced size: 100 samples were asked for where the code says 10,000"),
    ("notebooks-small", None, "without its results"),
    (None, None, "without its results"),
])  # fmt: skip
def test_pages_of_notebooks_say_first_what_they_were_run_with(tmp_path, folder, samples, told):
    pages = extension("notebook_pages")
    sources, results, into = tmp_path / "sources", tmp_path / "results", tmp_path / "pages"
    sources.mkdir()
    jupytext.write(notebook(SIZED), sources / "one.py", fmt="py:percent")
    if folder:
        (results / folder).mkdir(parents=True)
        ran = notebook(SIZED.replace("int(", "int( ") + "  # laid out in another way", "ran\n")
        if samples:
            ran.metadata["stickslip_jax"] = {"samples": samples}
        nbformat.write(ran, results / folder / "one.ipynb")
    pages.write_pages(into, sources, results)
    page = nbformat.read(into / "one.ipynb", as_version=4)
    head, _, note = page.cells[0].source.split("\n", 2)
    assert head == "# Title"
    assert told in note.split("Text.")[0]
    assert "{note}" in note  # nothing on a page that was built as it should be is a warning
    assert [output.text for output in page.cells[1].outputs] == (["ran\n"] if samples else [])
    assert page.cells[1].source == SIZED


def test_outputs_of_other_code_are_not_shown(tmp_path):
    pages = extension("notebook_pages")
    now, ran = notebook(SIZED), notebook(SIZED.replace("10_000", "20_000"), "old\n")
    assert not pages.with_outputs(now, ran)
    assert now.cells[1].outputs == []
    assert pages.with_outputs(now, notebook(SIZED, "new\n"))
    assert [output.text for output in now.cells[1].outputs] == ["new\n"]


def test_every_notebook_has_a_size_that_its_page_can_tell():
    pages = extension("notebook_pages")
    for file in sorted((ROOT / "notebooks").glob("*.py")):
        assert pages.full_size(jupytext.read(file)) >= 100
