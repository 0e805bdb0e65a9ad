"""CameraInfo as a camera's lens: models of ROS, raw and rectified, binning, and what is refused."""

from types import SimpleNamespace
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from calib.decoding.sensor_probe import CameraProbe
from calib.sensors.camera import camera_info_reader
from calib.sensors.camera.camera_info_reader import (
    CameraInfoError,
    camera_block_from_info,
    is_rectified_topic,
)
from calib.sensors.camera.camera_info_writer import make_camera_info_message
from calib.sensors.camera.camera_model import CameraModel

STAMP = 1_700_000_000_000_000_000
K = [800.0, 0, 450, 0, 790, 350, 0, 0, 1]
D = [-0.28, 0.09, 0.0006, -0.0004, 0.01]
P = [700.0, 0, 440, -70, 0, 700, 360, 0, 0, 0, 1, 0]
R = cv2.Rodrigues(np.radians([0, 3.0, 0]))[0].ravel()


class Recorded(NamedTuple):
    """A message of a log, as far as a camera looks at it."""

    content: object


def message(name="plumb_bob", d=D, **changes):
    """CameraInfo of 900 x 700 px."""
    roi = dict.fromkeys(("x_offset", "y_offset", "width", "height"), 0) | changes.pop("roi", {})
    fields = {
        "width": 900, "height": 700, "distortion_model": name, "d": np.array(d, float),
        "k": np.array(K), "r": R, "p": np.array(P), "binning_x": 0, "binning_y": 0,
    }  # fmt: skip
    return SimpleNamespace(**(fields | changes), roi=SimpleNamespace(**roi))


@pytest.mark.parametrize(
    "name, d, model, distortion",
    [
        ("plumb_bob", D, "radtan", D),
        ("plumb_bob", D[:4], "radtan", D[:4]),
        ("plumb_bob", [*D[:4], 0], "radtan", D[:4]),
        ("plumb_bob", [], "radtan", [0, 0, 0, 0]),
        ("", [0, 0, 0, 0, 0], "radtan", [0, 0, 0, 0]),
        ("rational_polynomial", [*D, 0, 0, 0], "radtan", D),
        ("equidistant", [0.1, 0.02, -0.003, 0.001], "kannala_brandt", [0.1, 0.02, -0.003, 0.001]),
        ("fisheye", [0.1, 0, 0, 0], "kannala_brandt", [0.1, 0, 0, 0]),
        ("equidistant", [], "kannala_brandt", [0, 0, 0, 0]),
    ],
)
def test_k_and_d_hold_for_raw_images(name, d, model, distortion):
    block, words = camera_block_from_info(message(name, d), rectified=False)
    assert block == {
        "model": model, "size_px": [900, 700], "params": [800, 790, 450, 350, *distortion],
    }  # fmt: skip
    assert words == f"K and D of CameraInfo ({name or 'no model'})"
    CameraModel(block["model"], tuple(block["params"]), tuple(block["size_px"]))


@pytest.mark.parametrize("name, project", [("plumb_bob", cv2.projectPoints),
                                           ("equidistant", cv2.fisheye.projectPoints)])  # fmt: skip
def test_the_camera_projects_as_opencv_does_with_that_camera_info(name, project):
    d = D if name == "plumb_bob" else D[:4]
    p = np.random.default_rng(0).uniform([-1, -1, 2], [1, 1, 4], (50, 3))
    block, _ = camera_block_from_info(message(name, d), rectified=False)
    lens = CameraModel(block["model"], tuple(block["params"]), tuple(block["size_px"]))
    uv, ok = lens.project(p)
    at = p.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), np.reshape(K, (3, 3)), np.array(d)
    assert ok.all() and np.abs(uv - project(*at)[0].reshape(-1, 2)).max() < 1e-9


def test_p_holds_for_rectified_images_and_the_turn_is_told():
    """The shift of a right camera in P is where it sits, no part of its lens."""
    block, words = camera_block_from_info(message(), rectified=True)
    assert block == {"model": "radtan", "size_px": [900, 700],
                     "params": [700, 700, 440, 360, 0, 0, 0, 0]}  # fmt: skip
    assert "rotated by 3.00° from the raw one" in words
    assert "rotated by 0.00°" in camera_block_from_info(message(r=np.zeros(9)), rectified=True)[1]


@pytest.mark.parametrize(
    "topic, rectified",
    [
        ("/left/image_raw", False),
        ("/left/image_rect", True),
        ("/left/image_rect_color/compressed", True),
        ("/left/rect/image", True),
        ("/left/rectified", True),
        ("/camera/infra1/image_rect_raw", True),
        ("/directory/image", False),
        ("/correct/image", False),
    ],
)
def test_the_name_of_a_topic_tells_rectified_images(topic, rectified):
    assert is_rectified_topic(topic) == rectified


def test_fields_of_ros_1_have_capitals():
    one = message()
    for name in "kdrp":
        setattr(one, name.upper(), getattr(one, name))
        delattr(one, name)
    assert camera_block_from_info(one, False)[0]["params"] == [800, 790, 450, 350, *D]


def test_binning_and_a_region_move_the_middle_of_pixels():
    """A point on full pixel (u, v) lies on binned pixel ((u - x - 0.5) / 2, ...) of a region at x:
    full pixels 100 and 101 make binned pixel 0 of a region that begins at 100."""
    roi = {"x_offset": 100, "y_offset": 40, "width": 600, "height": 400}
    block, _ = camera_block_from_info(message(binning_x=2, binning_y=2, roi=roi), rectified=False)
    assert block["size_px"] == [300, 200]
    assert block["params"][:4] == [400, 395, (450 - 100 - 0.5) / 2, (350 - 40 - 0.5) / 2]


