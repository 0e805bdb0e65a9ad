"""Random damage to the bytes of a file.

Every function takes a bytearray, which it may change, and a random generator, and returns the
damaged bytes.
"""

import numpy as np


def flip_bits(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Flip some random bits."""
    for at in rng.integers(0, len(data), rng.integers(1, 12)):
        data[at] ^= 1 << rng.integers(8)
    return data


def truncate_bytes(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Cut off the end at a random position."""
    return data[: rng.integers(0, len(data))]


def overwrite_bytes(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Overwrite a part with zeros, ones or random bytes."""
    n = int(rng.integers(1, 64))
    at = int(rng.integers(0, max(1, len(data) - n)))
    data[at : at + n] = [bytes(n), b"\xff" * n, rng.bytes(n)][rng.integers(3)]
    return data


def remove_bytes(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Remove a part."""
    at = int(rng.integers(0, len(data)))
    del data[at : at + int(rng.integers(1, 200))]
    return data


def repeat_bytes(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Repeat a part."""
    at = int(rng.integers(0, len(data)))
    data[at:at] = data[at : at + int(rng.integers(1, 200))]
    return data


BYTE_DAMAGES = (flip_bits, truncate_bytes, overwrite_bytes, remove_bytes, repeat_bytes)
