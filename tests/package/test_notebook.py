"""The quick start runs from top to bottom and draws its figures."""

import re
from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

pytestmark = pytest.mark.documents
NOTEBOOK = Path(__file__).parents[2] / "notebooks" / "quickstart.py"


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("notebook")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STICKSLIP_NOTEBOOK_SAMPLES", "100")
        patch.setenv("IPYTHONDIR", str(folder / "ipython"))
        patch.setenv("JUPYTER_RUNTIME_DIR", str(folder / "runtime"))
        patch.delenv("MPLBACKEND", raising=False)
        notebook = jupytext.read(NOTEBOOK)
        client = NotebookClient(
            notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
        )
        return client.execute()


def outputs(notebook):
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def printed(notebook):
    return "".join(output.text for output in outputs(notebook) if output.output_type == "stream")


def test_every_cell_ran(executed):
    code = [cell for cell in executed.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert not [output for output in outputs(executed) if output.output_type == "error"]


def test_nothing_was_warned_of(executed):
    complaints = [output.text for output in outputs(executed) if output.get("name") == "stderr"]
    assert not [text for text in complaints if "Warning" in text]


def test_every_figure_is_drawn(executed):
    """Two time histories, phase portrait, distributions, stick fraction, stick map."""
    assert sum("image/png" in output.get("data", {}) for output in outputs(executed)) == 7


def test_the_size_is_set_from_outside(executed):
    assert "Ensemble of 100 samples" in printed(executed)


def test_numbers_told(executed):
    text = printed(executed)
    assert "largest share: 38.67 % at r = 1.22" in text
    told = re.search(r"d\(mu\) = (\S+) s, by finite difference (\S+) s", text)
    assert told is not None
    exact, difference = map(float, told.groups())
    # A central difference over 2e-7 is good to about 1e-13 * 200 / 2e-7 = 1e-4.
    assert exact == pytest.approx(difference, abs=1e-3)


def test_the_forced_mass_sticks_where_it_is_known_to(executed):
    """Published for this system: 9.48337858 and 26.13168182 s (DISODE45 example)."""
    assert "['9.48337858', '26.13168182']" in printed(executed)


def test_the_labeled_arrays_are_shown(executed):
    assert any("stick_start" in output.get("data", {}).get("text/plain", "") for output in outputs(executed))
