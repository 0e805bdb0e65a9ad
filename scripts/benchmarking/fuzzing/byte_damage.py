"""What happens to bytes on their way from a recorder to a person's disk, drawn at random.

Every function takes a bytearray, which it may change, and a generator, and gives the bytes left.
"""

import numpy as np


def flip_bits(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Some bits wrong, anywhere."""
    for at in rng.integers(0, len(data), rng.integers(1, 12)):
        data[at] ^= 1 << rng.integers(8)
    return data


def truncate_bytes(data: bytearray, rng: np.random.Generator) -> bytearray:
    """The end missing, from anywhere."""
    return data[: rng.integers(0, len(data))]


def overwrite_bytes(data: bytearray, rng: np.random.Generator) -> bytearray:
    """A stretch of other bytes: zeros, ones, or anything."""
    n = int(rng.integers(1, 64))
    at = int(rng.integers(0, max(1, len(data) - n)))
    data[at : at + n] = [bytes(n), b"\xff" * n, rng.bytes(n)][rng.integers(3)]
    return data


def remove_bytes(data: bytearray, rng: np.random.Generator) -> bytearray:
    """A stretch missing within."""
    at = int(rng.integers(0, len(data)))
    del data[at : at + int(rng.integers(1, 200))]
    return data


def repeat_bytes(data: bytearray, rng: np.random.Generator) -> bytearray:
    """A stretch twice."""
    at = int(rng.integers(0, len(data)))
    data[at:at] = data[at : at + int(rng.integers(1, 200))]
    return data


BYTE_DAMAGES = (flip_bits, truncate_bytes, overwrite_bytes, remove_bytes, repeat_bytes)
