"""Cases of files whose definitions, indexes, schemas and headers say what is not true.

A case: (folder, generator) -> warnings, "" if there are none; errors are not caught here.
"""

import json
import sqlite3
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Chunk, Schema

from benchmarking.fuzzing.crafted_mcap import CraftedMcap, make_chunk
from benchmarking.fuzzing.hostile_messages import HOSTILE_NUMBERS
from benchmarking.fuzzing.log_cases import decode_and_reread
from benchmarking.fuzzing.small_recordings import (
    FUZZ_START_NS,
    fuzz_decode_options,
    make_fuzz_messages,
    write_fuzz_log,
)
from calib.export.accepted_calibrations import read_accepted_calibrations
from calib.io.logs.ros_messages import CLOUD_TYPE, TF_TYPE
from calib.report.page.rigs_page import format_pose_drift
from calib.targets.point_template import read_template_file

LENGTHS = (0, 1, 2, 9, 1000, 65_536, 2**31 - 1, 2**32, -1)
BASE_TYPES = ("bool", "uint8", "int64", "float32", "float64", "string", "time", "Header")
IDL_TYPES = ("octet", "long", "double", "string", "sequence<double>", "sequence<string<9>>")
OPERATORS = ("+", "-", "*", "/", "%", "<<", ">>", "|", "^", "&")
CRAFTED_TYPES = {"/points": CLOUD_TYPE, "/tf": TF_TYPE}
IDENTITY = np.eye(4).tolist()
SENSOR_BLOCK: dict[str, Any] = {
    "T_robot_sensor": {"xyz_m": [0, 0, 0], "quat_xyzw": [0, 0, 0, 1], "matrix": IDENTITY},
    "covariance": np.eye(6).tolist(),
}
POSE_KEYS = ("xyz_m", "quat_xyzw", "matrix")
WRONG_VALUES: tuple[Any, ...] = (
    None,
    [],
    {},
    "x",
    [1, 2],
    [[1], [2, 3]],
    [None] * 3,
    True,
    float("nan"),
)


def _pick(rng: np.random.Generator, values: Any) -> Any:
    return values[int(rng.integers(len(values)))]


