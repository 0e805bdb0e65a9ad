"""Logs: every message in order and found again, and a clear word about what cannot be read."""

import bz2
import os
import re
import shutil
import time

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from calib.io.logs import ros_messages
from calib.io.logs.bounded.decompression import (
    TooLargeError,
    decompress_bzip2,
    decompress_lz4,
    decompress_zstd,
)
from calib.io.logs.open_log import find_log_files, fingerprint_log, open_log, require_same_log
from calib.io.logs.ros_messages import COMPRESSED_IMAGE_TYPE, IMAGE_TYPE, TF_TYPE, make_tf_message
from calib.io.status import InputError
from helpers.log_containers import SQLITE_PLUGIN, make_container_rows, write_rosbag2
from helpers.real_data import find_shared_data

MS = 1_000_000


def pose_message(number):
    """A TFMessage that says its number."""
    T = np.eye(4)
    T[0, 3] = number
    return make_tf_message(number * MS, "map", {"body": T})


def said(content):
    """The number that a TFMessage says."""
    return round(content.transforms[0].transform.translation.x)


def write(path, rows, **options):
    """An MCAP of rows (log time, topic, number)."""
    options = {"chunk_size": 500, "compression": CompressionType.ZSTD} | options
    with open(path, "wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile="ros2", library="test")
        text = ros_messages.ROS2_TYPES.generate_msgdef(TF_TYPE, ros_version=2)[0].encode()
        schema = writer.register_schema(TF_TYPE, "ros2msg", text)
        topics = sorted({topic for _, topic, _ in rows})
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in topics}
        for log_t, topic, number in rows:
            data = bytes(ros_messages.ROS2_TYPES.serialize_cdr(pose_message(number), TF_TYPE))
            writer.add_message(channels[topic], log_t, data, log_t)
        writer.finish()
    return path


def alternating(first, n):
    """Rows of two topics in turn, 1 ms apart."""
    return [(i * MS, "/tf" if i % 2 else "/other", i) for i in range(first, first + n)]


def numbers(log, topics=("/tf", "/other"), **bounds):
    return [said(m.content) for m in log.iter_messages(topics, **bounds)]


def metadata(folder, *names):
    lines = "".join(f"    - {name}\n" for name in names)
    text = f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{lines}"
    (folder / "metadata.yaml").write_text(text)


def refusal(log):
    with pytest.raises(InputError) as caught:
        log = open_log(str(log))
        for message in log.messages(log.topics):
            assert message.content
    return str(caught.value)


# --- messages


def test_messages_come_in_order_of_log_time_whatever_order_they_were_written_in(tmp_path):
    rows = alternating(0, 50)
    shuffled = [rows[i] for i in np.random.default_rng(0).permutation(50)]
    log = open_log(str(write(tmp_path / "a.mcap", shuffled)))
    assert numbers(log) == list(range(50))
    assert [m.log_time_ns for m in log.iter_messages(["/tf"])] == [i * MS for i in range(1, 50, 2)]


def test_topics_come_with_their_type_and_count(tmp_path):
    log = open_log(str(write(tmp_path / "a.mcap", alternating(0, 9))))
    assert log.topics == {"/other": (TF_TYPE, 5), "/tf": (TF_TYPE, 4)}
    message = next(log.iter_messages(["/tf"]))
    assert (message.topic, message.type, message.file_index) == ("/tf", TF_TYPE, 0)


def test_only_the_topics_asked_for_are_read(tmp_path):
    log = open_log(str(write(tmp_path / "a.mcap", alternating(0, 9))))
    assert numbers(log, ["/tf"]) == [1, 3, 5, 7]
    assert numbers(log, ["/absent"]) == []


