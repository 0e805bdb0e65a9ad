"""Template files of a stranger: what a header declares is compared with the file before reading."""

import struct

import numpy as np
import pytest

from calib.io.status import InputError
from calib.targets.point_template import read_template_file

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0.5]], np.float32)
TEXT = "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in POINTS).encode()


def pcd(count, data="ascii", body=TEXT, sizes="4 4 4", repeats="1 1 1"):
    head = (
        f"VERSION .7\nFIELDS x y z\nSIZE {sizes}\nTYPE F F F\nCOUNT {repeats}\nWIDTH {count}\n"
        f"HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA {data}\n"
    )
    return head.encode() + body


def ply(count, form="ascii", body=TEXT, more=""):
    head = (
        f"ply\nformat {form} 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n"
        f"property float z\n{more}end_header\n"
    )
    return head.encode() + body


FACE = "element face {}\nproperty list uchar int vertex_indices\n"
GOOD = {
    "a.pcd": pcd(5),
    "b.pcd": pcd(5, "binary", POINTS.tobytes()),
    "a.ply": ply(5),
    "b.ply": ply(5, "binary_little_endian", POINTS.tobytes()),
    "c.ply": ply(5, body=TEXT + b"3 0 1 2\n", more=FACE.format(1)),
}


@pytest.mark.parametrize("name", GOOD)
def test_a_true_header_is_read(tmp_path, name):
    (tmp_path / name).write_bytes(GOOD[name])
    assert len(read_template_file(tmp_path / name)) == 5


HOSTILE = {
    "text.pcd": pcd(4_000_000_000),
    "binary.pcd": pcd(1_900_000, "binary"),
    "packed.pcd": pcd(1_000_000, "binary_compressed", struct.pack("<II", 20, 12_000_000)),
    "wide.pcd": pcd(5, sizes="4 4 400000000"),
    "many.pcd": pcd(5, repeats="1 1 900000000"),
    "negative.pcd": pcd(-1),
    "text.ply": ply(4_000_000_000),
    "binary.ply": ply(1_900_000, "binary_little_endian"),
    "faces.ply": ply(5, more=FACE.format(2_000_000_000)),
    "bare.ply": ply(5, more="element odd 2000000000\n"),
    "headless.pcd": b"x" * 100,
    "headless.ply": b"",
    "odd type.ply": ply(5, "binary_little_endian").replace(b"float x", b"double128 x"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_header_that_declares_more_than_the_file_holds_is_refused_with_the_file(tmp_path, name):
    (tmp_path / name).write_bytes(HOSTILE[name])
    with pytest.raises(InputError) as caught:
        read_template_file(tmp_path / name)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / name}: ") and len(message) < 400
    assert "Write the " in message
