"""sensor_msgs/CameraInfo as a camera block: model, size_px and params.

To add a distortion model of ROS: one line in DISTORTION_MODELS.
"""

import re
from typing import Any, NamedTuple

import numpy as np

from calib.io.safe_names import plain_text
from calib.io.status import failure_status

CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"


class Distortion(NamedTuple):
    """Our lens model for a distortion model of ROS, and how many numbers of D it takes."""

    model: str
    n_values: int


RADTAN_DISTORTION = Distortion("radtan", 5)
FISHEYE_DISTORTION = Distortion("kannala_brandt", 4)
DISTORTION_MODELS: dict[str, Distortion] = {
    "plumb_bob": RADTAN_DISTORTION,
    "radtan": RADTAN_DISTORTION,
    # Its first five are those of plumb_bob; the rest has to be zero.
    "rational_polynomial": RADTAN_DISTORTION,
    "equidistant": FISHEYE_DISTORTION,
    "fisheye": FISHEYE_DISTORTION,
    "kannala_brandt": FISHEYE_DISTORTION,
}
NO_DISTORTION_NAMES = ("", "none")
NO_DISTORTION = [0.0] * 4  # radtan without its optional k3
RECTIFIED_TOPIC_PATTERN = re.compile(r"(^|[/_])rect(ified)?([/_]|$)")


class CameraInfoError(Exception):
    """A CameraInfo from which no camera block can be made, with the failed status."""

    def __init__(self, reason: str, found: object, expected: object, remedy: str) -> None:
        self.status = failure_status(reason, found, expected, remedy)
        super().__init__(str(self.status))


def flatten_camera_info(message: Any) -> np.ndarray:
    """Return all numbers (n,) of a CameraInfo that describe the lens, K first."""
    parts = [_read_field(message, k).ravel() for k in "kdrp"]
    roi = message.roi
    sizes = message.width, message.height, message.binning_x, message.binning_y
    return np.concatenate([*parts, sizes, (roi.x_offset, roi.y_offset, roi.width, roi.height)])


def is_rectified_topic(topic: str) -> bool:
    """Whether a topic holds rectified images, by the names that image_proc gives."""
    return RECTIFIED_TOPIC_PATTERN.search(topic) is not None


def camera_block_from_info(message: Any, rectified: bool) -> tuple[dict[str, Any], str]:
    """Return the camera block of a CameraInfo for raw or rectified images, and its source in words.

    Binning and region of interest are those of the message. Raises CameraInfoError if there is no
    such block.
    """
    name = plain_text(message.distortion_model.strip().lower())
    K = np.reshape(_read_field(message, "k"), (3, 3))
    P = np.reshape(_read_field(message, "p"), (3, 4))
    matrix = P[:, :3] if rectified else K
    if not (np.isfinite(matrix).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise CameraInfoError(
            f"CameraInfo holds no {'P' if rectified else 'K'}",
            found=f"fx {matrix[0, 0]:g}, fy {matrix[1, 1]:g}",
            expected="focal lengths above 0",
            remedy="Calibrate the camera and record its CameraInfo, or write model, size_px and "
            "params.",
        )
    if rectified:
        model, distortion = RADTAN_DISTORTION.model, NO_DISTORTION
        source = _describe_rectification(message)
    else:
        model, distortion = _distortion_parameters(name, message)
        source = f"K and D of CameraInfo ({name or 'no model'})"
    matrix, size = _apply_binning_and_roi(matrix, message)
    fx, fy, cx, cy = (float(matrix[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    block = {"model": model, "size_px": size, "params": [fx, fy, cx, cy, *distortion]}
    return block, source


def _read_field(message: Any, name: str) -> np.ndarray:
    """Return a field whose name ROS 1 writes with a capital."""
    return np.asarray(getattr(message, name, getattr(message, name.upper(), None)), float)


def _distortion_parameters(name: str, message: Any) -> tuple[str, list[float]]:
    """Return the lens model of a CameraInfo and its distortion parameters."""
    d = _read_field(message, "d").ravel()
    is_radtan = DISTORTION_MODELS.get(name) == RADTAN_DISTORTION
    if not d.any() and (is_radtan or name in NO_DISTORTION_NAMES):
        return RADTAN_DISTORTION.model, NO_DISTORTION
    if name not in DISTORTION_MODELS:
        raise CameraInfoError(
            "the distortion model of CameraInfo is not supported",
            found=name or "no name",
            expected=", ".join(DISTORTION_MODELS),
            remedy="Write model, size_px and params of a supported model.",
        )
    model, count = DISTORTION_MODELS[name]
    if not np.isfinite(d).all():
        raise CameraInfoError(
            "D of CameraInfo is not finite",
            found=_describe_distortion(d),
            expected=f"{count} numbers",
            remedy="Calibrate the camera again, or write model, size_px and params.",
        )
    if d[count:].any():
        raise CameraInfoError(
            f"D of CameraInfo ({name}) has more parameters than {model}",
            found=_describe_distortion(d),
            expected=f"zeros after the first {count}",
            remedy="Calibrate with plumb_bob, or use the rectified images, whose P needs no D.",
        )
    padded = np.append(d[:count], np.zeros(max(0, count - len(d))))
    # radtan's fifth may be left out.
    return model, padded[: 4 if model == "radtan" and not padded[4] else count].tolist()


def _describe_distortion(d: np.ndarray) -> str:
    return "D " + " ".join(f"{v:g}" for v in d)


def describe_camera_info(message: Any) -> str:
    """Describe fx fy cx cy and D of a CameraInfo."""
    K = _read_field(message, "k").ravel()
    focal_and_centre = " ".join(f"{K[i]:g}" for i in (0, 4, 2, 5))
    return f"{focal_and_centre}, {_describe_distortion(_read_field(message, 'd').ravel())}"


def _apply_binning_and_roi(matrix: np.ndarray, message: Any) -> tuple[np.ndarray, list[int]]:
    """Return K (3, 3) and [width, height] after binning and region of interest."""
    roi = message.roi
    size = np.array([roi.width or message.width, roi.height or message.height])
    bins = np.maximum([message.binning_x, message.binning_y], 1)
    K, first = matrix.copy(), np.array([roi.x_offset, roi.y_offset])
    # A binned pixel's centre is the middle of the pixels that it is made of.
    K[:2, 2] = (K[:2, 2] - first - (bins - 1) / 2) / bins
    K[[0, 1], [0, 1]] /= bins
    return K, (size // bins).tolist()


def _describe_rectification(message: Any) -> str:
    R = np.reshape(_read_field(message, "r"), (3, 3))
    # Drivers without a rectification leave zeros.
    R = R if R.any() else np.eye(3)
    angle_deg = np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1)))
    return (
        "P of CameraInfo, for rectified images: the pose is that of the rectified camera, "
        f"rotated by {angle_deg:.2f}° from the raw one"
    )
