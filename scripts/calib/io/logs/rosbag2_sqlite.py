"""SQLite files of rosbag2; without definitions in them, of types that ROS ships."""

from rosbags.rosbag2 import Reader

from calib.io.logs.rosbags_reader import RosbagsLog, opened

REMEDY = "run `sqlite3 {} .recover | sqlite3 whole.db3` and use its output"


def open_db3(files):
    """The RosbagsLog of SQLite files."""
    log = RosbagsLog(opened(files, Reader, REMEDY), lambda c: c.ext.serialization_format)
    log.faults += [_left_out(p) for p in log.files if _journal(p).exists()]
    return log


def _journal(path):
    return path.with_name(path.name + "-wal")


def _left_out(path):
    return (
        f"{path.name}: {_journal(path).name} beside it may hold its last messages, which were left "
        f"out; run `sqlite3 {path.name} 'pragma wal_checkpoint'` in its folder"
    )
