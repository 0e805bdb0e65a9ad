"""A sensor's pose as the stage guess found it, or why there is none."""

from dataclasses import dataclass

import numpy as np

from calib.io.status import OK, Status


@dataclass(frozen=True)
class PoseGuess:
    """T_robot_sensor (4, 4), its σ (6,), m and rad, and in words what agrees on it; or None with
    the status that says why."""

    T_robot_sensor: np.ndarray | None = None
    sigma: np.ndarray | None = None
    basis: str = ""
    status: Status = OK
