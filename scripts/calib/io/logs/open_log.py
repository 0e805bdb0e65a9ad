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

from calib.io.logs.decompression import COMPRESSED_SUFFIXES, decompress_files
from calib.io.safe_yaml import load_yaml
from calib.io.status import InputError

FINGERPRINT_BYTES = 1 << 20


def _open_mcap(files):
    from calib.io.logs.mcap_log import McapLog

    return McapLog(files)


def _open_db3(files):
    from calib.io.logs.rosbag2_sqlite import open_rosbag2_sqlite

    return open_rosbag2_sqlite(files)


def _open_bag(files):
    from calib.io.logs.rosbag1 import open_rosbag1

    return open_rosbag1(files)


LOG_OPENERS = {".mcap": _open_mcap, ".db3": _open_db3, ".bag": _open_bag}


def find_log_files(log_config):
    """The files (paths) of a config's `log`: one file, a rosbag2 folder, or a list of files.

    Raises InputError when there is none, or one that no format reads.
    """
    paths = [Path(p) for p in ([log_config] if isinstance(log_config, str) else log_config)]
    if len(paths) == 1 and paths[0].is_dir():
        paths = _find_files_in_folder(paths[0])
    for path in paths:
        if not path.is_file():
            raise InputError(
                f"{path}: no such log; check sessions.<name>.log in config/config.yaml"
            )
        if _log_suffix(path) not in LOG_OPENERS:
            raise InputError(
                f"{path}: a {_log_suffix(path) or 'nameless'} file, this version reads "
                f"{', '.join(sorted(LOG_OPENERS))}; run `ros2 bag convert` or `mcap convert`"
            )
    return paths


def _log_suffix(path):
    """The suffix of a path, without that of a compression of the whole file."""
    return Path(path.stem).suffix if path.suffix in COMPRESSED_SUFFIXES else path.suffix


def _find_files_in_folder(folder):
    metadata = folder / "metadata.yaml"
    if metadata.is_file():
        return [_require_metadata_file(folder, name) for name in _read_metadata_names(metadata)]
    found = sorted(p for p in folder.iterdir() if _log_suffix(p) in LOG_OPENERS)
    if not found:
        raise InputError(
            f"{folder}: no log in this folder; expected {', '.join(sorted(LOG_OPENERS))}"
        )
    return found


def _read_metadata_names(metadata):
    """The names of files in a rosbag2's metadata.yaml."""
    try:
        info = load_yaml(metadata)["rosbag2_bagfile_information"]
        return [Path(name).name for name in info["relative_file_paths"]]
    except (InputError, KeyError, TypeError):
        raise InputError(
            f"{metadata}: names no files of a rosbag2 log; run `ros2 bag reindex {metadata.parent}`"
        ) from None


def _require_metadata_file(folder, name):
    """The file of a name in metadata.yaml."""
    path = folder / name
    if not path.is_file():
        raise InputError(
            f"{path}: no such log, though {folder / 'metadata.yaml'} names it; copy it there, or "
            "write the list of the files that are there at sessions.<name>.log"
        )
    return path


def open_log(log_config):
    """The log of a config's `log`, of the format that its suffix names."""
    files = find_log_files(log_config)
    formats = sorted({_log_suffix(p) for p in files})
    if len(formats) != 1:
        named = f"files of {' and '.join(formats)}" if formats else "no file at all"
        raise InputError(
            f"{log_config}: a log of {named}; expected one or more of one format: convert the others with "
            "`rosbags-convert`"
        )
    plain, folder = decompress_files(files)
    opened = LOG_OPENERS[formats[0]](plain)
    opened.unpacked_in = folder  # removed with the log
    return opened


def fingerprint_log(log_config):
    """One line per file: name, size, SHA-256 of its first and last MiB; no path, no date."""
    lines = []
    for path in find_log_files(log_config):
        size = path.stat().st_size
        with path.open("rb") as stream:
            digest = hashlib.sha256(stream.read(FINGERPRINT_BYTES))
            stream.seek(max(0, size - FINGERPRINT_BYTES))
            digest.update(stream.read(FINGERPRINT_BYTES))
        lines.append(f"{path.name} {size} {digest.hexdigest()}")
    return lines


def require_same_log(log_config, expected_fingerprint):
    """Raise InputError unless the log still has the fingerprint that decode saw."""
    if fingerprint_log(log_config) != expected_fingerprint:
        raise InputError(
            f"{log_config}: changed since it was decoded; run snakemake again so that decode runs first"
        )
