"""Runs of the pipeline and reports that many tests share."""

import fcntl
import os
import shutil
from pathlib import Path

# Before NumPy is loaded: sums depend on the number of threads, and the pipeline's jobs use one.
for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

import pytest

from helpers.small_run import SMALL_ARGUMENTS, run_to_completion, simulate_into


def make_once(tmp_path_factory, name, make):
    """Return a folder that `make(folder)` fills once for all workers of a test run."""
    base = tmp_path_factory.getbasetemp()
    # As deep as tmp_path: Snakemake compares the relative paths of a run and of its copy.
    shared = base.parent / "shared" if "PYTEST_XDIST_WORKER" in os.environ else base
    shared.mkdir(exist_ok=True)
    folder, done = shared / name, shared / f"{name}.done"
    with (shared / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            done.touch()
    return folder


def copy_or_link(source, target):
    """Copy a file; link a table, which the pipeline replaces and never writes into."""
    if Path(source).suffix == ".parquet":
        os.link(source, target)
    else:
        shutil.copy2(source, target)


@pytest.fixture(scope="session")
def small_log(tmp_path_factory):
    """A small simulated log with its config and its truth. Tests must not change it."""
    return make_once(tmp_path_factory, "small-log", lambda f: simulate_into(f, SMALL_ARGUMENTS))


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory, small_log):
    """The small log, calibrated. Tests must not change it."""

    def calibrate(folder):
        shutil.copytree(small_log, folder, dirs_exist_ok=True)
        run_to_completion(folder)

    return make_once(tmp_path_factory, "finished-run", calibrate)


@pytest.fixture
def finished_run_copy(finished_run, tmp_path):
    """A copy of the finished run that a test may change."""
    shutil.copytree(finished_run, tmp_path, copy_function=copy_or_link, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def report_files(tmp_path):
    """Inputs of the report of a good run."""
    from helpers import report_inputs  # takes a second, which other tests need not pay

    return report_inputs.ReportInputs(tmp_path)


@pytest.fixture
def skip_figures(monkeypatch):
    """Figures are named but not drawn, which takes most of the time."""
    from helpers import report_inputs

    report_inputs.disable_figures(monkeypatch)


@pytest.fixture(scope="session")
def good_report_folder(tmp_path_factory):
    """The folder with all that the report of a good run writes. Tests must not change it."""
    from helpers import report_inputs

    return make_once(tmp_path_factory, "good-report", report_inputs.write_good_report)


@pytest.fixture(scope="session")
def good_report_page(good_report_folder):
    """The page of a good run."""
    return (good_report_folder / "report.html").read_text()
