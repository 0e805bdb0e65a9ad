"""Whether an extraction found nothing, or what is absurd: then the config holds a mistake."""

import numpy as np

from calib.extraction.extraction_results import Extraction
from calib.geometry.se3 import invert_pose, se3_log
from calib.views.target_placements import Columns

# Farther from the guess in one component, in its σ, the pose of a sensor is absurd.
MAX_GUESS_SIGMAS = 10.0
MIN_AGREEING_SHARE = 0.5  # of the views of a target that should show it
MIN_VIEWS = 3


def find_lost_targets(
    extraction: Extraction, views: Columns, T_guess: np.ndarray | None, guess_sigma: np.ndarray
) -> list[str]:
    """Return the targets that a sensor does not agree with.

    All of them if nothing was found, or far from the guess. views: columns of views.parquet;
    T_guess (4, 4), None if there is none, guess_sigma (6,): T_robot_sensor.
    """
    every = sorted(set(views["target"]))
    if T_guess is None or extraction.T_robot_sensor is None:
        return every
    shift = se3_log(invert_pose(T_guess) @ extraction.T_robot_sensor)
    if (np.abs(shift) > MAX_GUESS_SIGMAS * guess_sigma).any():
        return every
    wanted = np.array([o.view for o in extraction.outcomes if o.is_wanted], int)
    target = np.asarray(views["target"])[np.searchsorted(views["view"], wanted)]
    agrees = np.isin(wanted, list(extraction.agreeing_views))
    return [
        name
        for name in every
        if (target == name).sum() >= MIN_VIEWS
        and agrees[target == name].mean() < MIN_AGREEING_SHARE
    ]
