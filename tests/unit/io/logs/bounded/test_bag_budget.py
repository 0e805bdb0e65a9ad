"""ROS 1 bags of a stranger: an index that lists chunks again, or lies, costs no memory or time."""

import struct
import time

import pytest

from benchmarking.fuzzing.small_recordings import make_fuzz_messages, write_fuzz_log
from calib.io.logs.open_log import open_log
from calib.io.status import InputError

CHUNK_INFO = b"op=\x06"


@pytest.fixture
def bag(tmp_path):
    return write_fuzz_log("bag, lz4", tmp_path, make_fuzz_messages(("scanner",)))


def repeat_chunk_infos(data, n):
    """A bag whose index lists its chunks n times."""
    (index_pos,) = struct.unpack_from("<Q", data, data.index(b"index_pos=") + 10)
    position, infos = index_pos, b""
    while position < len(data):
        (n_header,) = struct.unpack_from("<L", data, position)
        (n_data,) = struct.unpack_from("<L", data, position + 4 + n_header)
        end = position + 8 + n_header + n_data
        if CHUNK_INFO in data[position : position + 4 + n_header]:
            infos += data[position:end]
        position = end
    at = data.index(b"chunk_count=") + 12
    (count,) = struct.unpack_from("<L", data, at)
    return data[:at] + struct.pack("<L", count * n) + data[at + 4 :] + infos * (n - 1)


def test_a_bag_whose_index_lists_its_chunks_2000_times_is_refused_at_once(bag):
    bag.write_bytes(repeat_chunk_infos(bag.read_bytes(), 2000))
    begin = time.process_time()
    with pytest.raises(InputError) as caught:
        open_log(str(bag))
    assert "a.bag: cannot be read (ReaderError: the index lists the chunk at byte " in str(
        caught.value
    )
    assert time.process_time() - begin < 1


def test_a_bag_that_declares_records_of_gigabytes_takes_no_memory(bag):
    data = bytearray(bag.read_bytes())
    (index_pos,) = struct.unpack_from("<Q", data, data.index(b"index_pos=") + 10)
    data[index_pos : index_pos + 4] = b"\xff" * 4
    bag.write_bytes(data)
    with pytest.raises(InputError, match="cannot be read"):
        open_log(str(bag))


def test_index_entries_that_all_name_one_message_are_told(bag):
    """The entries of the first topic all point to its first message."""
    data = bytearray(bag.read_bytes())
    at = data.index(b"op=\x04") - 4
    while data[at : at + 4] != (47).to_bytes(4, "little"):
        at -= 1
    (count,) = struct.unpack_from("<L", data, data.index(b"count=", at) + 6)
    first = at + 4 + 47 + 4
    entry = bytes(data[first : first + 12])
    data[first : first + 12 * count] = entry * count
    bag.write_bytes(data)
    log = open_log(str(bag))
    n_bytes = sum(len(m.data) for m in log.iter_messages(log.topics))
    assert n_bytes < 100 * len(data)


def test_a_sound_bag_is_read_whole(bag):
    log = open_log(str(bag))
    assert len(list(log.iter_messages(log.topics))) == 20 and log.read_errors == []
