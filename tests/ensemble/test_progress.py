"""When a progress bar is shown: on terminals, in notebooks, when asked for; never in pipes, nor for a moment only."""

import importlib.util
import subprocess
import sys
import textwrap
import types

import pytest

from stickslip_jax._foundation import extras
from stickslip_jax._foundation.extras import in_notebook, progress_bar


@pytest.fixture
def notebook(monkeypatch):
    """As inside the kernel of a notebook."""
    shell = types.SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))


def run(asked):
    with progress_bar(asked, 10) as bar:
        for _ in range(5):
            bar.advance(2)


def test_notebooks_are_told_from_other_shells(monkeypatch):
    assert not in_notebook()  # whether IPython is loaded, as by other tests, or not
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    assert not in_notebook()
    terminal = types.SimpleNamespace(get_ipython=types.SimpleNamespace)  # a shell without a kernel
    monkeypatch.setitem(sys.modules, "IPython", terminal)
    assert not in_notebook()


def test_in_notebooks_it_shows_by_default_and_goes_away(notebook, monkeypatch, capfd, recwarn):
    assert in_notebook()
    run(None)
    assert capfd.readouterr() == ("", "")  # too short for a bar
    monkeypatch.setattr(extras, "_DELAY", 0)
    run(None)
    shown = capfd.readouterr().err
    assert "/10.0" in shown
    assert shown.endswith("\r")  # cleared
    run(False)
    assert capfd.readouterr().err == ""
    assert not recwarn.list


def test_when_asked_for_it_stays(capfd):
    run(True)
    assert "100%" in capfd.readouterr().err.rstrip("\n").rpartition("\r")[2]
    run(None)
    assert capfd.readouterr().err == ""  # not a terminal


@pytest.mark.parametrize("inside", ["notebook", "terminal"])
def test_without_tqdm_it_is_left_out_unless_asked_for(inside, request, monkeypatch, capfd):
    if inside == "notebook":
        request.getfixturevalue("notebook")
    else:
        monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for name in ("tqdm", "tqdm.std", "tqdm.notebook"):
        monkeypatch.setitem(sys.modules, name, None)
    run(None)
    assert capfd.readouterr().err == ""
    with pytest.raises(ImportError, match=r"needs tqdm: pip install 'stickslip_jax\[study\]', or progress=False"):
        run(True)


@pytest.mark.skipif(importlib.util.find_spec("ipykernel") is None, reason="needs a kernel")
def test_in_a_kernel():
    """What `in_notebook` asks for is there in the shell of a real kernel, before anything runs in it."""
    code = """
        from ipykernel.ipkernel import IPythonKernel
        import sys
        import types
        kernel = IPythonKernel.instance()
        assert kernel.shell.kernel is kernel
        assert sys.modules["IPython"].get_ipython().kernel is kernel
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(code)], check=True, timeout=120, capture_output=True)
