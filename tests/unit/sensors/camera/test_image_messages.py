"""Images of every encoding as arrays, and regions of them as lossless bytes."""

import tracemalloc
import zlib
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.io.status import InputError, MessageError
from calib.sensors.camera.images.image_messages import decode_png, encode_png, read_bgr, to_grey
from calib.sensors.camera.images.pixel_encodings import PIXEL_ENCODINGS

RNG = np.random.default_rng(0)
COLOR = RNG.integers(0, 256, (5, 7, 3), np.uint8)
GREY = RNG.integers(0, 256, (5, 7), np.uint8)
ALPHA = np.full((5, 7, 1), 9, np.uint8)


def image(encoding, pixels, padding=0):
    """Image message of pixels (h, w[, channels]) whose rows end with padding bytes of anything."""
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=171)
    height, width = pixels.shape[:2]
    return SimpleNamespace(
        __msgtype__="sensor_msgs/msg/Image",
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.reshape(-1),
    )


EVEN = cv2.resize(GREY, (40, 30), interpolation=cv2.INTER_CUBIC)  # changes slowly
GREY3 = np.repeat(GREY[..., None], 3, 2)
EVEN3 = np.repeat(EVEN[..., None], 3, 2)
LIMITED = np.round(16 + EVEN * (219 / 255)).astype(np.uint8)  # brightness of YUV, 16 to 235
NO_COLOR = np.full_like(LIMITED, 128)
HALF = np.full((15, 40), 128, np.uint8)  # colours, one of each for four pixels


def wide(pixels):
    """Pixels of 8 bits as ones of 16."""
    return pixels.astype("<u2") * 257


# Encoding: pixels as they lie in memory, what they show, most grey levels that it may be off.
CASES = {
    "mono8": (GREY, GREY3, 0),
    "8UC1": (GREY, GREY3, 0),
    "mono16": (wide(GREY), GREY3, 0),
    "16UC1": (wide(GREY), GREY3, 0),
    "bgr8": (COLOR, COLOR, 0),
    "8UC3": (COLOR, COLOR, 0),
    "rgb8": (COLOR[..., ::-1], COLOR, 0),
    "bgr16": (wide(COLOR), COLOR, 0),
    "16UC3": (wide(COLOR), COLOR, 0),
    "rgb16": (wide(COLOR[..., ::-1]), COLOR, 0),
    "bgra8": (np.dstack([COLOR, ALPHA]), COLOR, 0),
    "8UC4": (np.dstack([COLOR, ALPHA]), COLOR, 0),
    "rgba8": (np.dstack([COLOR[..., ::-1], ALPHA]), COLOR, 0),
    "bgra16": (wide(np.dstack([COLOR, ALPHA])), COLOR, 0),
    "16UC4": (wide(np.dstack([COLOR, ALPHA])), COLOR, 0),
    "rgba16": (wide(np.dstack([COLOR[..., ::-1], ALPHA])), COLOR, 0),
    "yuv422": (np.dstack([NO_COLOR, LIMITED]), EVEN3, 1),
    "uyvy": (np.dstack([NO_COLOR, LIMITED]), EVEN3, 1),
    "yuv422_yuy2": (np.dstack([LIMITED, NO_COLOR]), EVEN3, 1),
    "yuyv": (np.dstack([LIMITED, NO_COLOR]), EVEN3, 1),
    "nv12": (np.vstack([LIMITED, HALF]), EVEN3, 1),
    "nv21": (np.vstack([LIMITED, HALF]), EVEN3, 1),
    **{f"bayer_{k}8": (EVEN, EVEN3, 40) for k in ("rggb", "bggr", "gbrg", "grbg")},
    **{f"bayer_{k}16": (wide(EVEN), EVEN3, 40) for k in ("rggb", "bggr", "gbrg", "grbg")},
}


def test_every_encoding_has_a_case():
    assert set(CASES) == set(PIXEL_ENCODINGS)


def shown(encoding, padding=0, big=False):
    """The message of a case."""
    pixels, expected, _ = CASES[encoding]
    pixels = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<"))
    message = image(encoding, pixels, padding)
    message.height = len(expected)
    return message


@pytest.mark.parametrize("big", [False, True], ids=["little-endian", "big-endian"])
@pytest.mark.parametrize("padding", [0, 1, 12])
@pytest.mark.parametrize("encoding", CASES)
def test_every_encoding_becomes_blue_green_red_without_the_padding_of_its_rows(
    encoding, padding, big
):
    message = shown(encoding, padding, big)
    message.is_bigendian = int(big)
    found = read_bgr(message)
    _, expected, most = CASES[encoding]
    assert found.dtype == np.uint8 and found.shape == expected.shape
    assert found.flags["C_CONTIGUOUS"]
    off = np.abs(found.astype(int) - expected)
    # Rounding of brightness to 220 steps alone is worth 0.12 in the mean.
    assert off.max() <= most and off.mean() <= max(most / 10, 0.15 * (most > 0))