@pytest.mark.parametrize(
    "changes, reason, found",
    [
        ({"name": "ftheta"}, "the distortion model of CameraInfo is not supported", "ftheta"),
        (
            {"name": "rational_polynomial", "d": [*D, 0.1, 0, 0]},
            "D of CameraInfo (rational_polynomial) has more parameters than radtan",
            "D -0.28 0.09 0.0006 -0.0004 0.01 0.1 0 0",
        ),
        ({"k": np.zeros(9)}, "CameraInfo holds no K", "fx 0, fy 0"),
        ({"k": np.full(9, np.nan)}, "CameraInfo holds no K", "fx nan, fy nan"),
        ({"d": [np.nan, 0, 0, 0]}, "D of CameraInfo is not finite", "D nan 0 0 0"),
    ],
)
def test_what_no_model_holds_is_refused_with_what_to_do(changes, reason, found):
    with pytest.raises(CameraInfoError) as caught:
        camera_block_from_info(message(**changes), rectified=False)
    status = caught.value.status
    assert status.reason == reason and found in status.found and not status.ok
    assert "params" in status.remedy or "rectified images" in status.remedy


def test_a_rectified_image_without_p_is_refused():
    with pytest.raises(CameraInfoError, match="CameraInfo holds no P"):
        camera_block_from_info(message(p=np.zeros(12)), rectified=True)


def test_what_the_simulator_publishes_comes_back():
    lens = CameraModel(
        "radtan", (802.3, 801.1, 452.6, 347.9, -0.1, 0.02, 0.001, -0.002), (900, 700)
    )
    block, _ = camera_block_from_info(
        make_camera_info_message(STAMP, "left", lens), rectified=False
    )
    assert CameraModel(block["model"], tuple(block["params"]), tuple(block["size_px"])) == lens


# --- what the audit says of a camera

TOPICS = {
    "/left/camera_info": (camera_info_reader.CAMERA_INFO_TYPE, 9),
    "/left/image_raw": ("sensor_msgs/msg/Image", 9),
}
CONFIG = {"kind": "camera", "topic": "/left/image_raw", "camera_info": "/left/camera_info"}


def picture(width=900, height=700, encoding="mono8"):
    data = np.zeros(width * height, np.uint8)
    return SimpleNamespace(__msgtype__="sensor_msgs/msg/Image", width=width, height=height,
                           step=width, encoding=encoding, is_bigendian=0, data=data)  # fmt: skip


def told(*infos, config=(), image=None):
    """(audit, status) of a camera that sent an image and these CameraInfo."""
    camera = CameraProbe(CONFIG | dict(config))
    camera.add_message(Recorded(picture() if image is None else image))
    for one in infos:
        camera.add_camera_info(one)
    return camera.audit(1e8, TOPICS)


def test_the_audit_holds_the_lens_and_says_where_it_comes_from():
    audit, status = told(message(), message())
    assert status.ok and audit["camera"]["params"] == [800, 790, 450, 350, *D]
    assert audit["inferred"]["image"] == "mono8, 900 x 700 px"
    assert audit["inferred"]["lens"] == "K and D of CameraInfo (plumb_bob)"


def test_rectified_may_be_stated_against_the_name_of_the_topic():
    assert told(message(), config={"rectified": True})[0]["camera"]["params"][0] == 700


@pytest.mark.parametrize(
    "case, reason, found, remedy",
    [
        (
            lambda: told(),
            "no CameraInfo on /left/camera_info",
            "CameraInfo on /left/camera_info",
            "Correct camera_info, or set model, size_px and params.",
        ),
        (
            lambda: told(message(), message(k=np.array([801.0, *K[1:]]))),
            "/left/camera_info changes within the log",
            "800 790 450 350, D -0.28 0.09 0.0006 -0.0004 0.01 and 801 790 450 350, D -0.28",
            "Limit the session by from_s and to_s, or set model, size_px and params.",
        ),
        (
            lambda: told(message(), config={"model": "kannala_brandt"}),
            "CameraInfo has another model than the rig",
            "radtan",
            "Remove model from the rig",
        ),
        (
            lambda: told(message(), config={"size_px": [640, 480]}),
            "CameraInfo has another size_px than the rig",
            "[900, 700]",
            "Remove size_px from the rig",
        ),
        (
            lambda: told(message(), image=picture(450, 350)),
            "images and /left/camera_info differ in size",
            "images of 450 x 350 px",
            "Set camera_info to the topic published with these images",
        ),
        (
            lambda: told(message(), image=picture(encoding="32FC1")),
            "images that cannot be read",
            "image encoding 32FC1 is not supported; expected one of mono8",
            "Check the topic",
        ),
    ],
)
def test_a_lens_that_cannot_be_told_fails_with_what_was_found_and_what_to_do(
    case, reason, found, remedy
):
    _, status = case()
    assert not status.ok and status.reason == reason
    assert found in status.found and remedy in status.remedy


def test_the_first_damaged_image_does_not_hide_the_next():
    camera = CameraProbe({"kind": "camera", "topic": "/left/image_raw"})
    damaged = picture()
    damaged.data = damaged.data[:9]
    for one in (damaged, picture()):
        camera.add_message(Recorded(one))
    audit, status = camera.audit(1e8, {})
    assert status.ok and audit == {
        "inferred": {"image": "mono8, 900 x 700 px"},
        "image_size_px": [900, 700],
    }
