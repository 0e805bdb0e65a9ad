"""Registry of log containers: opens a log by the suffix of its files.

To add a container: write calib/io/logs/<name>.py with a class that follows RecordedLog, and add it
to LOG_OPENERS with a function that imports it. Imports are inside the functions because Snakemake
itself imports this module and needs no reader.
"""

import glob
import hashlib
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Protocol

from calib.io.logs.bounded.decompression import COMPRESSED_SUFFIXES, decompress_files
from calib.io.safe_names import NameGate, plain_path
from calib.io.safe_yaml import load_yaml
from calib.io.status import InputError

if TYPE_CHECKING:  # these modules import rosbags
    from calib.io.logs.log_message import LogMessage, TopicInfo

FINGERPRINT_BYTES = 1 << 20
WILDCARD_NAME = re.compile(r"\{[^{}]*\}")  # of Snakemake, in the path of an input


class RecordedLog(Protocol):
    """A recording, whatever its container.

    files: its files, in order; topics: by name; start_ns: log time of the first message;
    names: the gate that its names passed; read_errors: what could not be read up to now;
    temporary_folder: of decompressed files.
    """

    files: list[Path]
    topics: dict[str, "TopicInfo"]
    names: NameGate
    start_ns: int
    temporary_folder: TemporaryDirectory[str] | None

    @property
    def read_errors(self) -> list[str]:
        """Return what could not be read up to now."""

    def iter_messages(
        self, topics: Iterable[str], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator["LogMessage"]:
        """Yield the messages of the topics with start_ns <= log time < end_ns, by log time."""

    def read_message_content(
        self, topic: str, file_index: int, log_time_ns: int, index_at_log_time: int
    ) -> Any:
        """Return the content of one message, found by its place in the log."""


def _open_mcap(files: list[Path]) -> RecordedLog:
    from calib.io.logs.mcap_log import McapLog

    return McapLog(files)


def _open_db3(files: list[Path]) -> RecordedLog:
    from calib.io.logs.rosbag2_sqlite import open_rosbag2_sqlite

    return open_rosbag2_sqlite(files)


def _open_bag(files: list[Path]) -> RecordedLog:
    from calib.io.logs.rosbag1 import open_rosbag1

    return open_rosbag1(files)


LOG_OPENERS: dict[str, Callable[[list[Path]], RecordedLog]] = {
    ".mcap": _open_mcap,
    ".db3": _open_db3,
    ".bag": _open_bag,
}


def find_log_files(log_config: str | list[str]) -> list[Path]:
    """Return the files of a config's `log`: one file, a rosbag2 folder, or a list of files.

    `~` is the home folder; `*`, `?` and `[]` stand for the files that match, in order of their
    names. Raises InputError if there is none, or one of an unknown format.
    """
    names = [log_config] if isinstance(log_config, str) else log_config
    paths = [path for name in names for path in _expand_name(name)]
    if len(paths) == 1 and paths[0].is_dir():
        paths = _find_files_in_folder(paths[0])
    for path in paths:
        _require_plain_path(path)
        if WILDCARD_NAME.search(str(path)):
            raise InputError(
                f"{path}: Snakemake reads names in braces as wildcards. Rename the file or folder "
                "without braces."
            )
        if not path.is_file():
            raise InputError(
                f"{path}: no such log. Check sessions.<name>.log in config/config.yaml."
            )
        if _log_suffix(path) not in LOG_OPENERS:
            raise InputError(
                f"{path}: a file of type {_log_suffix(path) or 'without suffix'}, expected "
                f"{', '.join(sorted(LOG_OPENERS))}. Run `ros2 bag convert` or `mcap convert`."
            )
    return paths


def _require_plain_path(path: Path) -> None:
    """Raise InputError if the path holds a line break or another control character."""
    if not str(path).isprintable():
        raise InputError(
            f"{plain_path(path)}: a path with characters that cannot be shown. Rename the "
            "file or folder."
        )


def _expand_name(name: str) -> list[Path]:
    """Return the paths that a name stands for; a path that exists is taken as it is written."""
    path = Path(name).expanduser()
    if path.exists() or not glob.has_magic(str(path)):
        return [path]
    found = sorted(Path(match) for match in glob.glob(str(path)))
    if not found:
        raise InputError(
            f"{name}: no file matches this pattern. Check sessions.<name>.log in "
            "config/config.yaml."
        )
    return found


def _log_suffix(path: Path) -> str:
    """Return the suffix of a path, without that of a compression of the whole file."""
    return Path(path.stem).suffix if path.suffix in COMPRESSED_SUFFIXES else path.suffix


def _find_files_in_folder(folder: Path) -> list[Path]:
    metadata = folder / "metadata.yaml"
    if metadata.is_file():
        return [_require_metadata_file(folder, name) for name in _read_metadata_names(metadata)]
    found = sorted(p for p in folder.iterdir() if _log_suffix(p) in LOG_OPENERS)
    if not found:
        raise InputError(
            f"{folder}: no log in this folder; expected {', '.join(sorted(LOG_OPENERS))}"
        )
    return found


def _read_metadata_names(metadata: Path) -> list[str]:
    """Return the names of the files in a rosbag2's metadata.yaml."""
    try:
        info = load_yaml(metadata)["rosbag2_bagfile_information"]
        return [Path(name).name for name in info["relative_file_paths"]]
    except (InputError, KeyError, TypeError):
        raise InputError(
            f"{metadata}: does not list the files of a rosbag2 log. "
            f"Run `ros2 bag reindex {metadata.parent}`."
        ) from None


def _require_metadata_file(folder: Path, name: str) -> Path:
    """Return the file of a name in metadata.yaml; raises InputError if it does not exist."""
    path = folder / name
    _require_plain_path(path)
    if not path.is_file():
        raise InputError(
            f"{path}: no such log, but {folder / 'metadata.yaml'} lists it. Copy it there, or "
            "write the list of the existing files at sessions.<name>.log."
        )
    return path


def open_log(log_config: str | list[str]) -> RecordedLog:
    """Open the log of a config's `log`."""
    files = find_log_files(log_config)
    formats = sorted({_log_suffix(p) for p in files})
    if len(formats) != 1:
        found = f"files of {' and '.join(formats)}" if formats else "no file"
        raise InputError(
            f"{log_config}: a log of {found}; expected one or more files of one format. "
            "Convert the others with `rosbags-convert`."
        )
    plain_files, folder = decompress_files(files)
    log = LOG_OPENERS[formats[0]](plain_files)
    log.temporary_folder = folder  # is removed together with the log
    return log


def fingerprint_log(log_config: str | list[str]) -> list[str]:
    """Return a line per file: name, size, SHA-256 of its first and last MiB; no path or date."""
    lines = []
    for path in find_log_files(log_config):
        size = path.stat().st_size
        with path.open("rb") as stream:
            digest = hashlib.sha256(stream.read(FINGERPRINT_BYTES))
            stream.seek(max(0, size - FINGERPRINT_BYTES))
            digest.update(stream.read(FINGERPRINT_BYTES))
        lines.append(f"{path.name} {size} {digest.hexdigest()}")
    return lines


def require_same_log(log_config: str | list[str], expected_fingerprint: list[str]) -> None:
    """Raise InputError unless the log still has the fingerprint that decode saw."""
    if fingerprint_log(log_config) != expected_fingerprint:
        raise InputError(
            f"{log_config}: changed since it was decoded. Run snakemake again; it decodes it first."
        )
