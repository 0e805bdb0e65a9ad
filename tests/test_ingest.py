"""The benchmark's large logs hold what they say, and both readers are measured on them."""

import json

import pytest

from benchmarking.decode_cost import decode_cost, large_logs
from calib.io import parquet_tables, table_schemas
from calib.io.logs import open_log


@pytest.mark.parametrize("compression", large_logs.COMPRESSIONS)
def test_both_readers_are_measured_on_a_log_that_is_removed_again(tmp_path, compression):
    """At 100 Hz of poses and 10 Hz of four sensors, 20 MB are 0.5 s of a laboratory."""
    row = decode_cost.row(tmp_path / "a.mcap", compression, 2e7)
    assert row.messages == pytest.approx(0.5 * (100 + 4 * 10), abs=15)
    assert row.decode.cpu > 0.1 and row.raw.cpu > 0.02
    assert 10 < row.raw.memory < row.decode.memory < decode_cost.MEMORY
    assert not (tmp_path / "a.mcap").exists()
    audit = json.loads((tmp_path / "log.json").read_text())
    poses, _, _ = parquet_tables.read(tmp_path / "mocap.parquet", table_schemas.MOCAP)
    frames, _, _ = parquet_tables.read(tmp_path / "frames.parquet", table_schemas.FRAMES)
    assert len(poses["t"]) / len(large_logs.BODIES) + len(frames["t"]) == row.messages
    assert audit["faults"] == [] and all(s["status"]["ok"] for s in audit["sensors"].values())
    assert all("doubtful" not in s["told"].get("time", "") for s in audit["sensors"].values())


def test_a_log_of_the_benchmark_is_the_same_bytes_again_and_as_long_as_asked_for(tmp_path):
    paths = [tmp_path / f"{i}.mcap" for i in range(2)]
    assert len({large_logs.write(path, "none", 5e6) for path in paths}) == 1
    assert paths[0].read_bytes() == paths[1].read_bytes()
    content = sum(
        len(m.data)
        for m in open_log.open_log(str(paths[0])).messages(
            ["/tf", *(s["topic"] for s in large_logs.sensors().values())]
        )
    )
    assert 5e6 <= content < 7e6


def test_a_reader_that_fails_ends_the_benchmark_with_its_words(tmp_path):
    with pytest.raises(RuntimeError, match="did not read its log"):
        decode_cost.costs_of("-m", "benchmarking.decode_cost.process_cost", tmp_path / "no.mcap")
