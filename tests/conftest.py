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


@pytest.fixture
def files(tmp_path):
    """Inputs of the report of a good run."""
    import reporting  # takes a second, which other tests should not pay

    return reporting.Files(tmp_path)


@pytest.fixture
def undrawn(monkeypatch):
    """Figures are named but not drawn, which takes most of the time."""
    import reporting

    reporting.undraw(monkeypatch)


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """The folder with all that the report of a good run writes."""
    import reporting

    return reporting.printed(tmp_path_factory.mktemp("good"))


@pytest.fixture(scope="module")
def page(printed):
    """The page of a good run."""
    return (printed / "report.html").read_text()