def _draw_msg_definition(rng: np.random.Generator) -> str:
    """Return types that hold each other in arrays and lists of any length."""
    n_types, texts = int(_pick(rng, (1, 2, 5, 40, 300))), []
    n_fields = int(_pick(rng, (0, 1, 2, 3, 200 if n_types < 10 else 3, 5000 // n_types)))
    for n in range(n_types):
        lines = []
        for k in range(n_fields):
            inner = f"own_msgs/T{n + 1}" if n + 1 < n_types and rng.random() < 0.7 else ""
            kind = inner or _pick(rng, BASE_TYPES)
            length = _pick(rng, LENGTHS)
            kind += _pick(rng, ("", "", "[]", f"[{length}]", f"[<={length}]"))
            lines.append(f"{kind} f{k}{_pick(rng, ('', '', '', ' 1', ' [1, 2]'))}\n")
        texts.append(("" if n == 0 else f"{'=' * 80}\nMSG: own_msgs/T{n}\n") + "".join(lines))
    return "".join(texts)


def _draw_expression(rng: np.random.Generator, depth: int) -> str:
    if depth == 0:
        return str(_pick(rng, (0, 1, 7, 10**9, 10**18, "A", "1.5", "TRUE", '"x"')))
    left, right = (_draw_expression(rng, depth - 1) for _ in range(2))
    return _pick(rng, (f"({left} {_pick(rng, OPERATORS)} {right})", f"-{left}", f"(({left}))"))


def _draw_idl_definition(rng: np.random.Generator, name: str) -> str:
    """Return an IDL struct with constants of expressions, and members of any size."""
    package, _, short = name.split("/")
    n = int(_pick(rng, (0, 1, 3, 40, 3000)))
    depth = int(_pick(rng, (0, 1, 2, 6)))
    constants = "".join(
        f"const long C{k} = {_draw_expression(rng, depth if n < 100 else 0)};" for k in range(n)
    )
    members = "".join(
        f"{_pick(rng, IDL_TYPES)} m{k}{_pick(rng, ('', f'[{_pick(rng, LENGTHS)}]'))};"
        for k in range(int(_pick(rng, (1, 3, 50, 3000))))
    )
    return (
        f"module {package} {{ module msg {{ module {short}_Constants {{ const long A = 5; "
        f"{constants} }}; struct {short} {{ {members} }}; }}; }};"
    )


def run_hostile_definition(folder: Path, rng: np.random.Generator) -> str:
    """Decode a log whose messages are defined as a stranger likes."""
    topic = _pick(rng, list(CRAFTED_TYPES))
    name = CRAFTED_TYPES[topic]
    form = _pick(rng, ("ros2msg", "ros2idl", "ros1msg"))
    text = _draw_idl_definition(rng, name) if form == "ros2idl" else _draw_msg_definition(rng)
    data = b"\0\1\0\0" + rng.bytes(int(_pick(rng, (0, 8, 300, 5000))))
    data = _pick(rng, (data, data[:4] + bytes(len(data) - 4)))
    schema = Schema(id=1, name=name, encoding=form, data=text.encode())
    times = [FUZZ_START_NS + n for n in range(4)]
    path = CraftedMcap(topic, schema, [make_chunk(times, data)]).write(folder / "a.mcap")
    return decode_and_reread(folder, str(path), fuzz_decode_options(("lidar",)))


def _draw_chunk(rng: np.random.Generator) -> Chunk:
    n = int(_pick(rng, (1, 3, 100, 200_000)))
    start = FUZZ_START_NS + int(rng.integers(0, 10**9)) * int(rng.integers(0, 2))
    step = int(_pick(rng, (0, 1, 10**6))) if n < 1000 else 0
    size = int(_pick(rng, (0, 4, 90, 5000 if n < 1000 else 0)))
    return make_chunk([start + step * k for k in range(n)], b"\0\1\0\0"[:size] + bytes(size))


def _change_fields(rng: np.random.Generator, record: Any, names: tuple[str, ...]) -> Any:
    """Return a record with hostile numbers in some of its fields."""
    numbers = [n for n in HOSTILE_NUMBERS["int"] if n >= 0] + [2**62, 100, FUZZ_START_NS]
    return replace(record, **{n: _pick(rng, numbers) for n in names if rng.random() < 0.3})


def run_hostile_chunks(folder: Path, rng: np.random.Generator) -> str:
    """Decode a log whose chunks and index lie, overlap, or stand again and again."""
    times = ("message_start_time", "message_end_time", "uncompressed_size")
    chunks = [_draw_chunk(rng) for _ in range(int(_pick(rng, (1, 2, 6))))]
    chunks *= int(_pick(rng, (1, 1, 1, 300)))
    if rng.random() < 0.3:
        chunks = [_change_fields(rng, chunk, times) for chunk in chunks]
    schema = Schema(id=1, name=TF_TYPE, encoding="", data=b"")
    file = CraftedMcap("/tf", schema, chunks)
    if rng.random() < 0.5:
        names = (*times, "chunk_start_offset", "chunk_length")
        file.chunk_indexes = [_change_fields(rng, index, names) for index in file.chunk_indexes]
    if rng.random() < 0.3:
        file.chunk_indexes = (file.chunk_indexes * int(_pick(rng, (2, 2000))))[:4000]
    path = file.write(folder / "a.mcap")
    if rng.random() < 0.3:
        path.write_bytes(path.read_bytes()[:-40])
    return decode_and_reread(folder, str(path), fuzz_decode_options(("lidar",)))


ENDLESS = "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) SELECT"
SQL_DAMAGES = (
    "DROP TABLE {table}",
    "ALTER TABLE {table} RENAME TO other; CREATE VIEW {table} AS SELECT * FROM other",
    "DROP TABLE {table}; CREATE VIEW {table} AS " + ENDLESS + " n AS id, n AS topic_id FROM r",
    "ALTER TABLE {table} ADD COLUMN big AS (zeroblob(900000000))",
    "ALTER TABLE {table} RENAME COLUMN id TO number",
    "INSERT INTO {table} SELECT * FROM {table}",
    "UPDATE {table} SET id = NULL",
    "UPDATE topics SET name = zeroblob(9999999)",
    "UPDATE topics SET offered_qos_profiles = '" + "[" * 5000 + "'",
    "UPDATE topics SET type = 7, serialization_format = NULL",
    "UPDATE messages SET timestamp = 9223372036854775807",
    "UPDATE messages SET timestamp = 'soon'",
    "UPDATE messages SET data = 5",
    "UPDATE messages SET topic_id = topic_id + 1",
    "UPDATE schema SET schema_version = -99",
    "DROP INDEX timestamp_idx",
    "CREATE TRIGGER t AFTER INSERT ON {table} BEGIN DELETE FROM messages; END",
    "UPDATE sqlite_master SET sql = replace(sql, 'BLOB', 'AS (zeroblob(2000000000))')",
    "UPDATE sqlite_master SET rootpage = 2 WHERE name = '{table}'",
)


def run_hostile_schema(folder: Path, rng: np.random.Generator) -> str:
    """Decode an SQLite log with a damaged or computed schema."""
    path = write_fuzz_log("sqlite", folder / "log", make_fuzz_messages(("camera", "lidar")))
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA writable_schema = 1")
    for _ in range(int(rng.integers(1, 3))):
        table = _pick(rng, ("messages", "topics", "schema", "message_definitions", "metadata"))
        try:
            connection.executescript(_pick(rng, SQL_DAMAGES).format(table=table))
        except sqlite3.Error:
            continue  # this damage does not fit to the one before
    connection.commit()
    connection.close()
    return decode_and_reread(folder, str(path), fuzz_decode_options(("camera", "lidar")))


def run_hostile_template(folder: Path, rng: np.random.Generator) -> str:
    """Read a template file with a random header."""
    kind, count = (
        _pick(rng, (".pcd", ".ply")),
        _pick(rng, (9, 9, 9, 9, 9, 0, 5, 10**6, 2**31, 2**40, -3)),
    )
    points = rng.normal(size=(9, 3)).astype(np.float32)
    text = "".join(" ".join(map(str, p)) + "\n" for p in points.tolist()).encode()
    body = _pick(rng, (text, points.tobytes(), b"", rng.bytes(30)))
    if kind == ".pcd":
        size = _pick(rng, ("4 4 4", "4 4 4", "8 8 8", "4 4", "4 4 99999999", "x"))
        head = (
            f"VERSION .7\nFIELDS x y z\nSIZE {size}\nTYPE F F {_pick(rng, 'FFUI')}\nCOUNT 1 1 "
            f"{_pick(rng, (1, 1, 0, 10**9))}\nWIDTH {count}\nHEIGHT {_pick(rng, (1, 1, 10**6))}\n"
            f"POINTS {count}\nDATA {_pick(rng, ('ascii', 'binary', 'binary_compressed', 'x'))}\n"
        )
    else:
        form = _pick(rng, ("ascii", "binary_little_endian", "binary_big_endian", "x"))
        faces = f"element face {_pick(rng, LENGTHS)}\nproperty list uchar int vertex_indices\n"
        number = _pick(rng, ("float", "float", "double", "list uchar float", "x"))
        head = (
            f"ply\nformat {form} 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n"
            f"property {number} z\n{_pick(rng, ('', faces))}end_header\n"
        )
    path = folder / f"template{kind}"
    path.write_bytes(head.encode() + body)
    read_template_file(path)
    return ""


def run_hostile_history(folder: Path, rng: np.random.Generator) -> str:
    """Read a history with wrong shapes, and compare a pose with its last entry as the page does."""
    sensor = json.loads(json.dumps(SENSOR_BLOCK))
    for _ in range(int(rng.integers(0, 3))):
        block, key = (sensor, _pick(rng, list(SENSOR_BLOCK)))
        if rng.random() < 0.6 and isinstance(sensor["T_robot_sensor"], dict):
            block, key = sensor["T_robot_sensor"], _pick(rng, POSE_KEYS)
        block[key] = _pick(rng, WRONG_VALUES)
    calibration = _pick(rng, ({"sensors": {"left": sensor}},) * 5 + ({"sensors": []}, [], None))
    previous = _pick(rng, (None, None, None, "0001", 7))
    content = json.dumps({"previous": previous, "calibration": calibration})
    (folder / "0001.json").write_text(_pick(rng, (content,) * 8 + ("[" * 99_999, content[:-9])))
    history = read_accepted_calibrations(folder)
    for entry in history:
        format_pose_drift(SENSOR_BLOCK, entry.calibration["sensors"].get("left"))
    return ""
