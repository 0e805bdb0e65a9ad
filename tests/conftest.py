"""Simulated recordings that the tests of a file share."""

import shutil

import pytest

import runs


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A small simulated log, calibrated."""
    folder = runs.simulated(tmp_path_factory.mktemp("small"), runs.SMALL)
    runs.completed(folder)
    return folder


@pytest.fixture
def again(finished, tmp_path):
    """A copy of the finished run that a test may spoil."""
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    return tmp_path
