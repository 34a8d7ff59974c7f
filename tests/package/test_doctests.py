"""The examples in docstrings print what they say."""

import ast
import doctest
import math
from pathlib import Path

import jax
import pytest

import stickslip_jax as ss

ROOT = Path(__file__).parents[2]
FILES = {
    str(path.relative_to(ROOT)): path.read_text("utf-8")
    for path in sorted((ROOT / "stickslip_jax").rglob("*.py"))
    if ">>> " in path.read_text("utf-8")
}
NAMES = {"ss": ss, "jax": jax, "math": math}


def test_there_are_examples():
    assert len(FILES) >= 7


@pytest.mark.documents
@pytest.mark.parametrize("file", FILES)
def test_examples_print_what_they_say(file):
    # From the source: functions whose annotations the tests check look to doctest as if they came from elsewhere.
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    nodes = [node for node in ast.walk(ast.parse(FILES[file])) if isinstance(node, kinds)]
    texts = [text for node in nodes if ">>> " in (text := ast.get_docstring(node) or "")]
    assert texts
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    for text in texts:
        runner.run(doctest.DocTestParser().get_doctest(text, dict(NAMES), file, file, 0))
    assert runner.summarize(verbose=False).failed == 0
