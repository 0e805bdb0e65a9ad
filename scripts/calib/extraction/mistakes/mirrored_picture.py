"""Pictures that the camera or its driver mirrors."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.geometry.se3 import make_pose

HALF_TURN = make_pose(np.diag([-1.0, -1.0, 1.0]))  # about the optical axis


def correct_mirrored_pictures(stated: StatedSetup) -> Iterator[ConfigCorrection]:
    """Yield the setups with pictures mirrored left to right or top to bottom (see Mistake).

    Top to bottom is left to right, seen by a camera that is turned by half a turn.
    """
    if not stated.images:
        return
    mirrored = replace(stated, is_mirrored=True)
    yield _describe_mirror(mirrored, "left to right")
    if stated.T_robot_sensor is not None:
        turned = replace(mirrored, T_robot_sensor=stated.T_robot_sensor @ HALF_TURN)
        yield _describe_mirror(turned, "top to bottom")


def _describe_mirror(setup: StatedSetup, direction: str) -> ConfigCorrection:
    return ConfigCorrection(
        setup,
        f"the images of {setup.sensor} are mirrored {direction}",
        f"Switch off the mirror image (flip) in the driver of {setup.sensor}, and record again.",
    )
