"""The one way to write: a file or folder is complete or absent, and never behind a link."""

import errno
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from calib.io.safe_names import plain_path
from calib.io.status import InputError

DISK_FULL_ERRNOS = (errno.ENOSPC, errno.EDQUOT)
# A new file: not one that exists, and not behind a link.
NEW_FILE_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a new, empty file beside `path`; it replaces `path` when the block ends without error.

    Raises InputError if a folder on the way is a symbolic link, or if the file cannot be written,
    for example on a full disk. Nothing is left behind then. A temporary file left by a killed job
    is removed by the next one.
    """
    path, part = Path(path), _part_path(path)
    require_no_link_above(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            part.unlink()  # of a link: the link alone
        create_file(part, b"")
        yield part
        os.replace(part, path)
    except OSError as error:
        raise InputError(_write_error_message(path, error)) from error
    finally:
        with suppress(OSError):
            part.unlink()


def create_file(path: Path, data: bytes) -> None:
    """Write a file that does not exist yet; raises FileExistsError for one, and for a link."""
    with os.fdopen(os.open(path, NEW_FILE_FLAGS, 0o666), "wb") as stream:
        stream.write(data)


def write_file(path: str | Path, content: str | bytes) -> None:
    """Write text (UTF-8) or bytes as one complete file."""
    with atomic_write(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def atomic_folder(path: str | Path, is_own: Callable[[str], bool]) -> Iterator[Path]:
    """Yield an empty temporary folder beside `path`; it replaces `path` when the block ends.

    The old folder is removed first, as remove_folder does. Raises InputError like atomic_write.
    """
    path, part = Path(path), _part_path(path)
    remove_folder(path, is_own)
    try:
        part.mkdir(parents=True)
        yield part
        os.replace(part, path)
    except OSError as error:
        raise InputError(_write_error_message(path, error)) from error
    finally:
        with suppress(InputError, OSError):
            _remove_own_files(part, is_own)


def _part_path(path: str | Path) -> Path:
    return Path(path).with_name(f".{Path(path).name}.part")


def remove_folder(path: str | Path, is_own: Callable[[str], bool]) -> None:
    """Remove a folder if it exists, and the temporary folder that a killed job left beside it.

    is_own: whether this project writes a file of that path in the folder. Raises InputError, and
    removes nothing, if a folder holds anything else or is a symbolic link.
    """
    require_no_link_above(path)
    for folder in (Path(path), _part_path(path)):
        try:
            _remove_own_files(folder, is_own)
        except OSError as error:
            raise InputError(_write_error_message(folder, error)) from error


def _remove_own_files(folder: Path, is_own: Callable[[str], bool]) -> None:
    """Remove a folder of own files; raises InputError, and removes nothing, if there are others."""
    require_no_link(folder)
    if not folder.exists():
        return
    entries = sorted(folder.rglob("*"), reverse=True)  # a folder comes after what it holds
    for entry in entries:
        mode = entry.lstat().st_mode
        name = entry.relative_to(folder).as_posix()
        if not (stat.S_ISDIR(mode) or (stat.S_ISREG(mode) and is_own(name))):
            raise InputError(
                f"{plain_path(entry)}: not written by this pipeline, so it is not removed. "
                "Move it away and run again."
            )
    for entry in [*entries, folder]:
        if entry.is_dir():
            entry.rmdir()
        else:
            entry.unlink()


def require_no_link_above(path: str | Path) -> None:
    """Raise InputError if a folder between the working folder and a path is a symbolic link.

    A path outside the working folder was named by the user; of it, only its own folder counts.
    """
    path, home = Path(path), Path.cwd()
    absolute = Path(os.path.abspath(path))
    if not absolute.is_relative_to(home):
        require_no_link(absolute.parent)
        return
    for folder in absolute.parents:
        if folder == home:
            return
        require_no_link(folder)


def require_no_link(path: str | Path) -> None:
    """Raise InputError if a path is a symbolic link."""
    if os.path.islink(path):
        target = plain_path(os.readlink(path))
        raise InputError(
            f"{plain_path(path)}: a symbolic link to {target}. Nothing is written through "
            "links: remove it, and run in the folder that it leads to."
        )


def require_no_link_below(folder: str | Path) -> None:
    """Raise InputError if a folder is a symbolic link, or holds one at any depth."""
    require_no_link(folder)
    for parent, folders, files in os.walk(folder):
        for name in sorted(folders + files):
            require_no_link(Path(parent, name))


def disk_full_message(path: str | Path) -> str:
    """Return the message that a file or folder cannot grow because its disk is full."""
    return f"{path}: no space left on the disk. Free some space and run again."


def _write_error_message(path: Path, error: OSError) -> str:
    """Return what keeps a path from being written, and what to do."""
    if error.errno in DISK_FULL_ERRNOS:
        return disk_full_message(path)
    cause = os.strerror(error.errno) if error.errno else error
    return f"{path}: cannot be written ({cause}). Fix the cause and run again."