def test_red_is_red():
    red = np.zeros((2, 2, 3), np.uint8)
    red[..., 0] = 255
    assert read_bgr(image("rgb8", red))[0, 0].tolist() == [0, 0, 255]
    assert read_bgr(image("bgr8", red))[0, 0].tolist() == [255, 0, 0]


@pytest.mark.parametrize("encoding", ["32FC1", "yuv444", "", "BGR8"])
def test_an_unknown_encoding_is_refused_with_what_is_read_and_the_remedy(encoding):
    with pytest.raises(InputError) as caught:
        read_bgr(image(encoding, GREY))
    message = str(caught.value)
    assert f"image encoding {encoding} is not supported; expected one of mono8, " in message
    assert "Convert the topic with image_proc and record it again" in message


def compressed(data, name="jpeg"):
    kind = "sensor_msgs/msg/CompressedImage"
    return SimpleNamespace(__msgtype__=kind, format=name, data=np.frombuffer(data, np.uint8))


def test_a_compressed_png_comes_back_exactly_in_blue_green_red():
    data = cv2.imencode(".png", COLOR)[1].tobytes()
    assert np.array_equal(read_bgr(compressed(data, "rgb8; png compressed bgr8")), COLOR)


def test_a_compressed_grey_png_has_three_equal_channels():
    data = cv2.imencode(".png", GREY)[1].tobytes()
    assert np.array_equal(read_bgr(compressed(data, "png")), GREY3)


