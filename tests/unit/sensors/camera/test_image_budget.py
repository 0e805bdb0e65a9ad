"""Compressed images of a stranger: their declared size is checked before pixels are allocated."""

import struct
import zlib
from types import SimpleNamespace

import numpy as np
import pytest

from calib.io.status import MessageError
from calib.sensors.camera.images import compressed_image
from calib.sensors.camera.images.image_messages import encode_png


def png(width, height, depth=8, colour=2, n_data=100):
    """A PNG that declares these pixels and holds a few bytes of them."""

    def part(kind, data):
        crc = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", crc)

    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    body = part(b"IDAT", zlib.compress(bytes(n_data))) + part(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + body


def read(data):
    message = SimpleNamespace(format="png", data=np.frombuffer(data, np.uint8))
    return compressed_image.read(message)


@pytest.mark.parametrize(
    "data",
    [
        png(10_000, 10_000),
        png(6_000, 6_000, depth=16, colour=6, n_data=10**7),
        png(3_000, 3_000),
        png(2**31 - 1, 2**31 - 1),
    ],
    ids=["100 MP", "36 MP of 8 bytes", "more than deflate can hold", "4e18"],
)
def test_an_image_that_declares_more_than_its_bytes_can_hold_is_refused(data):
    with pytest.raises(MessageError, match="claims|neither JPEG nor PNG"):
        read(data)


def test_an_image_of_one_colour_is_read():
    """Nothing packs better: 3 MP in 10 kB."""
    grey = np.full((1500, 2000, 3), 128, np.uint8)
    assert np.array_equal(read(encode_png(grey)), grey)
