"""Messages of lidars and cameras as arrays, in the layouts that drivers really send."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib import clouds, images
from calib.status import InputError

CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}

# Layouts of drivers: field, type, offset; then the size of a point.
LAYOUTS = {
    "velodyne, packed": (
        [("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8)]
        + [("intensity", "f4", 12), ("ring", "u2", 16), ("time", "f4", 18)],
        22,
    ),
    "velodyne, padded by PCL": (
        [("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8)]
        + [("intensity", "f4", 16), ("ring", "u2", 20), ("time", "f4", 24)],
        32,
    ),
    "ouster": (
        [("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("intensity", "f4", 16), ("t", "u4", 20)]
        + [("reflectivity", "u2", 24), ("ring", "u2", 26), ("range", "u4", 32)],
        48,
    ),
    "ring of one byte": (
        [("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("ring", "u1", 12), ("t", "u4", 16)],
        20,
    ),
    "channel": ([("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("channel", "u2", 12)], 16),
    "line": ([("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("line", "u1", 12)], 16),
    "doubles, z first": ([("z", "f8", 0), ("y", "f8", 8), ("x", "f8", 16)], 24),
    "xyz alone": ([("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8)], 12),
}
XYZ = np.array([[1.5, -2.25, 0.125], [3, 4, -5], [-7, 0, 0], [0, 0, 9.5], [10, 11, 12], [1, 2, 3]])
RING = np.array([0, 15, 3, 7, 1, 127])
TIME_NS = np.array([0, 55_296, 1_000_000, 2_304, 99_999_744, 50_000_000])


def cloud(layout, xyz=XYZ, height=1, big=False, row_padding=0):
    """PointCloud2 of a layout, with rings and times where the layout has a place for them."""
    fields, step = LAYOUTS[layout]
    order = ">" if big else "<"
    dtype = np.dtype(
        {
            "names": [f[0] for f in fields],
            "formats": [order + f[1] for f in fields],
            "offsets": [f[2] for f in fields],
            "itemsize": step,
        }
    )
    points = np.zeros(len(xyz), dtype)
    noise = np.random.default_rng(0).integers(1, 255, points.nbytes, dtype=np.uint8)
    points = noise.view(dtype).copy()  # what lies between the fields is anything
    points["x"], points["y"], points["z"] = xyz.T
    for name in points.dtype.names:
        if name in ("ring", "channel", "line"):
            points[name] = RING[: len(xyz)]
        elif name == "time":
            points[name] = TIME_NS[: len(xyz)] / 1e9
        elif name == "t":
            points[name] = TIME_NS[: len(xyz)]
    width = len(xyz) // height
    rows = points.view(np.uint8).reshape(height, width * step)
    rows = np.pad(rows, ((0, 0), (0, row_padding)), constant_values=171)
    return SimpleNamespace(
        height=height,
        width=width,
        fields=[
            SimpleNamespace(name=n, datatype=CODES[t], offset=o, count=1) for n, t, o in fields
        ],
        is_bigendian=big,
        point_step=step,
        row_step=width * step + row_padding,
        data=rows.reshape(-1),
    )


def has(layout, *names):
    return any(f[0] in names for f in LAYOUTS[layout][0])


# --- clouds


@pytest.mark.parametrize("big", [False, True], ids=["little-endian", "big-endian"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_points_rings_and_times_are_read_in_every_layout_and_byte_order(layout, big):
    xyz, ring, dt = clouds.points(cloud(layout, big=big))
    assert xyz.dtype == np.float32 and xyz.dtype.isnative
    assert np.array_equal(xyz, XYZ)
    assert np.array_equal(ring, RING if has(layout, "ring", "channel", "line") else np.full(6, -1))
    assert dt.dtype == np.int64
    assert (
        np.abs(dt - (TIME_NS if has(layout, "t", "time") else 0)).max() <= 4
    )  # of float32 seconds


@pytest.mark.parametrize("height, row_padding", [(1, 0), (2, 0), (3, 0), (6, 0), (2, 10), (1, 7)])
def test_an_organised_cloud_is_read_row_by_row_without_the_padding_of_its_rows(height, row_padding):
    xyz, ring, _ = clouds.points(cloud("velodyne, packed", height=height, row_padding=row_padding))
    assert np.array_equal(xyz, XYZ) and np.array_equal(ring, RING)


def test_beams_without_a_return_are_left_out_be_they_zeros_or_not_numbers():
    xyz = XYZ.copy()
    xyz[0], xyz[2], xyz[3, 1], xyz[4, 2] = 0, np.nan, np.nan, np.inf
    found, ring, dt = clouds.points(cloud("velodyne, packed", xyz, height=2))
    assert np.array_equal(found, XYZ[[1, 5]])
    assert np.array_equal(ring, RING[[1, 5]])
    assert np.abs(dt - TIME_NS[[1, 5]]).max() <= 4


def test_a_point_on_an_axis_is_no_missing_return():
    xyz = np.array([[0, 0, 1], [0, -1, 0], [1e-6, 0, 0.0]])
    assert len(clouds.points(cloud("xyz alone", xyz))[0]) == 3


@pytest.mark.parametrize("layout", ["velodyne, packed", "ouster", "xyz alone"])
@pytest.mark.parametrize("height", [0, 1])
def test_a_cloud_of_no_point_has_no_point(layout, height):
    message = cloud(layout, XYZ[:0])
    message.height = height
    xyz, ring, dt = clouds.points(message)
    assert xyz.shape == (0, 3) and ring.shape == (0,) and dt.shape == (0,)


@pytest.mark.parametrize("kind", ["f8", "u4", "i4"])
def test_a_time_of_another_type_than_the_drivers_own_is_not_guessed_at(kind):
    """`time` is float32 seconds with Velodyne; as other types it has other units elsewhere."""
    fields = [("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("time", kind, 16)]
    LAYOUTS["strange"] = (fields, 24)
    try:
        _, _, dt = clouds.points(cloud("strange"))
    finally:
        del LAYOUTS["strange"]
    assert (dt == 0).all()


def test_nanoseconds_of_four_bytes_are_read_beyond_two_seconds():
    message = cloud("ouster")
    points = message.data.reshape(-1, 48)
    points[1, 20:24] = np.array([4_000_000_000], "<u4").view(np.uint8)
    assert clouds.points(message)[2][1] == 4_000_000_000


def test_a_cloud_without_coordinates_is_refused_with_the_fields_it_has():
    message = cloud("velodyne, packed")
    message.fields = [f for f in message.fields if f.name != "z"]
    with pytest.raises(InputError) as caught:
        clouds.points(message)
    assert str(caught.value) == (
        "a cloud without x, y, z: its fields are x, y, intensity, ring, time"
    )


# --- images

RNG = np.random.default_rng(0)
COLOR = RNG.integers(0, 256, (5, 7, 3), np.uint8)
GREY = RNG.integers(0, 256, (5, 7), np.uint8)
ALPHA = np.full((5, 7, 1), 9, np.uint8)


def image(encoding, pixels, padding=0):
    """Image message of pixels (h, w[, channels]) whose rows end with padding bytes of anything."""
    rows = pixels.reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=171)
    height, width = pixels.shape[:2]
    return SimpleNamespace(
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.reshape(-1),
    )


CASES = {
    "mono8": (GREY, np.repeat(GREY[..., None], 3, 2)),
    "8UC1": (GREY, np.repeat(GREY[..., None], 3, 2)),
    "bgr8": (COLOR, COLOR),
    "8UC3": (COLOR, COLOR),
    "rgb8": (COLOR[..., ::-1], COLOR),
    "bgra8": (np.dstack([COLOR, ALPHA]), COLOR),
    "rgba8": (np.dstack([COLOR[..., ::-1], ALPHA]), COLOR),
}


def test_every_encoding_has_a_case():
    assert set(CASES) == set(images.ENCODINGS)


@pytest.mark.parametrize("padding", [0, 1, 12])
@pytest.mark.parametrize("encoding", CASES)
def test_every_encoding_becomes_blue_green_red_without_the_padding_of_its_rows(encoding, padding):
    pixels, expected = CASES[encoding]
    found = images.bgr(image(encoding, pixels, padding))
    assert found.dtype == np.uint8 and np.array_equal(found, expected)
    assert found.flags["C_CONTIGUOUS"]


def test_red_is_red():
    red = np.zeros((2, 2, 3), np.uint8)
    red[..., 0] = 255
    assert images.bgr(image("rgb8", red))[0, 0].tolist() == [0, 0, 255]
    assert images.bgr(image("bgr8", red))[0, 0].tolist() == [255, 0, 0]


@pytest.mark.parametrize("encoding", ["bayer_rggb8", "mono16", "yuv422", "", "BGR8"])
def test_an_unknown_encoding_is_refused_with_what_is_read_and_the_remedy(encoding):
    with pytest.raises(InputError) as caught:
        images.bgr(image(encoding, GREY))
    message = str(caught.value)
    assert f"images encoded {encoding}; this version reads mono8, " in message
    assert "convert the topic with image_proc and record it again" in message


def compressed(data, name="jpeg"):
    return SimpleNamespace(format=name, data=np.frombuffer(data, np.uint8))


def test_a_compressed_png_comes_back_exactly_in_blue_green_red():
    data = cv2.imencode(".png", COLOR)[1].tobytes()
    assert np.array_equal(images.bgr(compressed(data, "rgb8; png compressed bgr8")), COLOR)


def test_a_compressed_grey_png_has_three_equal_channels():
    data = cv2.imencode(".png", GREY)[1].tobytes()
    assert np.array_equal(images.bgr(compressed(data, "png")), CASES["mono8"][1])


def test_a_compressed_jpeg_comes_back_within_a_few_grey_levels():
    smooth = cv2.resize(COLOR, (70, 50), interpolation=cv2.INTER_CUBIC)
    data = cv2.imencode(".jpg", smooth, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()
    found = images.bgr(compressed(data)).astype(int)
    assert found.shape == (50, 70, 3)
    assert np.abs(found - smooth).mean() < 3


def test_an_orientation_tag_does_not_turn_the_image():
    """Exif orientation 6, a quarter turn: calibrated pixels are those of the sensor."""
    data = cv2.imencode(".jpg", np.zeros((4, 8, 3), np.uint8))[1].tobytes()
    entry = b"\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06\x00\x00"
    exif = b"Exif\x00\x00MM\x00\x2a\x00\x00\x00\x08\x00\x01" + entry + b"\x00\x00\x00\x00"
    tagged = data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:]
    turned = cv2.imdecode(np.frombuffer(tagged, np.uint8), cv2.IMREAD_COLOR)
    assert turned.shape == (8, 4, 3)
    assert images.bgr(compressed(tagged)).shape == (4, 8, 3)


@pytest.mark.parametrize(
    "data", [b"", b"\x00", b"garbage" * 99], ids=["empty", "a byte", "garbage"]
)
def test_garbage_is_refused_with_its_format(data):
    with pytest.raises(InputError, match="an image of format 'h264' that is neither JPEG nor PNG"):
        images.bgr(compressed(data, "h264"))


# --- regions of images


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 99), st.booleans())
@settings(max_examples=40, deadline=None)
def test_png_is_lossless_in_grey_and_in_colour(height, width, seed, is_grey):
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)
    if is_grey:
        pixels = np.repeat(pixels[..., :1], 3, 2)
    assert np.array_equal(images.from_png(images.to_png(pixels)), pixels)


def test_a_grey_region_is_kept_in_one_channel():
    grey, color = (np.tile(a, (20, 20, 1)) for a in (CASES["mono8"][1], COLOR))
    assert len(images.to_png(grey)) < 0.5 * len(images.to_png(color))


def test_a_region_cut_out_of_an_image_is_kept_exactly():
    region = COLOR[1:4, 2:6]
    assert np.array_equal(images.from_png(images.to_png(region)), region)


def test_grey_of_equal_channels_is_that_channel():
    assert np.array_equal(images.grey(CASES["mono8"][1]), GREY)
