"""Bounds of an SQLite file: plain tables only, rows no larger than the file, and limited work.

A file of a few kB can hold views and computed columns that yield any number of rows of any size.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import apsw

from calib.io.logs.bounded.decompression import TooLargeError
from calib.io.logs.bounded.definition_budget import require_bounded_count

READ_TABLES = ("messages", "topics", "schema", "message_definitions", "metadata")
MAX_ROWS = 4096  # of topics, and of message definitions
MAX_TEXT_BYTES = {"topics": 1 << 18, "message_definitions": 1 << 25}  # of all rows together
MIN_LENGTH_LIMIT = 1 << 16  # of a row, bytes; SQLite's own statements must fit, too
STEPS_PER_BYTE, FREE_STEPS = 200, 50_000_000  # of SQLite's machine; these take about a second
STEPS_PER_CHECK = 100_000


@contextmanager
def bounded_sqlite(path: Path) -> Iterator[None]:
    """Bound what connections that are opened in the block may do, as long as they exist."""
    n_bytes = path.stat().st_size

    def bound(connection: apsw.Connection) -> None:
        connection.limit(apsw.SQLITE_LIMIT_LENGTH, max(n_bytes, MIN_LENGTH_LIMIT))
        connection.set_progress_handler(_StepBudget(n_bytes).spend, STEPS_PER_CHECK)

    apsw.connection_hooks.append(bound)
    try:
        yield
    finally:
        apsw.connection_hooks.remove(bound)


class _StepBudget:
    """Steps of SQLite's machine that one connection may still take."""

    def __init__(self, n_bytes: int) -> None:
        self.n_bytes = n_bytes
        self.n_left = FREE_STEPS + STEPS_PER_BYTE * n_bytes

    def spend(self) -> bool:
        """Take away the steps since the last call; raises TooLargeError if none are left."""
        self.n_left -= STEPS_PER_CHECK
        if self.n_left < 0:
            raise TooLargeError(f"more work than a file of {self.n_bytes} bytes can need")
        return False


def require_plain_tables(path: Path) -> None:
    """Raise an error of apsw, or TooLargeError, unless the tables that are read are plain ones."""
    connection = apsw.Connection(
        f"file:{path}?immutable=1", flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
    )
    try:
        for name in READ_TABLES:
            _require_plain_table(connection, name)
        for name, max_bytes in MAX_TEXT_BYTES.items():
            _require_bounded_table(connection, name, max_bytes)
    finally:
        connection.close()


def _require_plain_table(connection: apsw.Connection, name: str) -> None:
    query = "SELECT type, sql FROM sqlite_master WHERE lower(name) = ? AND type != 'index'"
    for kind, sql in connection.execute(query, (name,)):
        words = str(sql).upper().split()
        if kind != "table" or words[:2] != ["CREATE", "TABLE"]:
            raise TooLargeError(f"{name} is computed, expected a plain table")
    hidden = connection.execute(f"SELECT max(hidden) FROM pragma_table_xinfo('{name}')")
    if (hidden.fetchone() or (0,))[0]:
        raise TooLargeError(f"a column of {name} is computed, expected stored values")


def _require_bounded_table(connection: apsw.Connection, name: str, max_bytes: int) -> None:
    """Raise TooLargeError if a table that exists has too many rows, or too long ones."""
    columns = [c for (c,) in connection.execute(f"SELECT name FROM pragma_table_info('{name}')")]
    if not columns:
        return
    lengths = " + ".join(
        f'coalesce(length("{c.replace(chr(34), chr(34) * 2)}"), 0)' for c in columns
    )
    query = f"SELECT {lengths} FROM {name} LIMIT {MAX_ROWS + 1}"
    sizes = [int(size) for (size,) in connection.execute(query)]
    require_bounded_count(len(sizes), MAX_ROWS, f"rows of {name}")
    require_bounded_count(sum(sizes), max_bytes, f"bytes of {name}")
