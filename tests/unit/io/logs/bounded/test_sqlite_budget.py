"""SQLite files of a stranger: what is computed is refused, and work and rows are bounded."""

import sqlite3
import time

import pytest

from calib.io.logs.open_log import open_log
from calib.io.status import InputError
from helpers.log_containers import SQLITE_PLUGIN, make_container_rows, write_rosbag2

FOREVER = "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) SELECT"


@pytest.fixture
def bag(tmp_path):
    return (
        write_rosbag2(tmp_path / "bag", make_container_rows("TFMessage"), SQLITE_PLUGIN) / "bag.db3"
    )


def change(path, *statements):
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA writable_schema = 1")
    for statement in statements:
        connection.execute(statement)
    connection.commit()
    connection.close()


def refusal(path):
    begin = time.process_time()
    with pytest.raises(InputError) as caught:
        log = open_log(str(path))
        assert list(log.iter_messages(log.topics))
    assert time.process_time() - begin < 4
    return str(caught.value)


COMPUTED = {
    "definitions without end": [
        "DROP TABLE message_definitions",
        "CREATE VIEW message_definitions AS " + FOREVER + " n AS id, 'a/msg/B' AS topic_type, "
        "'ros2msg' AS encoding, 'int8 x' AS encoded_message_definition, '' AS "
        "type_description_hash FROM r",
    ],
    "a schema without end": ["DROP TABLE schema", f"CREATE VIEW schema AS {FOREVER} -n AS "
                             "schema_version FROM r"],
    "large computed data": [
        "ALTER TABLE messages RENAME TO m",
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data BLOB AS (zeroblob(900000000)))",
        "INSERT INTO messages(topic_id, timestamp) SELECT topic_id, timestamp FROM m",
    ],
    "a virtual table": [
        "ALTER TABLE topics RENAME TO t",
        "CREATE VIRTUAL TABLE topics USING fts5(name, type, serialization_format, "
        "offered_qos_profiles, type_description_hash)",
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", COMPUTED)
def test_tables_that_are_computed_are_refused_at_once(bag, name):
    change(bag, *COMPUTED[name])
    assert "bag.db3: cannot be read (TooLargeError: " in refusal(bag)
    assert "computed, expected " in refusal(bag)


def test_many_topics_and_long_profiles_are_refused(bag):
    row = "'tf2_msgs/msg/TFMessage', 'cdr', {}, ''"
    insert = "INSERT INTO topics SELECT n, 't' || n, {} FROM (" + FOREVER + " n FROM r LIMIT {})"
    change(bag, "DELETE FROM topics", insert.format(row.format("''"), 9000))
    assert "4097 rows of topics, expected at most 4096" in refusal(bag)
    change(bag, "DELETE FROM topics", insert.format(row.format("hex(zeroblob(9000))"), 50))
    assert "bytes of topics, expected at most 262144" in refusal(bag)


def test_a_value_larger_than_the_file_is_refused(bag):
    """An expression in an index is computed while the rows are read."""
    change(
        bag,
        "UPDATE sqlite_master SET sql = 'CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id "
        "INTEGER, timestamp INTEGER, data BLOB AS (zeroblob(2000000000)) VIRTUAL)' "
        "WHERE name = 'messages'",
    )
    assert "a column of messages is computed" in refusal(bag)


def test_a_plain_file_is_read_as_before(bag):
    log = open_log(str(bag))
    assert len(list(log.iter_messages(log.topics))) == 34 and log.read_errors == []
