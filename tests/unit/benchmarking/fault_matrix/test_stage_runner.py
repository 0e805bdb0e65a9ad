"""Stages run in this process from the first one whose arguments changed."""

from types import SimpleNamespace

import pytest

from benchmarking.fault_matrix import stage_runner
from benchmarking.fault_matrix.row_measurement import link_results
from benchmarking.fault_matrix.stage_runner import StageJob, run_stages
from calib.io.parquet_tables import write_table
from calib.io.status import InputError
from calib.io.table_schemas import ITERATIONS_SCHEMA


@pytest.fixture
def stages(monkeypatch):
    """Three stages that note what they are called with, and refuse `bad`."""
    called = []

    def make_stage(name):
        def main(arguments):
            if "bad" in arguments:
                raise InputError(f"{name} refused")
            called.append((name, *arguments))

        return SimpleNamespace(__name__=name, main=main)

    made = tuple(make_stage(name) for name in ("first", "second", "third"))
    monkeypatch.setattr(stage_runner, "STAGES", made)
    return made, called


def make_jobs(stages, *arguments):
    """Jobs of the stages; the second stage has two."""
    numbers = (0, 1, 1, 2)
    return [StageJob(stages[i], [words]) for i, words in zip(numbers, arguments, strict=True)]


def test_all_jobs_run_where_nothing_was_done(stages, tmp_path):
    made, called = stages
    assert run_stages(tmp_path, make_jobs(made, "a", "b", "c", "d")).stopped == ""
    assert [c[0] for c in called] == ["first", "second", "second", "third"]


def test_only_the_changed_job_of_a_stage_and_all_later_stages_run_again(stages, tmp_path):
    made, called = stages
    done = make_jobs(made, "a", "b", "c", "d")
    run_stages(tmp_path, make_jobs(made, "a", "b", "other", "d"), done)
    assert called == [("second", "other"), ("third", "d")]


def test_nothing_runs_again_where_nothing_changed(stages, tmp_path):
    made, called = stages
    done = make_jobs(made, "a", "b", "c", "d")
    assert run_stages(tmp_path, done, done).stopped == ""
    assert called == []


def test_a_refused_input_ends_the_run_with_its_words(stages, tmp_path):
    made, called = stages
    assert run_stages(tmp_path, make_jobs(made, "a", "bad", "c", "d")).stopped == "second refused"
    assert called == [("first", "a")]


def test_a_table_that_is_written_over_a_link_leaves_the_run_as_it_was(tmp_path):
    run, out = tmp_path / "run", tmp_path / "out"
    path = run / "results" / "sim" / "iterations.parquet"
    path.parent.mkdir(parents=True)
    path.write_text("kept")
    link_results(run, out)
    copy = out / "results" / "sim" / "iterations.parquet"
    assert copy.read_text() == "kept"
    write_table(copy, ITERATIONS_SCHEMA, {name: [] for name in ITERATIONS_SCHEMA.names})
    assert path.read_text() == "kept"
    assert not copy.is_symlink()
