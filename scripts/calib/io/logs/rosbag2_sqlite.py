"""SQLite files of rosbag2; without definitions in them, of types that ROS ships."""

from rosbags.rosbag2 import Reader

from calib.io.logs.rosbags_reader import RosbagsLog, open_readers

SQLITE_REMEDY = "run `sqlite3 {} .recover | sqlite3 whole.db3` and use its output"


def open_rosbag2_sqlite(files):
    """The RosbagsLog of SQLite files."""
    log = RosbagsLog(
        open_readers(files, Reader, SQLITE_REMEDY), lambda c: c.ext.serialization_format
    )
    log.read_errors += [_journal_warning(p) for p in log.files if _journal_path(p).exists()]
    return log


def _journal_path(path):
    return path.with_name(path.name + "-wal")


def _journal_warning(path):
    return (
        f"{path.name}: {_journal_path(path).name} beside it may hold its last messages, which were left "
        f"out; run `sqlite3 {path.name} 'pragma wal_checkpoint'` in its folder"
    )
