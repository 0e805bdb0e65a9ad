"""Files that are there whole or not at all."""

import os
from contextlib import contextmanager
from pathlib import Path

from calib.status import InputError


@contextmanager
def whole(path):
    """A path beside `path` to write to, which takes its place when all is written.

    Raises InputError where it cannot be written, as on a full disk; nothing is left behind then.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.part")
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        part.unlink(missing_ok=True)
