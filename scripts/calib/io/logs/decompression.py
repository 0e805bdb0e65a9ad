"""Decompression that takes no more memory or disk than is sensible, whatever a log declares."""

import bz2
import shutil
import tempfile
from pathlib import Path

import zstandard
from lz4.frame import LZ4FrameDecompressor

from calib.io.status import InputError, in_a_line

LARGEST = 1 << 30  # bytes of a chunk or a message, unpacked
SPARE = 1 << 30  # bytes of the disk that unpacking a file leaves free
ZSTD = zstandard.FRAME_HEADER  # no serialised message begins like that
SUFFIXES = (".zstd", ".zst")


class TooLarge(Exception):
    """What unpacks to more than LARGEST, or to more than it declares."""


def message(data):
    """The bytes of a message that rosbag2 may have compressed by itself."""
    return zstd(data, LARGEST) if bytes(data[:4]) == ZSTD else data


def zstd(data, size):
    """Unpacked zstd frame of at most size bytes."""
    declared = zstandard.get_frame_parameters(data).content_size
    if declared != zstandard.CONTENTSIZE_UNKNOWN and declared > size:
        raise TooLarge(f"{declared} bytes, expected at most {size}")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)


def lz4(data, size=LARGEST):
    """Unpacked LZ4 frame of at most size bytes."""
    return _whole(LZ4FrameDecompressor(), data, size)


def bzip2(data, size=LARGEST):
    """Unpacked bzip2 stream of at most size bytes."""
    return _whole(bz2.BZ2Decompressor(), data, size)


def _whole(decompressor, data, size):
    out = decompressor.decompress(data, max_length=size + 1)
    if len(out) > size:
        raise TooLarge(f"more than {size} bytes")
    if not decompressor.eof:
        raise EOFError("a compressed block ends early")
    return out


def files(paths):
    """The paths, those compressed as a whole unpacked in a folder; and that folder, which lives as
    long as the object, or None."""
    if not any(p.suffix in SUFFIXES for p in paths):
        return paths, None
    folder = tempfile.TemporaryDirectory(prefix="log-")
    out = [_file(p, Path(folder.name)) if p.suffix in SUFFIXES else p for p in paths]
    return out, folder


def _file(path, folder):
    target = folder / path.stem
    left = shutil.disk_usage(folder).free - SPARE
    try:
        with zstandard.open(path, "rb") as source, target.open("wb") as out:
            while block := source.read(1 << 20):
                left -= len(block)
                if left < 0:
                    raise TooLarge("more than the disk holds")
                out.write(block)
    except (zstandard.ZstdError, OSError, TooLarge) as error:
        raise InputError(
            f"{path}: cannot be unpacked in {folder.parent} ({in_a_line(error)}); "
            f"set TMPDIR to a larger disk, or unpack it by hand with `zstd -d`"
        ) from error
    return target
