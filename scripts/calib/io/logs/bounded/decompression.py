"""Decompression with bounded memory and disk space, whatever a log declares."""

import bz2
import shutil
import tempfile
from pathlib import Path

import zstandard
from lz4.frame import LZ4FrameDecompressor

from calib.io.status import InputError, summarize_error

MAX_UNPACKED_BYTES = 1 << 28  # of a decompressed chunk or message
MIN_FREE_DISK_BYTES = 1 << 30  # left free on the disk by decompressing a file
ZSTD_MAGIC = zstandard.FRAME_HEADER  # no serialised message begins with these bytes
COMPRESSED_SUFFIXES = (".zstd", ".zst")


class TooLargeError(Exception):
    """Data that decompresses to more than allowed, or more than it declares."""


def decompress_message(data: bytes) -> bytes:
    """Return the bytes of a message, decompressed if rosbag2 compressed this message by itself."""
    return decompress_zstd(data, MAX_UNPACKED_BYTES) if bytes(data[:4]) == ZSTD_MAGIC else data


def decompress_zstd(data: bytes, max_bytes: int) -> bytes:
    """Decompress a zstd frame; raises TooLargeError above max_bytes."""
    declared = find_zstd_size(data)
    if declared is not None and declared > max_bytes:
        raise TooLargeError(f"{declared} bytes, expected at most {max_bytes}")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=max_bytes)


def find_zstd_size(data: bytes) -> int | None:
    """Return the size that a zstd frame declares for its content, None if it declares none."""
    declared = zstandard.get_frame_parameters(data).content_size
    return None if declared == zstandard.CONTENTSIZE_UNKNOWN else declared


def decompress_lz4(data: bytes, max_bytes: int = MAX_UNPACKED_BYTES) -> bytes:
    """Decompress an LZ4 frame; raises TooLargeError above max_bytes."""
    return _decompress_bounded(LZ4FrameDecompressor(), data, max_bytes)


def decompress_bzip2(data: bytes, max_bytes: int = MAX_UNPACKED_BYTES) -> bytes:
    """Decompress a bzip2 stream; raises TooLargeError above max_bytes."""
    return _decompress_bounded(bz2.BZ2Decompressor(), data, max_bytes)


def _decompress_bounded(
    decompressor: LZ4FrameDecompressor | bz2.BZ2Decompressor, data: bytes, max_bytes: int
) -> bytes:
    out = decompressor.decompress(data, max_length=max_bytes + 1)
    if len(out) > max_bytes:
        raise TooLargeError(f"more than {max_bytes} bytes")
    if not decompressor.eof:
        raise EOFError("a compressed block ends early")
    return out


def decompress_files(
    paths: list[Path],
) -> tuple[list[Path], tempfile.TemporaryDirectory[str] | None]:
    """Decompress the files that are compressed as a whole, into a temporary folder.

    Returns the paths to read, and the folder or None. The folder exists as long as the object.
    """
    if not any(p.suffix in COMPRESSED_SUFFIXES for p in paths):
        return paths, None
    folder = tempfile.TemporaryDirectory(prefix="log-")
    out = [
        _decompress_file(p, Path(folder.name)) if p.suffix in COMPRESSED_SUFFIXES else p
        for p in paths
    ]
    return out, folder


def _decompress_file(path: Path, folder: Path) -> Path:
    target = folder / path.stem
    free_bytes = shutil.disk_usage(folder).free - MIN_FREE_DISK_BYTES
    try:
        with zstandard.open(path, "rb") as source, target.open("wb") as out:
            while block := source.read(1 << 20):
                free_bytes -= len(block)
                if free_bytes < 0:
                    raise TooLargeError("more than the free space of the disk")
                out.write(block)
    except (zstandard.ZstdError, OSError, TooLargeError) as error:
        raise InputError(
            f"{path}: cannot be decompressed in {folder.parent} ({summarize_error(error)}). "
            "Set TMPDIR to a larger disk, or decompress the file with `zstd -d`."
        ) from error
    return target
