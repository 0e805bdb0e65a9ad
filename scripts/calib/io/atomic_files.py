"""Atomic writes: a file or folder is complete or absent."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from calib.io.status import InputError

DISK_FULL_ERRNOS = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; it replaces `path` when the block ends without error.

    Raises InputError if the file cannot be written, for example on a full disk. Nothing is left
    behind then. A temporary file left by a killed job is overwritten by the next one.
    """
    path, part = Path(path), _part_path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        os.replace(part, path)
    except OSError as error:
        raise InputError(_write_error_message(path, error)) from error
    finally:
        with suppress(OSError):
            part.unlink()


def write_file(path: str | Path, content: str | bytes) -> None:
    """Write text (UTF-8) or bytes as one complete file."""
    with atomic_write(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield an empty temporary folder beside `path`; it replaces `path` when the block ends.

    The old folder is removed first. Raises InputError like atomic_write.
    """
    path, part = Path(path), _part_path(path)
    try:
        remove_folder(path)
        part.mkdir(parents=True)
        yield part
        os.replace(part, path)
    except OSError as error:
        raise InputError(_write_error_message(path, error)) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _part_path(path: str | Path) -> Path:
    return Path(path).with_name(f".{Path(path).name}.part")


def remove_folder(path: str | Path) -> None:
    """Remove a folder if it exists, and the temporary folder that a killed job left beside it."""
    for folder in (Path(path), _part_path(path)):
        if folder.exists():
            shutil.rmtree(folder)


def disk_full_message(path: str | Path) -> str:
    """Return the message that a file or folder cannot grow because its disk is full."""
    return f"{path}: no space left on the disk. Free some space and run again."


def _write_error_message(path: Path, error: OSError) -> str:
    """Return what keeps a path from being written, and what to do."""
    if error.errno in DISK_FULL_ERRNOS:
        return disk_full_message(path)
    cause = os.strerror(error.errno) if error.errno else error
    return f"{path}: cannot be written ({cause}). Fix the cause and run again."
