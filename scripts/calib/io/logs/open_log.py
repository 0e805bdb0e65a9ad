"""Logs: what holds the messages of a recording.

A format is one module with a function of paths that gives an object with
  files                       the paths it is made of, in order;
  topics                      {name: (type, count)};
  start                       log time of the first message, ns;
  faults                      what could not be read, in words, as far as was met up to now;
  messages(topics, start, end)   Message after Message of those topics, in the order of log time;
  message(topic, file, log_t, ordinal)   one message again, found through the index.

To add a format: write calib/io/logs/<name>.py and add it to FORMATS by suffix, with a function that
imports it: a start of Snakemake, which needs no reader, should not pay for all of them.
"""

import hashlib
from pathlib import Path

from calib.io import safe_yaml
from calib.io.logs import decompression
from calib.io.status import InputError

MIB = 1 << 20


def _mcap(files):
    from calib.io.logs.mcap_log import McapLog

    return McapLog(files)


def _db3(files):
    from calib.io.logs.rosbag2_sqlite import open_db3

    return open_db3(files)


def _bag(files):
    from calib.io.logs.rosbag1 import open_bag

    return open_bag(files)


FORMATS = {".mcap": _mcap, ".db3": _db3, ".bag": _bag}


def files_of(log):
    """The files (paths) of a config's `log`: one file, a rosbag2 folder, or a list of files.

    Raises InputError when there is none, or one that no format reads.
    """
    paths = [Path(p) for p in ([log] if isinstance(log, str) else log)]
    if len(paths) == 1 and paths[0].is_dir():
        paths = _in_folder(paths[0])
    for path in paths:
        if not path.is_file():
            raise InputError(
                f"{path}: no such log; check sessions.<name>.log in config/config.yaml"
            )
        if _format(path) not in FORMATS:
            raise InputError(
                f"{path}: a {_format(path) or 'nameless'} file, this version reads "
                f"{', '.join(sorted(FORMATS))}; run `ros2 bag convert` or `mcap convert`"
            )
    return paths


def _format(path):
    """The suffix of a path, without that of a compression of the whole file."""
    return Path(path.stem).suffix if path.suffix in decompression.SUFFIXES else path.suffix


def _in_folder(folder):
    metadata = folder / "metadata.yaml"
    if metadata.is_file():
        return [_named(folder, name) for name in _listed(metadata)]
    found = sorted(p for p in folder.iterdir() if _format(p) in FORMATS)
    if not found:
        raise InputError(f"{folder}: no log in this folder; expected {', '.join(sorted(FORMATS))}")
    return found


def _listed(metadata):
    """The names of files in a rosbag2's metadata.yaml."""
    try:
        info = safe_yaml.load(metadata)["rosbag2_bagfile_information"]
        return [Path(name).name for name in info["relative_file_paths"]]
    except (InputError, KeyError, TypeError):
        raise InputError(
            f"{metadata}: names no files of a rosbag2 log; run `ros2 bag reindex {metadata.parent}`"
        ) from None


def _named(folder, name):
    """The file of a name in metadata.yaml."""
    path = folder / name
    if not path.is_file():
        raise InputError(
            f"{path}: no such log, though {folder / 'metadata.yaml'} names it; copy it there, or "
            "write the list of the files that are there at sessions.<name>.log"
        )
    return path


def open_log(log):
    """The log of a config's `log`, of the format that its suffix names."""
    files = files_of(log)
    formats = sorted({_format(p) for p in files})
    if len(formats) != 1:
        named = f"files of {' and '.join(formats)}" if formats else "no file at all"
        raise InputError(
            f"{log}: a log of {named}; expected one or more of one format: convert the others with "
            "`rosbags-convert`"
        )
    plain, folder = decompression.files(files)
    opened = FORMATS[formats[0]](plain)
    opened.unpacked_in = folder  # removed with the log
    return opened


def fingerprint(log):
    """One line per file: name, size, SHA-256 of its first and last MiB; no path, no date."""
    lines = []
    for path in files_of(log):
        size = path.stat().st_size
        with path.open("rb") as stream:
            digest = hashlib.sha256(stream.read(MIB))
            stream.seek(max(0, size - MIB))
            digest.update(stream.read(MIB))
        lines.append(f"{path.name} {size} {digest.hexdigest()}")
    return lines


def require_same(log, expected):
    """Raise InputError unless the log still has the fingerprint that decode saw."""
    if fingerprint(log) != expected:
        raise InputError(
            f"{log}: changed since it was decoded; run snakemake again so that decode runs first"
        )
