"""When mistakes are looked for: nothing is found, or far from the guess, or little that agrees."""

import numpy as np

from calib.extraction.extraction_results import Extraction, ViewOutcome
from calib.extraction.mistakes.lost_agreement import find_lost_targets
from calib.geometry.se3 import se3_exp
from calib.io.parquet_tables import empty_columns
from calib.io.status import OK, failure_status
from calib.io.table_schemas import KEYPOINTS_SCHEMA

SIGMA = np.repeat([0.02, np.radians(3)], 3)
VIEWS = {"view": np.arange(12), "target": np.array(["board"] * 6 + ["cylinder"] * 6, object)}
NOT_FOUND = failure_status("no checkerboard in the region")


def lost(agreeing, T=None, unwanted=(), T_guess=None):
    """Targets that are lost if so many of the views 0-5 (board) and 6-11 (cylinder) agree."""
    outcomes = [
        ViewOutcome(k, OK if k in agreeing else NOT_FOUND, k not in unwanted) for k in range(12)
    ]
    pose = np.eye(4) if T is None else T
    found = Extraction(empty_columns(KEYPOINTS_SCHEMA), outcomes, pose, frozenset(agreeing))
    return find_lost_targets(found, VIEWS, np.eye(4) if T_guess is None else T_guess, SIGMA)


def test_views_that_agree_near_the_guess_lose_nothing():
    assert lost(range(12)) == [] and lost(range(3, 12)) == []


def test_a_target_that_agrees_in_less_than_half_of_its_views_is_lost():
    assert lost(range(4, 12)) == ["board"] and lost(range(0, 8)) == ["cylinder"]


def test_views_out_of_sight_do_not_count():
    assert lost(range(4, 12), unwanted=range(0, 3)) == []
    assert lost(range(6, 12), unwanted=range(0, 4)) == []  # two views are too few to tell


def test_a_pose_11_sigma_from_the_guess_loses_all_and_one_9_sigma_away_none():
    for axis in range(6):
        direction = np.eye(6)[axis] * SIGMA
        assert lost(range(12), se3_exp(11 * direction)) == ["board", "cylinder"]
        assert lost(range(12), se3_exp(9 * direction)) == []


def test_nothing_found_loses_all_targets():
    nothing = Extraction.empty()
    assert find_lost_targets(nothing, VIEWS, np.eye(4), SIGMA) == ["board", "cylinder"]
    assert find_lost_targets(nothing, VIEWS, None, SIGMA) == ["board", "cylinder"]