def test_bounds_are_of_log_time_first_included_last_not(tmp_path):
    log = open_log(str(write(tmp_path / "a.mcap", alternating(0, 9))))
    assert numbers(log, start_ns=3 * MS, end_ns=6 * MS) == [3, 4, 5]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"chunk_size": 10_000_000},
    ],
    ids=["zstd", "lz4", "none", "no chunks", "one chunk"],
)
def test_a_message_is_found_again_also_among_equals_in_log_time(tmp_path, options):
    """Three of each topic at every log time, interleaved."""
    rows = [(i // 6 * MS, "/tf" if i % 2 else "/other", i) for i in range(60)]
    log = open_log(str(write(tmp_path / "a.mcap", rows, **options)))
    found = list(log.iter_messages(["/tf", "/other"]))
    assert sorted(said(m.content) for m in found) == list(range(60))
    for m in found:
        assert said(
            log.read_message_content(m.topic, m.file_index, m.log_time_ns, m.index_at_log_time)
        ) == said(m.content)
    places = {(m.topic, m.log_time_ns, m.index_at_log_time) for m in found}
    assert len(places) == 60 and {m.index_at_log_time for m in found} == {0, 1, 2}


def test_a_place_does_not_depend_on_bounds_or_on_the_other_topics_read(tmp_path):
    rows = [(i // 6 * MS, "/tf" if i % 2 else "/other", i) for i in range(60)]
    log = open_log(str(write(tmp_path / "a.mcap", rows)))

    def places(*arguments):
        return {
            said(m.content): (m.file_index, m.log_time_ns, m.index_at_log_time)
            for m in log.iter_messages(*arguments)
        }

    every = places(["/tf", "/other"])
    for few in (places(["/tf"]), places(["/other"], 3 * MS, 7 * MS)):
        assert few and all(every[k] == v for k, v in few.items())


def test_a_message_that_is_not_there_is_named(tmp_path):
    log = open_log(str(write(tmp_path / "a.mcap", alternating(0, 9))))
    with pytest.raises(InputError, match=r"a\.mcap: no message of /tf at 2000000 ns any more"):
        log.read_message_content("/tf", 0, 2 * MS, 0)
    with pytest.raises(InputError, match="no message of /tf at 1000000"):
        log.read_message_content("/tf", 0, 1 * MS, 1)


def test_a_topic_without_a_schema_is_listed_and_read_as_bytes(tmp_path):
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_message(writer.register_channel("/raw", "json", 0), 5, b"{}", 5)
        writer.finish()
    log = open_log(str(tmp_path / "a.mcap"))
    assert log.topics == {"/raw": ("without schema", 1)}
    assert [m.data for m in log.iter_messages(["/raw"])] == [b"{}"]


def undefined(path, name, data, encoding="cdr", form="", text=b""):
    """An MCAP of one message of a type without a definition that serves."""
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(name, form, text)
        writer.add_message(writer.register_channel("/topic", encoding, schema), 5, data, 5)
        writer.finish()
    return open_log(str(path))


def test_a_type_that_ros_ships_needs_no_definition(tmp_path):
    data = bytes(ros_messages.ROS2_TYPES.serialize_cdr(pose_message(7), TF_TYPE))
    log = undefined(tmp_path / "a.mcap", TF_TYPE, data)
    assert numbers(log, ["/topic"]) == [7]


def test_a_message_without_its_definition_is_refused_with_its_type(tmp_path):
    log = undefined(tmp_path / "a.mcap", "own_msgs/msg/Pose", b"data")
    assert log.topics == {"/topic": ("own_msgs/msg/Pose", 1)}
    expected = r"a\.mcap: holds no definition of own_msgs/msg/Pose, and ROS does not ship this type"
    with pytest.raises(InputError, match=expected):
        assert next(log.iter_messages(["/topic"])).content


def test_a_foreign_serialisation_is_refused_by_name(tmp_path):
    log = undefined(tmp_path / "a.mcap", TF_TYPE, b"data", "protobuf")
    expected = r"a\.mcap: tf2_msgs/msg/TFMessage is serialised as protobuf; expected cdr"
    with pytest.raises(InputError, match=expected):
        assert next(log.iter_messages(["/topic"])).content


@pytest.mark.parametrize(
    "name, text",
    [
        ("own_msgs/msg/Pose", b"!!!"),
        ("own_msgs/msg/Pose", b"float32 x\n" * 200_000),
    ],
    ids=["no definition", "too long"],
)
def test_a_definition_that_is_none_is_refused(tmp_path, name, text):
    log = undefined(tmp_path / "a.mcap", name, b"\0\1\0\0" + bytes(8), form="ros2msg", text=text)
    expected = r"a\.mcap: the definition of own_msgs/msg/Pose(?s:.*) cannot be read \("
    for _ in range(2):
        with pytest.raises(InputError, match=expected):
            assert next(log.iter_messages(["/topic"])).content


def test_of_code_in_the_name_of_a_type_a_safe_name_is_left(tmp_path):
    name = "own_msgs/msg/Pose:\n    pass\nimport os #"
    content = b"\0\1\0\0" + np.float32(1.5).tobytes()
    log = undefined(tmp_path / "a.mcap", name, content, form="ros2msg", text=b"float32 x")
    ((safe, _),) = log.topics.values()
    assert re.fullmatch(r"own_msgs/msg/Pose_pass_import_os__[0-9a-f]{16}", safe)
    assert next(log.iter_messages(["/topic"])).content.x == 1.5


def test_a_message_that_does_not_fit_its_definition_is_refused_with_its_type(tmp_path):
    log = undefined(tmp_path / "a.mcap", TF_TYPE, b"\0\1\0\0\xff\xff\xff\xff")
    message = next(log.iter_messages(["/topic"]))
    with pytest.raises(InputError, match="a message of tf2_msgs/msg/TFMessage cannot be read"):
        assert message.content


@pytest.mark.parametrize("little_endian", [True, False])
def test_the_header_of_a_message_is_read_without_the_rest(tmp_path, little_endian):
    image = ros_messages.ROS2_TYPES.types[COMPRESSED_IMAGE_TYPE](
        header=ros_messages.make_ros_header(5_000_000_007, "camera"),
        format="jpeg",
        data=np.zeros(9, np.uint8),
    )
    data = ros_messages.ROS2_TYPES.serialize_cdr(
        image, COMPRESSED_IMAGE_TYPE, little_endian=little_endian
    )
    log = undefined(tmp_path / "a.mcap", COMPRESSED_IMAGE_TYPE, bytes(data)[:-9])
    header = next(log.iter_messages(["/topic"])).header
    assert (header.stamp.sec, header.stamp.nanosec, header.frame_id) == (5, 7, "camera")


def test_a_type_named_without_msg_is_read_like_one_with_it(tmp_path):
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        text = ros_messages.ROS2_TYPES.generate_msgdef(TF_TYPE, ros_version=2)[0].encode()
        schema = writer.register_schema("tf2_msgs/TFMessage", "ros2msg", text)
        data = bytes(ros_messages.ROS2_TYPES.serialize_cdr(pose_message(7), TF_TYPE))
        writer.add_message(writer.register_channel("/tf", "cdr", schema), 5, data, 5)
        writer.finish()
    log = open_log(str(tmp_path / "a.mcap"))
    assert log.topics["/tf"] == (TF_TYPE, 1)
    assert numbers(log, ["/tf"]) == [7]


# --- files


def test_split_files_are_one_log(tmp_path):
    paths = [write(tmp_path / f"{n}.mcap", alternating(10 * i, 10)) for i, n in enumerate("abc")]
    log = open_log([str(p) for p in paths])
    assert log.topics["/tf"] == (TF_TYPE, 15)
    found = list(log.iter_messages(["/tf", "/other"]))
    assert [said(m.content) for m in found] == list(range(30))
    for m in found:
        assert said(
            log.read_message_content(m.topic, m.file_index, m.log_time_ns, m.index_at_log_time)
        ) == said(m.content)
    assert numbers(log, start_ns=8 * MS, end_ns=12 * MS) == [8, 9, 10, 11]


def test_split_files_are_put_in_the_order_of_time(tmp_path):
    """A list in the wrong order would make every stamp of the later files a fault."""
    early = write(tmp_path / "z.mcap", alternating(0, 10))
    late = write(tmp_path / "a.mcap", alternating(10, 10))
    assert numbers(open_log([str(late), str(early)])) == list(range(20))


def test_a_folder_of_a_rosbag2_is_read_as_its_metadata_says(tmp_path):
    for i in range(12):
        write(tmp_path / f"bag_{i}.mcap", alternating(10 * i, 10))
    write(tmp_path / "stray.mcap", alternating(500, 3))
    metadata(tmp_path, *(f"bag_{i}.mcap" for i in range(12)))
    files = find_log_files(str(tmp_path))
    assert [f.name for f in files] == [f"bag_{i}.mcap" for i in range(12)]
    assert numbers(open_log(str(tmp_path))) == list(range(120))


def test_a_folder_without_metadata_is_read_in_order_of_time_not_of_names(tmp_path):
    """bag_10 comes before bag_2 in the alphabet."""
    for i in range(12):
        write(tmp_path / f"bag_{i}.mcap", alternating(10 * i, 10))
    assert numbers(open_log(str(tmp_path))) == list(range(120))


def test_metadata_may_name_files_with_the_folder_they_were_recorded_in(tmp_path):
    write(tmp_path / "bag_0.mcap", alternating(0, 5))
    metadata(tmp_path, "elsewhere/bag/bag_0.mcap")
    assert numbers(open_log(str(tmp_path))) == list(range(5))


def test_a_log_without_a_message_is_a_log(tmp_path):
    log = open_log(str(write(tmp_path / "a.mcap", [])))
    assert log.topics == {} and list(log.iter_messages([])) == [] and numbers(log) == []


# --- what cannot be read


def test_a_missing_file_is_named_with_the_key_to_check(tmp_path):
    message = refusal(tmp_path / "gone.mcap")
    assert "gone.mcap: no such log. Check sessions.<name>.log in config/config.yaml" in message


def test_a_file_that_metadata_names_but_is_not_there_is_named(tmp_path):
    write(tmp_path / "bag_0.mcap", alternating(0, 5))
    metadata(tmp_path, "bag_0.mcap", "bag_1.mcap")
    message = refusal(tmp_path)
    assert "bag_1.mcap: no such log, but " in message
    assert "write the list of the existing files at sessions.<name>.log" in message


@pytest.mark.parametrize("text", ["", "a: 1", "rosbag2_bagfile_information: []", "a: [", "- 1"])
def test_metadata_that_is_not_rosbag2s_is_refused(tmp_path, text):
    write(tmp_path / "bag_0.mcap", alternating(0, 5))
    (tmp_path / "metadata.yaml").write_text(text)
    assert (
        "metadata.yaml: does not list the files of a rosbag2 log. Run `ros2 bag reindex"
        in refusal(tmp_path)
    )


@pytest.mark.parametrize(
    "name, kind", [("a.pcap", ".pcap"), ("a.pcap.zstd", ".pcap"), ("log", "without suffix")]
)
def test_an_unknown_suffix_is_refused_with_what_is_read_and_how_to_convert(tmp_path, name, kind):
    (tmp_path / name).write_bytes(b"x")
    message = refusal(tmp_path / name)
    assert f"{name}: a file of type {kind}, expected " in message
    assert ".mcap" in message and "ros2 bag convert" in message


def test_an_empty_folder_is_refused(tmp_path):
    assert "no log in this folder; expected " in refusal(tmp_path)


@pytest.mark.parametrize("content", [b"", b"hello world" * 20], ids=["empty", "garbage"])
def test_a_file_that_is_no_mcap_is_refused_with_a_way_to_look_at_it(tmp_path, content):
    (tmp_path / "a.mcap").write_bytes(content)
    message = refusal(tmp_path / "a.mcap")
    assert "a.mcap: not a readable MCAP file (" in message and "Run `mcap doctor a.mcap`" in message


@pytest.mark.parametrize("chunks", [True, False])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_file_cut_short_is_read_up_to_the_break_and_says_how_much_was_there(
    tmp_path, share, chunks
):
    path = write(tmp_path / "a.mcap", alternating(0, 2000), use_chunking=chunks, chunk_size=20_000)
    size = round(share * path.stat().st_size)
    path.write_bytes(path.read_bytes()[:size])
    log = open_log(str(path))
    found = list(log.iter_messages(["/tf", "/other"]))
    n = len(found)
    assert [said(m.content) for m in found] == list(range(n))
    assert n > (share - 0.2) * 2000
    assert sum(count for _, count in log.topics.values()) == n
    (fault,) = log.read_errors
    assert fault.startswith("a.mcap: breaks off after byte ")
    assert f" of {size} (" in fault and f"{n} messages of {(n - 1) / 1000:.1f} s" in fault
    for m in found[:: n // 7]:
        assert said(
            log.read_message_content(m.topic, m.file_index, m.log_time_ns, m.index_at_log_time)
        ) == said(m.content)


@pytest.mark.parametrize("size", [8, 20, 300])
def test_a_file_cut_short_before_its_first_message_is_refused(tmp_path, size):
    path = write(tmp_path / "a.mcap", alternating(0, 200))
    path.write_bytes(path.read_bytes()[:size])
    message = refusal(path)
    assert "a.mcap: breaks off after byte " in message
    assert f" of {size} (" in message and message.endswith("before its first whole message")


def test_a_file_whose_index_alone_is_missing_loses_no_message(tmp_path):
    path = write(tmp_path / "a.mcap", alternating(0, 200))
    path.write_bytes(path.read_bytes()[:-40])
    log = open_log(str(path))
    assert numbers(log) == list(range(200))
    (fault,) = log.read_errors
    assert fault.startswith("a.mcap: its index cannot be read (")
    assert fault.endswith("the whole file was read: 200 messages of 0.2 s could be read")


@pytest.mark.parametrize(
    "options",
    [{"use_statistics": False}, {"use_summary_offsets": False}, {"repeat_channels": False}]
    + [{"index_types": 0}],
    ids=str,
)
def test_a_file_without_all_of_an_index_is_read_whole_without_a_fault(tmp_path, options):
    if "index_types" in options:
        options = {"index_types": IndexType.NONE}
    log = open_log(str(write(tmp_path / "a.mcap", alternating(0, 200), **options)))
    assert log.topics["/tf"] == (TF_TYPE, 100) and numbers(log) == list(range(200))
    assert log.read_errors == []


@pytest.mark.parametrize(
    "compression", [CompressionType.ZSTD, CompressionType.LZ4], ids=["zstd", "lz4"]
)
def test_damage_within_a_file_costs_its_chunk_and_is_told(tmp_path, compression):
    path = write(tmp_path / "a.mcap", alternating(0, 2000), compression=compression)
    with path.open("rb") as stream:
        index = make_reader(stream).get_summary().chunk_indexes[100]
    data = bytearray(path.read_bytes())
    middle = index.chunk_start_offset + index.chunk_length // 2
    data[middle : middle + 40] = bytes(40)
    path.write_bytes(data)
    log = open_log(str(path))
    found = numbers(log)
    assert 1990 <= len(found) < 2000 and found == sorted(found)
    (fault,) = log.read_errors
    assert fault == "a.mcap: damaged chunks left out: 1"


def test_a_chunk_that_declares_more_than_there_is_takes_no_memory(tmp_path):
    """Its size says 2^62 bytes, its frame is of as many zeros as fit into 2 GB."""
    path = write(tmp_path / "a.mcap", alternating(0, 20), chunk_size=9**6)
    with path.open("rb") as stream:
        (index,) = make_reader(stream).get_summary().chunk_indexes
    data = bytearray(path.read_bytes())
    at = index.chunk_start_offset + 9 + 16
    data[at : at + 8] = (2**62).to_bytes(8, "little")
    path.write_bytes(data)
    log = open_log(str(path))
    assert numbers(log) == [] and log.read_errors == ["a.mcap: damaged chunks left out: 1"]


@pytest.mark.parametrize("pack", [zstandard.compress, lz4.frame.compress], ids=["zstd", "lz4"])
def test_a_small_block_that_unpacks_to_gigabytes_is_not_unpacked(pack):
    bomb, unpack = (
        pack(bytes(1 << 24)),
        {zstandard.compress: decompress_zstd}.get(pack, decompress_lz4),
    )
    assert len(bomb) < 1 << 17
    with pytest.raises(TooLargeError):
        unpack(bomb, 1 << 20)
    assert unpack(bomb, 1 << 24) == bytes(1 << 24)


def test_a_block_of_bzip2_that_unpacks_to_gigabytes_is_not_unpacked():
    with pytest.raises(TooLargeError):
        decompress_bzip2(bz2.compress(bytes(1 << 24)), 1 << 20)


def test_a_list_of_two_formats_is_refused(tmp_path):
    paths = [write(tmp_path / "a.mcap", alternating(0, 5)), tmp_path / "b.bag"]
    paths[1].write_bytes(b"x")
    with pytest.raises(
        InputError, match=r"a log of files of \.bag and \.mcap; expected one or more"
    ):
        open_log([str(p) for p in paths])


@pytest.mark.parametrize(
    "name, remedy", [("a.bag", "rosbag reindex a.bag"), ("a.db3", "sqlite3 a.db3 .recover")]
)
@pytest.mark.parametrize("content", [b"", b"hello world" * 20], ids=["empty", "garbage"])
def test_a_file_that_is_not_of_its_suffix_is_refused_with_the_remedy(
    tmp_path, name, remedy, content
):
    (tmp_path / name).write_bytes(content)
    message = refusal(tmp_path / name)
    assert f"{name}: cannot be read (" in message and remedy in message


def test_a_compressed_file_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.mcap.zstd").write_bytes(b"hello world" * 20)
    assert "a.mcap.zstd: cannot be decompressed in " in refusal(tmp_path / "a.mcap.zstd")


def test_a_journal_beside_an_sqlite_file_is_told(tmp_path):
    folder = write_rosbag2(tmp_path / "bag", make_container_rows("TFMessage"), SQLITE_PLUGIN)
    (folder / "bag.db3-wal").write_bytes(b"x")
    (fault,) = open_log(str(folder)).read_errors
    assert fault.startswith("bag.db3: its last messages may be in bag.db3-wal, which is not read")


# --- whether a log is still the same


def test_touching_or_copying_a_log_keeps_its_fingerprint(tmp_path):
    path = write(tmp_path / "a.mcap", alternating(0, 20))
    before = fingerprint_log(str(path))
    os.utime(path, (0, time.time() + 1000))
    assert fingerprint_log(str(path)) == before
    (tmp_path / "other").mkdir()
    copy = shutil.copy(path, tmp_path / "other" / "a.mcap")
    assert fingerprint_log(str(copy)) == before
    require_same_log(str(copy), before)


@pytest.mark.parametrize("size", [100, (1 << 20) + 10, (3 << 20)])
@pytest.mark.parametrize("where", ["first byte", "last byte", "length", "name"])
def test_a_changed_log_has_another_fingerprint(tmp_path, size, where):
    path = tmp_path / "a.mcap"
    content = bytearray(np.random.default_rng(0).bytes(size))
    path.write_bytes(content)
    before = fingerprint_log(str(path))
    if where == "first byte":
        content[0] ^= 1
    elif where == "last byte":
        content[-1] ^= 1
    elif where == "length":
        content[size // 2 : size // 2] = b"x"
    else:
        path = path.rename(tmp_path / "b.mcap")
    path.write_bytes(content)
    assert fingerprint_log(str(path)) != before


def test_a_log_of_many_files_has_one_line_for_each(tmp_path):
    paths = [write(tmp_path / f"{n}.mcap", alternating(10 * i, 10)) for i, n in enumerate("abc")]
    lines = fingerprint_log([str(p) for p in paths])
    assert [line.split()[0] for line in lines] == ["a.mcap", "b.mcap", "c.mcap"]
    assert [int(line.split()[1]) for line in lines] == [p.stat().st_size for p in paths]


def test_a_log_that_changed_since_it_was_decoded_is_refused_with_the_remedy(tmp_path):
    path = write(tmp_path / "a.mcap", alternating(0, 20))
    before = fingerprint_log(str(path))
    write(path, alternating(0, 21))
    with pytest.raises(InputError) as caught:
        require_same_log(str(path), before)
    assert "a.mcap: changed since it was decoded. Run snakemake again" in str(caught.value)


# --- recorded logs of others


def test_a_split_rosbag2_of_ros_itself_is_read_whole_and_in_order():
    log = open_log(str(find_shared_data("logs/rosbag2_split")))
    times = [m.log_time_ns for m in log.iter_messages(log.topics)]
    assert len(log.files) == 5
    assert len(times) == sum(n for _, n in log.topics.values()) > 0
    assert times == sorted(times)


def test_a_rosbag2_with_service_events_lists_them_and_reads_its_topics():
    log = open_log(str(find_shared_data("logs/rosbag2_services")))
    readable = [topic for topic, (kind, n) in log.topics.items() if n and "/msg/" in kind]
    assert any("_service_event" in topic for topic in log.topics)
    plain = [t for t in readable if "_service_event" not in t]
    assert len(plain) == 2 and log.read_errors == []
    assert all(m.content is not None for m in log.iter_messages(plain))


def test_a_rosbag2_in_a_foreign_serialisation_is_refused_by_its_name():
    log = open_log(str(find_shared_data("logs/rosbag2_wrong_rmw")))
    assert {k: n for k, (_, n) in log.topics.items()} == {"/array_topic": 4, "/test_topic": 3}
    with pytest.raises(InputError, match="BasicTypes is serialised as wrong_format; expected"):
        assert next(log.iter_messages(["/test_topic"])).content


def test_messages_compressed_one_by_one_are_read_and_their_folder_names_the_missing_files():
    folder = find_shared_data("logs/amber_message_zstd")
    log = open_log(str(folder / "soccer_goal_12.mcap"))
    first, second = log.iter_messages(["/camera/image_raw"])
    assert first.type == IMAGE_TYPE
    image = first.content
    assert len(image.data) == image.height * image.step and image.step >= 3 * image.width
    assert (first.log_time_ns, second.log_time_ns) == (8_297_777_777, 8_331_088_888)
    again = log.read_message_content("/camera/image_raw", 0, second.log_time_ns, 0)
    assert np.array_equal(again.data, second.content.data)
    with pytest.raises(InputError, match=r"soccer_goal_0\.mcap: no such log, but"):
        open_log(str(folder))


def test_an_sqlite_file_without_definitions_is_read_with_the_types_that_ros_ships():
    """Its README line says that it holds no message; it holds ten of two topics."""
    log = open_log(str(find_shared_data("logs/rosbag2_sqlite3")))
    assert {k: n for k, (_, n) in log.topics.items()} == {
        "/topic": 10, "/rosout": 10, "/parameter_events": 0,
    }  # fmt: skip
    assert [m.content.data for m in log.iter_messages(["/topic"])][0] == "Hello, world! 0"


# --- names of logs


@pytest.fixture
def run_files(tmp_path):
    """A folder with two logs and one of a bracketed name."""
    names = ("run_1.mcap", "run_2.mcap", "cut [3].mcap")
    for name in names:
        (tmp_path / name).touch()
    return tmp_path


def test_a_pattern_stands_for_the_files_that_match_in_order(run_files):
    found = find_log_files(str(run_files / "run_*.mcap"))
    assert found == [run_files / "run_1.mcap", run_files / "run_2.mcap"]
    assert find_log_files([str(run_files / "run_[2-9].mcap")]) == [run_files / "run_2.mcap"]


def test_a_tilde_is_the_home_folder(run_files, monkeypatch):
    monkeypatch.setenv("HOME", str(run_files))
    assert find_log_files("~/run_1.mcap") == [run_files / "run_1.mcap"]
    assert find_log_files("~/run_?.mcap")[-1] == run_files / "run_2.mcap"


def test_a_file_that_exists_is_no_pattern(run_files):
    assert find_log_files(str(run_files / "cut [3].mcap")) == [run_files / "cut [3].mcap"]


def test_a_pattern_without_a_match_is_refused_with_its_key(run_files):
    with pytest.raises(InputError, match="no file matches this pattern. Check sessions.<name>.log"):
        find_log_files(str(run_files / "drive_*.mcap"))


def test_a_name_in_braces_is_refused_because_snakemake_reads_a_wildcard(run_files):
    (run_files / "run {a}.mcap").touch()
    with pytest.raises(InputError, match="names in braces as wildcards. Rename the file"):
        find_log_files(str(run_files / "run {a}.mcap"))
