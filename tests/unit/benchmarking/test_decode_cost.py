"""The benchmark's large logs hold what they say, and both readers are measured on them."""

import json

import pytest

from benchmarking.decode_cost import decode_cost
from benchmarking.decode_cost.decode_cost import measure_one_log, run_and_parse_cost
from benchmarking.decode_cost.large_logs import (
    BODY_NAMES,
    COMPRESSIONS,
    large_log_sensors,
    write_large_log,
)
from calib.io.logs.open_log import open_log
from calib.io.parquet_tables import read_table
from calib.io.table_schemas import FRAMES_SCHEMA, MOCAP_SCHEMA


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_both_readers_are_measured_on_a_log_that_is_removed_again(tmp_path, compression):
    """At 100 Hz of poses and 10 Hz of four sensors, 20 MB are 0.5 s of a laboratory."""
    row = measure_one_log(tmp_path / "a.mcap", compression, 2e7)
    assert row.n_messages == pytest.approx(0.5 * (100 + 4 * 10), abs=15)
    assert row.decode_cost.cpu_s > 0.1 and row.raw_cost.cpu_s > 0.02
    assert (
        10
        < row.raw_cost.peak_memory_mb
        < row.decode_cost.peak_memory_mb
        < decode_cost.MAX_MEMORY_MB
    )
    assert not (tmp_path / "a.mcap").exists()
    audit = json.loads((tmp_path / "log.json").read_text())
    poses, _, _ = read_table(tmp_path / "mocap.parquet", MOCAP_SCHEMA)
    frames, _, _ = read_table(tmp_path / "frames.parquet", FRAMES_SCHEMA)
    assert len(poses["stamp_ns"]) / len(BODY_NAMES) + len(frames["stamp_ns"]) == row.n_messages
    assert audit["faults"] == [] and all(s["status"]["ok"] for s in audit["sensors"].values())
    assert all("doubtful" not in s["inferred"].get("time", "") for s in audit["sensors"].values())


def test_a_log_of_the_benchmark_is_the_same_bytes_again_and_as_long_as_asked_for(tmp_path):
    paths = [tmp_path / f"{i}.mcap" for i in range(2)]
    assert len({write_large_log(path, "none", 5e6) for path in paths}) == 1
    assert paths[0].read_bytes() == paths[1].read_bytes()
    content = sum(
        len(m.data)
        for m in open_log(str(paths[0])).iter_messages(
            ["/tf", *(s["topic"] for s in large_log_sensors().values())]
        )
    )
    assert 5e6 <= content < 7e6


def test_a_reader_that_fails_ends_the_benchmark_with_its_words(tmp_path):
    with pytest.raises(RuntimeError, match="did not read its log"):
        run_and_parse_cost("-m", "benchmarking.decode_cost.process_cost", tmp_path / "no.mcap")
