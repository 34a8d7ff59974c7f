"""The README's code runs and prints what the README says."""

import contextlib
import io
import re
from pathlib import Path

import pytest

README = Path(__file__).parents[1] / "README.md"


@pytest.mark.filterwarnings("ignore")
def test_the_readme_prints_what_it_says():
    # The tests' process has started JAX already; its flags change speed, not results.
    text = README.read_text(encoding="utf-8").replace("ss.enable_fast_cpu()", "None")
    parts = re.findall(r"```python\n(.*?)```\s+(?:[^`]*?```\n(.*?)```)?", text, flags=re.DOTALL)
    assert len(parts) == 4
    names: dict = {}
    for code, promised in parts:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(code, names)
        assert printed.getvalue() == promised
