"""Logs: every message in order and found again, and a clear word about what cannot be read."""

import os
import shutil
import time

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from calib import logs
from calib.sim import log as record
from calib.status import InputError
from shared import shared_data

MS = 1_000_000


def pose_message(number):
    """A TFMessage that says its number."""
    T = np.eye(4)
    T[0, 3] = number
    return record.transforms(number * MS, "map", {"body": T})


def said(content):
    """The number that a TFMessage says."""
    return round(content.transforms[0].transform.translation.x)


def write(path, rows, **options):
    """An MCAP of rows (log time, topic, number)."""
    options = {"chunk_size": 500, "compression": CompressionType.ZSTD} | options
    with open(path, "wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile="ros2", library="test")
        text = record.STORE.generate_msgdef(record.TF, ros_version=2)[0].encode()
        schema = writer.register_schema(record.TF, "ros2msg", text)
        topics = sorted({topic for _, topic, _ in rows})
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in topics}
        for log_t, topic, number in rows:
            data = bytes(record.STORE.serialize_cdr(pose_message(number), record.TF))
            writer.add_message(channels[topic], log_t, data, log_t)
        writer.finish()
    return path


def alternating(first, n):
    """Rows of two topics in turn, 1 ms apart."""
    return [(i * MS, "/tf" if i % 2 else "/other", i) for i in range(first, first + n)]


def numbers(log, topics=("/tf", "/other"), **bounds):
    return [said(m.content) for m in log.messages(topics, **bounds)]


def metadata(folder, *names):
    lines = "".join(f"    - {name}\n" for name in names)
    text = f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{lines}"
    (folder / "metadata.yaml").write_text(text)


def refusal(log):
    with pytest.raises(InputError) as caught:
        log = logs.open_log(str(log))
        for message in log.messages(log.topics):
            assert message.content
    return str(caught.value)


# --- messages


def test_messages_come_in_order_of_log_time_whatever_order_they_were_written_in(tmp_path):
    rows = alternating(0, 50)
    shuffled = [rows[i] for i in np.random.default_rng(0).permutation(50)]
    log = logs.open_log(str(write(tmp_path / "a.mcap", shuffled)))
    assert numbers(log) == list(range(50))
    assert [m.log_t for m in log.messages(["/tf"])] == [i * MS for i in range(1, 50, 2)]


def test_topics_come_with_their_type_and_count(tmp_path):
    log = logs.open_log(str(write(tmp_path / "a.mcap", alternating(0, 9))))
    assert log.topics == {"/other": (record.TF, 5), "/tf": (record.TF, 4)}
    message = next(log.messages(["/tf"]))
    assert (message.topic, message.type, message.file) == ("/tf", record.TF, 0)


def test_only_the_topics_asked_for_are_read(tmp_path):
    log = logs.open_log(str(write(tmp_path / "a.mcap", alternating(0, 9))))
    assert numbers(log, ["/tf"]) == [1, 3, 5, 7]
    assert numbers(log, ["/absent"]) == []


def test_bounds_are_of_log_time_first_included_last_not(tmp_path):
    log = logs.open_log(str(write(tmp_path / "a.mcap", alternating(0, 9))))
    assert numbers(log, start=3 * MS, end=6 * MS) == [3, 4, 5]


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
    log = logs.open_log(str(write(tmp_path / "a.mcap", rows, **options)))
    found = list(log.messages(["/tf", "/other"]))
    assert sorted(said(m.content) for m in found) == list(range(60))
    for m in found:
        assert said(log.message(m.topic, m.file, m.log_t, m.ordinal)) == said(m.content)
    places = {(m.topic, m.log_t, m.ordinal) for m in found}
    assert len(places) == 60 and {m.ordinal for m in found} == {0, 1, 2}


