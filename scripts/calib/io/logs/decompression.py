"""Decompression that takes no more memory or disk than is sensible, whatever a log declares."""

import bz2
import shutil
import tempfile
from pathlib import Path

import zstandard
from lz4.frame import LZ4FrameDecompressor

from calib.io.status import InputError, summarize_error

MAX_UNPACKED_BYTES = 1 << 30  # bytes of a chunk or a message, unpacked
MIN_FREE_DISK_BYTES = 1 << 30  # bytes of the disk that unpacking a file leaves free
ZSTD_MAGIC = zstandard.FRAME_HEADER  # no serialised message begins like that
COMPRESSED_SUFFIXES = (".zstd", ".zst")


class TooLargeError(Exception):
    """What unpacks to more than LARGEST, or to more than it declares."""


def decompress_message(data):
    """The bytes of a message that rosbag2 may have compressed by itself."""
    return decompress_zstd(data, MAX_UNPACKED_BYTES) if bytes(data[:4]) == ZSTD_MAGIC else data


def decompress_zstd(data, max_bytes):
    """Unpacked zstd frame of at most size bytes."""
    declared = zstandard.get_frame_parameters(data).content_size
    if declared != zstandard.CONTENTSIZE_UNKNOWN and declared > max_bytes:
        raise TooLargeError(f"{declared} bytes, expected at most {max_bytes}")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=max_bytes)


def decompress_lz4(data, max_bytes=MAX_UNPACKED_BYTES):
    """Unpacked LZ4 frame of at most size bytes."""
    return _decompress_bounded(LZ4FrameDecompressor(), data, max_bytes)


def decompress_bzip2(data, max_bytes=MAX_UNPACKED_BYTES):
    """Unpacked bzip2 stream of at most size bytes."""
    return _decompress_bounded(bz2.BZ2Decompressor(), data, max_bytes)


def _decompress_bounded(decompressor, data, max_bytes):
    out = decompressor.decompress(data, max_length=max_bytes + 1)
    if len(out) > max_bytes:
        raise TooLargeError(f"more than {max_bytes} bytes")
    if not decompressor.eof:
        raise EOFError("a compressed block ends early")
    return out


def decompress_files(paths):
    """The paths, those compressed as a whole unpacked in a folder; and that folder, which lives as
    long as the object, or None."""
    if not any(p.suffix in COMPRESSED_SUFFIXES for p in paths):
        return paths, None
    folder = tempfile.TemporaryDirectory(prefix="log-")
    out = [
        _decompress_file(p, Path(folder.name)) if p.suffix in COMPRESSED_SUFFIXES else p
        for p in paths
    ]
    return out, folder


def _decompress_file(path, folder):
    target = folder / path.stem
    left = shutil.disk_usage(folder).free - MIN_FREE_DISK_BYTES
    try:
        with zstandard.open(path, "rb") as source, target.open("wb") as out:
            while block := source.read(1 << 20):
                left -= len(block)
                if left < 0:
                    raise TooLargeError("more than the disk holds")
                out.write(block)
    except (zstandard.ZstdError, OSError, TooLargeError) as error:
        raise InputError(
            f"{path}: cannot be unpacked in {folder.parent} ({summarize_error(error)}); "
            f"set TMPDIR to a larger disk, or unpack it by hand with `zstd -d`"
        ) from error
    return target
