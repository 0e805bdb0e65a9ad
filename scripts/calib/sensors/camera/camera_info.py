"""sensor_msgs/CameraInfo as a camera block: model, size_px and params.

To add a distortion model of ROS: one line in MODELS.
"""

import re

import numpy as np

from calib.io.status import failure_status

CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"

RADTAN_DISTORTION, FISHEYE_DISTORTION = (
    ("radtan", 5),
    ("kannala_brandt", 4),
)  # model, and its distortion's numbers
DISTORTION_MODELS = {
    "plumb_bob": RADTAN_DISTORTION,
    "radtan": RADTAN_DISTORTION,
    # Its first five are those of plumb_bob; the rest has to be zero.
    "rational_polynomial": RADTAN_DISTORTION,
    "equidistant": FISHEYE_DISTORTION,
    "fisheye": FISHEYE_DISTORTION,
    "kannala_brandt": FISHEYE_DISTORTION,
}
RECTIFIED_TOPIC_PATTERN = re.compile(r"(^|[/_])rect(ified)?([/_]|$)")


class CameraInfoError(Exception):
    """No camera block of a CameraInfo, with the failed Status of (reason, found, expected,
    remedy)."""

    def __init__(self, *parts):
        self.status = failure_status(*parts)
        super().__init__(str(self.status))


def flatten_camera_info(message):
    """(n,) all that a CameraInfo says of the lens: K first."""
    parts = [_read_field(message, k).ravel() for k in "kdrp"]
    roi = message.roi
    sizes = message.width, message.height, message.binning_x, message.binning_y
    return np.concatenate([*parts, sizes, (roi.x_offset, roi.y_offset, roi.width, roi.height)])


def is_rectified_topic(topic):
    """Whether an image topic is one of rectified images, by the names that image_proc gives."""
    return RECTIFIED_TOPIC_PATTERN.search(topic) is not None


def camera_block_from_info(message, rectified):
    """(camera block, in words what it was made of) of a CameraInfo for raw or rectified images.

    Binning and region of interest are those of the message. Raises CameraInfoError where there is
    no such block.
    """
    name = message.distortion_model.strip().lower()
    K, P = (
        np.reshape(_read_field(message, "k"), (3, 3)),
        np.reshape(_read_field(message, "p"), (3, 4)),
    )
    matrix = P[:, :3] if rectified else K
    if not (np.isfinite(matrix).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise CameraInfoError(
            f"CameraInfo holds no {'P' if rectified else 'K'}",
            f"fx {matrix[0, 0]:g}, fy {matrix[1, 1]:g}",
            "focal lengths above 0",
            "Calibrate the camera and record its CameraInfo, or write model, size_px and params.",
        )
    model, distortion = (
        ("radtan", [0.0] * 4) if rectified else _distortion_parameters(name, message)
    )
    matrix, size = _apply_binning_and_roi(matrix, message)
    fx, fy, cx, cy = (float(matrix[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    words = (
        _describe_rectification(message)
        if rectified
        else f"K and D of CameraInfo ({name or 'no model'})"
    )
    made = {"model": model, "size_px": size, "params": [fx, fy, cx, cy, *distortion]}
    return made, words


def _read_field(message, name):
    """A field whose name ROS 1 writes with a capital."""
    return np.asarray(getattr(message, name, getattr(message, name.upper(), None)), float)


def _distortion_parameters(name, message):
    """(model, its distortion parameters)."""
    d = _read_field(message, "d").ravel()
    if not d.any() and name in (
        "",
        "none",
        *(k for k, v in DISTORTION_MODELS.items() if v == RADTAN_DISTORTION),
    ):
        return "radtan", [0.0] * 4
    if name not in DISTORTION_MODELS:
        raise CameraInfoError(
            "CameraInfo of another distortion model",
            name or "no name",
            ", ".join(DISTORTION_MODELS),
            "Write model, size_px and params of a model that this version knows.",
        )
    model, count = DISTORTION_MODELS[name]
    if not np.isfinite(d).all():
        raise CameraInfoError(
            "CameraInfo whose D is no number",
            _describe_distortion(d),
            f"{count} numbers",
            "Calibrate the camera anew, or write model, size_px and params.",
        )
    if d[count:].any():
        raise CameraInfoError(
            f"CameraInfo whose {name} has more than {model} holds",
            _describe_distortion(d),
            f"zeros after the first {count}",
            "Calibrate with plumb_bob, or use the rectified images, whose P holds without D.",
        )
    padded = np.append(d[:count], np.zeros(max(0, count - len(d))))
    # radtan's fifth may be left out.
    return model, padded[: 4 if model == "radtan" and not padded[4] else count].tolist()


def _describe_distortion(d):
    return "D " + " ".join(f"{v:g}" for v in d)


def describe_camera_info(message):
    """fx fy cx cy and D of a CameraInfo, in words."""
    K = _read_field(message, "k").ravel()
    return (
        " ".join(f"{K[i]:g}" for i in (0, 4, 2, 5))
        + ", "
        + _describe_distortion(_read_field(message, "d").ravel())
    )


def _apply_binning_and_roi(matrix, message):
    """(K (3, 3), [width, height]) of what binning and region of interest leave of the image."""
    roi = message.roi
    size = np.array([roi.width or message.width, roi.height or message.height])
    bins = np.maximum([message.binning_x, message.binning_y], 1)
    K, first = matrix.copy(), np.array([roi.x_offset, roi.y_offset])
    # A binned pixel's centre is the middle of the pixels that it is made of.
    K[:2, 2] = (K[:2, 2] - first - (bins - 1) / 2) / bins
    K[[0, 1], [0, 1]] /= bins
    return K, (size // bins).tolist()


def _describe_rectification(message):
    R = np.reshape(_read_field(message, "r"), (3, 3))
    # Where there is none, drivers leave zeros.
    R = R if R.any() else np.eye(3)
    turned = np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1)))
    return (
        "P of CameraInfo, for rectified images: the pose found is that of the rectified camera, "
        f"turned by {turned:.2f}° against the raw one"
    )
