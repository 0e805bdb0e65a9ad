"""Select the placements of a target that a sensor uses: new poses in view, up to a limit."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from calib.io.status import OK, Status, failure_status
from calib.targets.target_shapes import TargetShape
from calib.views.field_of_view import PosedSensor

ENOUGH_PLACEMENTS = "enough placements"
WRONG_IMAGE_SIZE = "image of "  # what reasons against images of another size begin with
NOT_NEW = "not a new pose"


def select_placements(
    sensor: PosedSensor,
    target: TargetShape,
    T_robot_target: Mapping[int, np.ndarray] | np.ndarray,
    numbers: Iterable[int],
    options: dict[str, Any],
    *,
    n_max: int,
) -> dict[int, str]:
    """Return the reason against each placement by number, "" for the selected ones.

    The first n_max of the numbers that are in view are selected. T_robot_target: pose (4, 4) by
    placement number. options: block `crop`.

    Crop calls it with the margin of the initial guess, extract without margin at the working pose,
    and preflight both ways.
    """
    reasons, n_left = {}, n_max
    for number in numbers:
        reason = sensor.reason_against(target, T_robot_target[number], options)
        n_left -= not reason
        reasons[int(number)] = reason or ("" if n_left >= 0 else ENOUGH_PLACEMENTS)
    return reasons


def visibility_status(sensor_name: str, reasons: list[str]) -> Status:
    """Return ok if a view is kept, else why the sensor has none. reasons: "" for the kept views."""
    if "" in reasons:
        return OK
    counts = ", ".join(f"{reasons.count(r)} {r}" for r in sorted(set(reasons)))
    return failure_status(
        f"{sensor_name} has no view of a target",
        counts or "no frame",
        "1 or more",
        _visibility_remedy(reasons),
    )


def _visibility_remedy(reasons: list[str]) -> str:
    """Return what to do if no view is kept for these reasons."""
    if any(reason.startswith(WRONG_IMAGE_SIZE) for reason in reasons):
        return (
            "Set size_px of this sensor to the size of its images, and params to the lens at that "
            "size; or record the CameraInfo of these images."
        )
    if "seen from behind" in reasons:
        return (
            "Turn T_body_target of the board that is seen from behind, if its frame is the wrong "
            "way round. Seen from the front, x points right, y up and z towards the viewer."
        )
    return (
        "Check T_robot_sensor of this sensor and `body` of the targets, or record the targets in "
        "its view."
    )
