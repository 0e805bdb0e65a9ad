"""Logs in SQLite files of rosbag2; a file without type definitions may hold types of ROS only."""

from pathlib import Path

from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2 import Reader

from calib.io.logs.bounded.sqlite_budget import bounded_sqlite, require_plain_tables
from calib.io.logs.rosbags_reader import RosbagsLog, open_readers

SQLITE_REMEDY = "Run `sqlite3 {} .recover | sqlite3 whole.db3` and use whole.db3."


class BoundedSqliteReader(Reader):
    """A reader of plain tables only, whose work is bounded by the size of the file."""

    def open(self) -> None:
        """Check the tables and open the file."""
        path = Path(str(self.path))
        with bounded_sqlite(path):
            require_plain_tables(path)
            super().open()


def open_rosbag2_sqlite(files: list[Path]) -> RosbagsLog:
    """Return the log in SQLite files."""
    log = RosbagsLog(open_readers(files, BoundedSqliteReader, SQLITE_REMEDY), _find_serialisation)
    log.read_errors += [_journal_warning(p) for p in log.files if _journal_path(p).exists()]
    return log


def _find_serialisation(connection: Connection) -> str:
    assert isinstance(connection.ext, ConnectionExtRosbag2)
    return connection.ext.serialization_format


def _journal_path(path: Path) -> Path:
    return path.with_name(path.name + "-wal")


def _journal_warning(path: Path) -> str:
    return (
        f"{path.name}: its last messages may be in {_journal_path(path).name}, which is not read. "
        f"Run `sqlite3 {path.name} 'pragma wal_checkpoint'` in its folder."
    )
