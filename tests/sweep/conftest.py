"""A finished sweep for the tests of its folder."""

import shutil
from pathlib import Path

import pytest
from support.faults import run, sweep_of


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder with a finished sweep, and its data set."""
    folder = tmp_path_factory.mktemp("whole") / "sweep"
    return folder, run(sweep_of(), folder)


@pytest.fixture
def copied(whole, tmp_path):
    """A copy of it, to be spoilt."""
    return Path(shutil.copytree(whole[0], tmp_path / "sweep")), whole[1]