def test_a_place_does_not_depend_on_bounds_or_on_the_other_topics_read(tmp_path):
    rows = [(i // 6 * MS, "/tf" if i % 2 else "/other", i) for i in range(60)]
    log = logs.open_log(str(write(tmp_path / "a.mcap", rows)))

    def places(*arguments):
        return {said(m.content): (m.file, m.log_t, m.ordinal) for m in log.messages(*arguments)}

    every = places(["/tf", "/other"])
    for few in (places(["/tf"]), places(["/other"], 3 * MS, 7 * MS)):
        assert few and all(every[k] == v for k, v in few.items())


def test_a_message_that_is_not_there_is_named(tmp_path):
    log = logs.open_log(str(write(tmp_path / "a.mcap", alternating(0, 9))))
    with pytest.raises(InputError, match=r"a\.mcap: no message of /tf at 2000000 any more"):
        log.message("/tf", 0, 2 * MS, 0)
    with pytest.raises(InputError, match="no message of /tf at 1000000"):
        log.message("/tf", 0, 1 * MS, 1)


def test_a_topic_without_a_schema_is_listed_and_read_as_bytes(tmp_path):
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_message(writer.register_channel("/raw", "json", 0), 5, b"{}", 5)
        writer.finish()
    log = logs.open_log(str(tmp_path / "a.mcap"))
    assert log.topics == {"/raw": ("without schema", 1)}
    assert [m.data for m in log.messages(["/raw"])] == [b"{}"]


def test_a_message_without_its_definition_is_refused_with_its_type(tmp_path):
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(record.CLOUD, "ros2idl", b"module sensor_msgs {};")
        writer.add_message(writer.register_channel("/points", "cdr", schema), 5, b"data", 5)
        writer.finish()
    log = logs.open_log(str(tmp_path / "a.mcap"))
    assert log.topics == {"/points": (record.CLOUD, 1)}
    with pytest.raises(InputError, match=r"a\.mcap: holds sensor_msgs/msg/PointCloud2 without its"):
        assert next(log.messages(["/points"])).content


def test_a_type_named_without_msg_is_read_like_one_with_it(tmp_path):
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        text = record.STORE.generate_msgdef(record.TF, ros_version=2)[0].encode()
        schema = writer.register_schema("tf2_msgs/TFMessage", "ros2msg", text)
        data = bytes(record.STORE.serialize_cdr(pose_message(7), record.TF))
        writer.add_message(writer.register_channel("/tf", "cdr", schema), 5, data, 5)
        writer.finish()
    log = logs.open_log(str(tmp_path / "a.mcap"))
    assert log.topics["/tf"] == (record.TF, 1)
    assert numbers(log, ["/tf"]) == [7]


# --- files


def test_split_files_are_one_log(tmp_path):
    paths = [write(tmp_path / f"{n}.mcap", alternating(10 * i, 10)) for i, n in enumerate("abc")]
    log = logs.open_log([str(p) for p in paths])
    assert log.topics["/tf"] == (record.TF, 15)
    found = list(log.messages(["/tf", "/other"]))
    assert [said(m.content) for m in found] == list(range(30))
    for m in found:
        assert said(log.message(m.topic, m.file, m.log_t, m.ordinal)) == said(m.content)
    assert numbers(log, start=8 * MS, end=12 * MS) == [8, 9, 10, 11]


def test_split_files_are_put_in_the_order_of_time(tmp_path):
    """A list in the wrong order would make every stamp of the later files a fault."""
    early = write(tmp_path / "z.mcap", alternating(0, 10))
    late = write(tmp_path / "a.mcap", alternating(10, 10))
    assert numbers(logs.open_log([str(late), str(early)])) == list(range(20))


def test_a_folder_of_a_rosbag2_is_read_as_its_metadata_says(tmp_path):
    for i in range(12):
        write(tmp_path / f"bag_{i}.mcap", alternating(10 * i, 10))
    write(tmp_path / "stray.mcap", alternating(500, 3))
    metadata(tmp_path, *(f"bag_{i}.mcap" for i in range(12)))
    files = logs.files_of(str(tmp_path))
    assert [f.name for f in files] == [f"bag_{i}.mcap" for i in range(12)]
    assert numbers(logs.open_log(str(tmp_path))) == list(range(120))


def test_a_folder_without_metadata_is_read_in_order_of_time_not_of_names(tmp_path):
    """bag_10 comes before bag_2 in the alphabet."""
    for i in range(12):
        write(tmp_path / f"bag_{i}.mcap", alternating(10 * i, 10))
    assert numbers(logs.open_log(str(tmp_path))) == list(range(120))


def test_metadata_may_name_files_with_the_folder_they_were_recorded_in(tmp_path):
    write(tmp_path / "bag_0.mcap", alternating(0, 5))
    metadata(tmp_path, "elsewhere/bag/bag_0.mcap")
    assert numbers(logs.open_log(str(tmp_path))) == list(range(5))


def test_a_log_without_a_message_is_a_log(tmp_path):
    log = logs.open_log(str(write(tmp_path / "a.mcap", [])))
    assert log.topics == {} and list(log.messages([])) == [] and numbers(log) == []


# --- what cannot be read


def test_a_missing_file_is_named_with_the_key_to_check(tmp_path):
    message = refusal(tmp_path / "gone.mcap")
    assert "gone.mcap: no such log; check sessions.<name>.log in config/config.yaml" in message


def test_a_file_that_metadata_names_but_is_not_there_is_named(tmp_path):
    write(tmp_path / "bag_0.mcap", alternating(0, 5))
    metadata(tmp_path, "bag_0.mcap", "bag_1.mcap")
    assert "bag_1.mcap: no such log" in refusal(tmp_path)


@pytest.mark.parametrize("text", ["", "a: 1", "rosbag2_bagfile_information: []", "a: [", "- 1"])
def test_metadata_that_is_not_rosbag2s_is_refused(tmp_path, text):
    write(tmp_path / "bag_0.mcap", alternating(0, 5))
    (tmp_path / "metadata.yaml").write_text(text)
    assert "metadata.yaml: names no files of a rosbag2 log; run `ros2 bag reindex" in refusal(
        tmp_path
    )


@pytest.mark.parametrize(
    "name, kind", [("a.pcap", ".pcap"), ("a.mcap.zstd", ".zstd"), ("log", "nameless")]
)
def test_an_unknown_suffix_is_refused_with_what_is_read_and_how_to_convert(tmp_path, name, kind):
    (tmp_path / name).write_bytes(b"x")
    message = refusal(tmp_path / name)
    assert f"{name}: a {kind} file, this version reads " in message
    assert ".mcap" in message and "ros2 bag convert" in message


def test_an_empty_folder_is_refused(tmp_path):
    assert "no log in this folder; expected " in refusal(tmp_path)


@pytest.mark.parametrize("content", [b"", b"hello world" * 20], ids=["empty", "garbage"])
def test_a_file_that_is_no_mcap_is_refused_with_a_way_to_look_at_it(tmp_path, content):
    (tmp_path / "a.mcap").write_bytes(content)
    message = refusal(tmp_path / "a.mcap")
    assert "a.mcap: not a readable MCAP file (" in message and "run `mcap doctor a.mcap`" in message


@pytest.mark.parametrize("share", [0.005, 0.3, 0.9, 0.999])
def test_a_file_cut_short_is_refused_with_the_way_to_recover_it(tmp_path, share):
    path = write(tmp_path / "a.mcap", alternating(0, 200))
    path.write_bytes(path.read_bytes()[: round(share * path.stat().st_size)])
    message = refusal(path)
    assert (
        "a.mcap: has no index, as when the recorder was stopped hard; run `mcap recover" in message
    )


def test_a_file_without_statistics_is_refused_with_the_way_to_recover_it(tmp_path):
    path = write(tmp_path / "a.mcap", alternating(0, 20), use_statistics=False)
    assert "has no index" in refusal(path)


@pytest.mark.parametrize(
    "compression", [CompressionType.ZSTD, CompressionType.LZ4], ids=["zstd", "lz4"]
)
def test_damage_within_a_file_is_refused_when_it_is_met(tmp_path, compression):
    path = write(
        tmp_path / "a.mcap", alternating(0, 2000), compression=compression, chunk_size=9**6
    )
    data = bytearray(path.read_bytes())
    data[len(data) // 4 : len(data) // 2] = bytes(len(data) // 2 - len(data) // 4)
    path.write_bytes(data)
    assert "a.mcap: not a readable MCAP file (" in refusal(path)


# --- whether a log is still the same


def test_touching_or_copying_a_log_keeps_its_fingerprint(tmp_path):
    path = write(tmp_path / "a.mcap", alternating(0, 20))
    before = logs.fingerprint(str(path))
    os.utime(path, (0, time.time() + 1000))
    assert logs.fingerprint(str(path)) == before
    (tmp_path / "other").mkdir()
    copy = shutil.copy(path, tmp_path / "other" / "a.mcap")
    assert logs.fingerprint(str(copy)) == before
    logs.require_same(str(copy), before)


@pytest.mark.parametrize("size", [100, (1 << 20) + 10, (3 << 20)])
@pytest.mark.parametrize("where", ["first byte", "last byte", "length", "name"])
def test_a_changed_log_has_another_fingerprint(tmp_path, size, where):
    path = tmp_path / "a.mcap"
    content = bytearray(np.random.default_rng(0).bytes(size))
    path.write_bytes(content)
    before = logs.fingerprint(str(path))
    if where == "first byte":
        content[0] ^= 1
    elif where == "last byte":
        content[-1] ^= 1
    elif where == "length":
        content[size // 2 : size // 2] = b"x"
    else:
        path = path.rename(tmp_path / "b.mcap")
    path.write_bytes(content)
    assert logs.fingerprint(str(path)) != before


def test_a_log_of_many_files_has_one_line_for_each(tmp_path):
    paths = [write(tmp_path / f"{n}.mcap", alternating(10 * i, 10)) for i, n in enumerate("abc")]
    lines = logs.fingerprint([str(p) for p in paths])
    assert [line.split()[0] for line in lines] == ["a.mcap", "b.mcap", "c.mcap"]
    assert [int(line.split()[1]) for line in lines] == [p.stat().st_size for p in paths]


def test_a_log_that_changed_since_it_was_decoded_is_refused_with_the_remedy(tmp_path):
    path = write(tmp_path / "a.mcap", alternating(0, 20))
    before = logs.fingerprint(str(path))
    write(path, alternating(0, 21))
    with pytest.raises(InputError) as caught:
        logs.require_same(str(path), before)
    assert "a.mcap: changed since it was decoded; run snakemake again" in str(caught.value)


# --- recorded logs of others


def test_a_split_rosbag2_of_ros_itself_is_read_whole_and_in_order():
    log = logs.open_log(str(shared_data("logs/rosbag2_split")))
    times = [m.log_t for m in log.messages(log.topics)]
    assert len(log.files) == 5
    assert len(times) == sum(n for _, n in log.topics.values()) > 0
    assert times == sorted(times)


def test_a_rosbag2_with_service_events_lists_them_and_reads_its_topics():
    log = logs.open_log(str(shared_data("logs/rosbag2_services")))
    readable = [topic for topic, (kind, n) in log.topics.items() if n and "/msg/" in kind]
    assert any("_service_event" in topic for topic in log.topics)
    plain = [t for t in readable if "_service_event" not in t]
    assert all(m.content is not None for m in log.messages(plain))
