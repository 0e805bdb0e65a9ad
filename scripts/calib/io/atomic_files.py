"""Files and folders that are there whole or not at all."""

import errno
import os
import shutil
from contextlib import contextmanager, suppress
from pathlib import Path

from calib.io.status import InputError

DISK_FULL_ERRNOS = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def atomic_write(path):
    """A path beside `path` to write to, which takes its place when all is written.

    Raises InputError where it cannot be written, as on a full disk; nothing is left behind then.
    What a killed job leaves beside it, the next one takes for its own.
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


def write_file(path, content):
    """Write a text or bytes as one whole file."""
    with atomic_write(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def atomic_folder(path):
    """An empty folder beside `path` to fill, which takes its place when all is in it.

    What stood there is removed first. Raises as `whole`.
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


def _part_path(path):
    return Path(path).with_name(f".{Path(path).name}.part")


def remove_folder(path):
    """Remove a folder, if it is there, and what a killed job began of it."""
    for folder in (path, _part_path(path)):
        if folder.exists():
            shutil.rmtree(folder)


def _write_error_message(path, error):
    """In words, what keeps a path from being written."""
    if error.errno in DISK_FULL_ERRNOS:
        return f"{path}: no space left on its disk; free some and run again"
    words = os.strerror(error.errno) if error.errno else error
    return f"{path}: cannot be written ({words}); mend that and run again"
