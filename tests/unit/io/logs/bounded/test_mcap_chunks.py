"""Chunks and indexes of a stranger's MCAP file: bounded in memory and time, or refused."""

import time
import tracemalloc
from dataclasses import replace

import pytest
from mcap.records import Schema

from benchmarking.fuzzing.crafted_mcap import CraftedMcap, make_chunk
from calib.io.logs import ros_messages
from calib.io.logs.bounded import mcap_chunks
from calib.io.logs.bounded.mcap_chunks import MAX_CHUNK_MESSAGES
from calib.io.logs.open_log import open_log
from calib.io.logs.ros_messages import TF_TYPE
from calib.io.status import InputError

MS = 1_000_000
DEFINITION = ros_messages.ROS2_TYPES.generate_msgdef(TF_TYPE, ros_version=2)[0].encode()
TF_SCHEMA = Schema(id=1, name=TF_TYPE, encoding="ros2msg", data=DEFINITION)


def crafted(*chunks):
    return CraftedMcap("/tf", TF_SCHEMA, chunks)


def span(first, last, n=3, size=20):
    """A chunk of n messages evenly from first to last, ms."""
    step = (last - first) * MS // max(1, n - 1)
    return make_chunk([first * MS + i * step for i in range(n)], bytes(size))


def times(log):
    return [m.log_time_ns // MS for m in log.iter_messages(["/tf"])]


@pytest.fixture
def cost():
    """A function that gives CPU seconds and MB since the test began."""
    tracemalloc.start()
    begin = time.process_time()
    yield lambda: (time.process_time() - begin, tracemalloc.get_traced_memory()[1] / 1e6)
    tracemalloc.stop()


@pytest.mark.parametrize("with_index", [True, False], ids=["index", "no index"])
@pytest.mark.parametrize("n, size", [(2_000_000, 0), (300_000, 300)])
def test_a_small_chunk_of_very_many_messages_is_left_out_at_once_and_told(
    tmp_path, cost, with_index, n, size
):
    bomb = make_chunk([7 * MS] * n, bytes(size))
    path = crafted(span(0, 4), bomb).write(tmp_path / "a.mcap")
    assert path.stat().st_size < 25_000
    if not with_index:
        path.write_bytes(path.read_bytes()[:-40])
    before = cost()
    log = open_log(str(path))
    assert times(log) == [0, 2, 4]
    seconds, memory = (b - a for a, b in zip(before, cost(), strict=True))
    (fault,) = log.read_errors
    assert "too large chunks left out: 1 (a chunk of more than " in fault
    assert seconds < 2 and memory < 250


def test_a_chunk_of_as_many_messages_as_a_recorder_writes_is_read(tmp_path):
    """4 MB of messages without data, at times that no compression makes shorter than a byte."""
    rng_times = [(i * 7919 * 104729) % (10**9) for i in range(20_000)]
    log = open_log(str(crafted(make_chunk(rng_times, b"")).write(tmp_path / "a.mcap")))
    assert len(times(log)) == 20_000 < MAX_CHUNK_MESSAGES and log.read_errors == []


def _repeat(indexes):
    indexes[:] = [indexes[0]] * 2000


def _shift(indexes):
    indexes[1] = replace(indexes[1], chunk_start_offset=indexes[1].chunk_start_offset - 20)


def _shorten(indexes):
    indexes[0] = replace(indexes[0], chunk_length=indexes[0].chunk_length - 5)


def _hide_time(indexes):
    indexes[1] = replace(indexes[1], message_start_time=0, message_end_time=2**62)


def _beyond_the_file(indexes):
    indexes[1] = replace(indexes[1], chunk_start_offset=10**15)


@pytest.mark.parametrize("lie", [_repeat, _shift, _shorten, _hide_time, _beyond_the_file])
def test_an_index_that_differs_from_its_chunks_is_not_used_and_each_message_comes_once(
    tmp_path, cost, lie
):
    file = crafted(span(0, 4), span(6, 10))
    lie(file.chunk_indexes)
    log = open_log(str(file.write(tmp_path / "a.mcap")))
    assert times(log) == [0, 2, 4, 6, 8, 10]
    (fault,) = log.read_errors
    assert fault.startswith("a.mcap: its index cannot be read (") and "chunk" in fault
    assert "the whole file was read: 6 messages" in fault
    assert cost()[0] < 1


@pytest.mark.parametrize("with_index", [True, False], ids=["index", "no index"])
@pytest.mark.parametrize(
    "chunks",
    [[span(0, 1000)] * 2000, [span(0, 1000, size=1 << 22)] * 60],
    ids=["many", "large"],
)
def test_chunks_that_all_hold_the_same_times_are_refused_before_one_is_kept(
    tmp_path, cost, chunks, with_index
):
    path = crafted(*chunks).write(tmp_path / "a.mcap")
    if not with_index:
        path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError) as caught:
        open_log(str(path))
    assert "hold messages of the same log time 0 ns; expected at most 128 chunks" in str(
        caught.value
    )
    assert str(caught.value).endswith("Run `mcap sort` and use its output.")
    assert cost()[0] < 4 and cost()[1] < 100


def test_a_few_chunks_that_overlap_are_merged_in_the_order_of_time(tmp_path):
    log = open_log(
        str(crafted(*(span(n, 100 + n, n=11) for n in range(10))).write(tmp_path / "a.mcap"))
    )
    assert times(log) == sorted(times(log)) and len(times(log)) == 110
    assert log.read_errors == []


def test_a_message_outside_the_times_of_its_chunk_is_left_out_and_told(tmp_path):
    chunk = replace(span(0, 4), message_end_time=2 * MS)
    log = open_log(str(crafted(chunk).write(tmp_path / "a.mcap")))
    assert times(log) == [0, 2]
    assert log.read_errors == ["messages of impossible log times left out: 1"]


def test_finding_messages_again_takes_a_time_that_does_not_grow_with_the_chunks(tmp_path, cost):
    """1000 chunks, and one message of each: a million comparisons."""
    file = crafted(*(span(n, n, n=1) for n in range(1000)))
    log = open_log(str(file.write(tmp_path / "a.mcap")))
    assert len(times(log)) == 1000
    begin = time.process_time()
    assert all(len(log._find_pieces(0, n * MS)) == 1 for n in range(1000))
    assert time.process_time() - begin < 0.5


@pytest.mark.parametrize("with_index", [True, False], ids=["index", "no index"])
def test_many_small_chunks_that_unpack_to_gigabytes_are_refused_before_that(
    tmp_path, cost, monkeypatch, with_index
):
    monkeypatch.setattr(mcap_chunks, "FREE_UNPACKED_BYTES", 1 << 24)
    path = crafted(*(span(n, n, n=1, size=1 << 20) for n in range(100))).write(tmp_path / "a.mcap")
    if not with_index:
        path.write_bytes(path.read_bytes()[:-40])
        assert len(times(open_log(str(path)))) < 60
        assert "unpack to more than" in open_log(str(path)).read_errors[0]
        return
    with pytest.raises(InputError, match="a.mcap: its chunks unpack to more than 0.0 GB"):
        open_log(str(path))