def test_a_compressed_jpeg_comes_back_within_a_few_grey_levels():
    smooth = cv2.resize(COLOR, (70, 50), interpolation=cv2.INTER_CUBIC)
    data = cv2.imencode(".jpg", smooth, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()
    found = read_bgr(compressed(data)).astype(int)
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
    assert read_bgr(compressed(tagged)).shape == (4, 8, 3)


@pytest.mark.parametrize(
    "data", [b"", b"\x00", b"garbage" * 99], ids=["empty", "a byte", "garbage"]
)
def test_garbage_is_refused_with_its_format(data):
    with pytest.raises(InputError, match="an image of format 'h264' that is neither JPEG nor PNG"):
        read_bgr(compressed(data, "h264"))


@pytest.mark.parametrize("pattern, channel", [("rggb", 2), ("bggr", 0)])
def test_the_first_pixel_of_a_mosaic_has_the_colour_that_its_name_begins_with(pattern, channel):
    mosaic = np.zeros((16, 16), np.uint8)
    mosaic[::2, ::2] = 200
    middle = read_bgr(image(f"bayer_{pattern}8", mosaic))[8, 8]
    assert middle[channel] == 200 and np.delete(middle, channel).max() == 0


@pytest.mark.parametrize("pattern", ["gbrg", "grbg"])
def test_green_of_a_mosaic_is_green(pattern):
    mosaic = np.indices((16, 16)).sum(0) % 2 == 0
    middle = read_bgr(image(f"bayer_{pattern}8", np.uint8(200) * mosaic.astype(np.uint8)))[8, 8]
    assert middle.tolist() == [0, 200, 0]


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_a_camera_of_few_bits_in_sixteen_fills_eight(bits):
    pixels = np.linspace(0, 2**bits - 1, 35).reshape(5, 7).astype("<u2")
    found = read_bgr(image("mono16", pixels))[..., 0]
    assert np.array_equal(found, pixels >> (bits - 8))


def test_colour_of_yuv_is_in_its_order():
    """Blue has much U, red much V."""
    color = np.zeros((4, 4, 3), np.uint8)
    color[..., 2] = 255
    for encoding, code in (
        ("yuv422", cv2.COLOR_BGR2YUV_UYVY),
        ("yuv422_yuy2", cv2.COLOR_BGR2YUV_YUY2),
    ):
        found = read_bgr(image(encoding, cv2.cvtColor(color, code)))
        assert np.abs(found.astype(int) - color).max() <= 2


def test_raw_and_compressed_images_of_foxglove_are_read_like_those_of_ros():
    raw = image("rgb8", COLOR[..., ::-1])
    raw.__msgtype__ = "foxglove_msgs/msg/RawImage"
    del raw.is_bigendian
    assert np.array_equal(read_bgr(raw), COLOR)
    png = compressed(cv2.imencode(".png", COLOR)[1].tobytes(), "png")
    png.__msgtype__ = "foxglove_msgs/msg/CompressedImage"
    assert np.array_equal(read_bgr(png), COLOR)


def test_the_last_row_may_do_without_its_padding():
    message = image("rgb8", COLOR[..., ::-1], 12)
    message.data = message.data[:-12]
    assert np.array_equal(read_bgr(message), COLOR)


def test_a_compressed_png_of_sixteen_bits_keeps_what_eight_can_hold():
    data = cv2.imencode(".png", GREY.astype(np.uint16) << 4)[1].tobytes()
    assert np.array_equal(read_bgr(compressed(data, "mono16; png compressed ")), GREY3)


def test_a_mosaic_that_was_compressed_as_grey_has_its_colours():
    mosaic = np.zeros((16, 16), np.uint8)
    mosaic[::2, ::2] = 200
    data = cv2.imencode(".png", mosaic)[1].tobytes()
    found = read_bgr(compressed(data, "bayer_rggb8; png compressed "))
    assert found[8, 8].tolist() == [0, 0, 200]


def test_depths_are_refused_in_words():
    with pytest.raises(
        MessageError, match="images of format compressedDepth hold depths. Name the"
    ):
        read_bgr(compressed(b"x" * 99, "16UC1; compressedDepth png"))


def test_video_in_a_compressed_image_is_refused_with_what_to_do():
    with pytest.raises(MessageError, match="Republish the video as images, record those, and name"):
        read_bgr(compressed(b"\x00\x00\x00\x01g" * 99, "h264"))


def test_a_jpeg_that_is_cut_short_is_no_image():
    data = cv2.imencode(".jpg", cv2.resize(COLOR, (640, 480)))[1].tobytes()
    assert read_bgr(compressed(data + b"\x00" * 100)).shape == (480, 640, 3)
    with pytest.raises(MessageError, match="a JPEG of 640 x 480 px that is cut short"):
        read_bgr(compressed(data[: len(data) * 2 // 3]))


# --- hostile input


@pytest.mark.parametrize(
    "change",
    [
        {"height": 2**32 - 1},
        {"width": 2**32 - 1},
        {"step": 20},
        {"step": 2**31},
        {"step": 0},
        {"height": 0},
        {"width": 0},
        {"data": np.zeros(104, np.uint8)},
        {"data": np.zeros(0, np.uint8)},
    ],
)
def test_sizes_that_the_data_do_not_hold_are_refused_before_memory_is_taken(change):
    message = image("bgr8", COLOR)
    vars(message).update(change)
    tracemalloc.start()
    with pytest.raises(MessageError) as caught:
        read_bgr(message)
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    size = f"{message.width} x {message.height} px, bgr8, with rows of {message.step} bytes"
    assert f"an image of {size} and {len(message.data)} in all" in str(caught.value)
    assert taken < 1e6


def test_a_few_bytes_that_claim_to_be_a_huge_image_are_refused_before_memory_is_taken():
    data = bytearray(cv2.imencode(".png", GREY)[1].tobytes())
    data[16:24] = (40_000).to_bytes(4, "big") * 2
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    tracemalloc.start()
    with pytest.raises(MessageError):
        read_bgr(compressed(bytes(data)))
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert taken < 1e6


SIZES = st.one_of(st.integers(0, 40), st.sampled_from([2**31, 2**32 - 1]))


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from(sorted(PIXEL_ENCODINGS)),
    st.fixed_dictionaries({}, optional={k: SIZES for k in ("height", "width", "step")}),
    st.integers(0, 4000),
    st.booleans(),
)
def test_any_header_gives_an_image_or_one_clean_error(encoding, sizes, count, big):
    message = image(encoding, EVEN)
    vars(message).update(sizes, is_bigendian=big, data=np.arange(count, dtype=np.uint32).view("u1"))
    message.data = message.data[:count]
    try:
        found = read_bgr(message)
    except MessageError:
        return
    assert found.shape == (message.height, message.width, 3)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 255), st.sampled_from([".png", ".jpg"]))
def test_any_damage_of_a_compressed_image_gives_an_image_or_one_clean_error(at, value, kind):
    data = bytearray(cv2.imencode(kind, COLOR)[1].tobytes())
    data[at % len(data)] = value
    try:
        found = read_bgr(compressed(bytes(data)))
    except MessageError:
        return
    assert found.ndim == 3 and found.shape[2] == 3


# --- regions of images


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 99), st.booleans())
@settings(max_examples=40, deadline=None)
def test_png_is_lossless_in_grey_and_in_colour(height, width, seed, is_grey):
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)
    if is_grey:
        pixels = np.repeat(pixels[..., :1], 3, 2)
    assert np.array_equal(decode_png(encode_png(pixels)), pixels)


def test_a_grey_region_is_kept_in_one_channel():
    grey, color = (np.tile(a, (20, 20, 1)) for a in (GREY3, COLOR))
    assert len(encode_png(grey)) < 0.5 * len(encode_png(color))


def test_a_region_cut_out_of_an_image_is_kept_exactly():
    region = COLOR[1:4, 2:6]
    assert np.array_equal(decode_png(encode_png(region)), region)


def test_grey_of_equal_channels_is_that_channel():
    assert np.array_equal(to_grey(GREY3), GREY)
