"""Simulated recordings that the tests of a file share."""

import shutil

import pytest

from helpers.small_run import SMALL_ARGUMENTS, run_to_completion, simulate_into


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory):
    """A small simulated log, calibrated."""
    folder = simulate_into(tmp_path_factory.mktemp("small"), SMALL_ARGUMENTS)
    run_to_completion(folder)
    return folder


@pytest.fixture
def finished_run_copy(finished_run, tmp_path):
    """A copy of the finished run that a test may spoil."""
    shutil.copytree(finished_run, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def report_files(tmp_path):
    """Inputs of the report of a good run."""
    from helpers.report_inputs import ReportInputs  # takes a second that other tests should not pay

    return ReportInputs(tmp_path)


@pytest.fixture
def skip_figures(monkeypatch):
    """Figures are named but not drawn, which takes most of the time."""
    from helpers.report_inputs import disable_figures

    disable_figures(monkeypatch)


@pytest.fixture(scope="module")
def good_report_folder(tmp_path_factory):
    """The folder with all that the report of a good run writes."""
    from helpers.report_inputs import write_good_report

    return write_good_report(tmp_path_factory.mktemp("good"))


@pytest.fixture(scope="module")
def good_report_page(good_report_folder):
    """The page of a good run."""
    return (good_report_folder / "report.html").read_text()
