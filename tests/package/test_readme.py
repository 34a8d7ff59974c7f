"""The code in README and documents runs and prints what they say."""

import contextlib
import io
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = {
    "README.md": 2,
    "docs/clusters.md": 2,
    "docs/designs.md": 8,
    "docs/howto/animation.md": 2,
    "docs/howto/bearings.md": 6,
    "docs/howto/brakes.md": 3,
    "docs/howto/calibration.md": 5,
    "docs/howto/calibration_sticks.md": 2,
    "docs/howto/contacts.md": 13,
    "docs/howto/control.md": 12,
    "docs/howto/drilling.md": 5,
    "docs/howto/earthquakes.md": 8,
    "docs/howto/engine.md": 2,
    "docs/howto/first_hour.md": 9,
    "docs/howto/friction_memory.md": 9,
    "docs/howto/joints.md": 4,
    "docs/howto/memory.md": 1,
    "docs/howto/nonlinear.md": 8,
    "docs/howto/outputs.md": 3,
    "docs/howto/own_force.md": 3,
    "docs/howto/own_friction.md": 6,
    "docs/howto/own_law.md": 4,
    "docs/howto/own_system.md": 4,
    "docs/howto/posteriors.md": 3,
    "docs/howto/precision.md": 2,
    "docs/howto/records.md": 8,
    "docs/howto/save.md": 2,
    "docs/howto/sliding_block.md": 3,
    "docs/howto/strings.md": 3,
    "docs/regularized.md": 3,
    "docs/sensitivity.md": 2,
    "docs/statistics.md": 7,
    "docs/sweeps.md": 3,
    "docs/tutorial.md": 11,
    "docs/uncertain.md": 3,
}
"""And how many pieces of code each holds, those that are only shown (other words after ``python``) not counted."""
PROGRAMS = {"docs/howto/first_hour.md": 15}
"""Documents whose pieces are programs of their own, of so many lines at most."""


def test_every_document_with_code_is_tested():
    found = [path for path in ROOT.glob("docs/**/*.md") if "```python\n" in path.read_text(encoding="utf-8")]
    assert {str(path.relative_to(ROOT)) for path in found} == set(DOCUMENTS) - {"README.md"}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.documents
@pytest.mark.slow_but_for("README.md", "docs/howto/first_hour.md", "docs/tutorial.md", "docs/statistics.md")
@pytest.mark.parametrize("document", DOCUMENTS)
def test_documents_print_what_they_say(document, tmp_path, monkeypatch):
    text = (ROOT / document).read_text(encoding="utf-8")
    parts = re.findall(r"```python\n(.*?)```\s+(?:[^`]*?```\n(.*?)```)?", text, flags=re.DOTALL)
    assert len(parts) == DOCUMENTS[document]
    monkeypatch.chdir(tmp_path)  # some write files
    names: dict = {}
    for code, promised in parts:
        if document in PROGRAMS:
            names = {}
            assert len([line for line in code.splitlines() if line.strip()]) <= PROGRAMS[document]
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(code, names)
        assert printed.getvalue() == promised


@pytest.mark.documents
def test_the_commands_of_the_first_hour_print_what_it_says(tmp_path):
    text = (ROOT / "docs/howto/first_hour.md").read_text(encoding="utf-8")
    ((file, commands, promised),) = re.findall(
        r"```toml\n(.*?)```.*?```bash\n(.*?)```\s+```\n(.*?)```", text, flags=re.DOTALL
    )
    (tmp_path / "sweep.toml").write_text(file)
    entry = [sys.executable, "-c", "from stickslip_jax._cli import main; main()"]
    printed = ""
    for line in commands.splitlines():
        command, *arguments = shlex.split(line)
        assert command == "stickslip"
        printed += subprocess.run([*entry, *arguments], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    assert re.sub(r"\d[\d.]* s, summed", "... s, summed", printed) == promised
