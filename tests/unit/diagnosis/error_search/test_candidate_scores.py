"""Corrections whose values leave the range in which their derivatives hold explain nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.diagnosis.error_search.candidate_scores import ScoreTests
from calib.diagnosis.error_search.score_terms import Candidate
from calib.estimation.corrections.camera.camera_intrinsics import FocalLengthCorrection


@pytest.mark.parametrize(
    ("share", "is_free", "leaves"),
    [(-1.05, True, True), (0.6, True, True), (-0.02, True, False), (-1.05, False, False)],
)
def test_a_focal_length_of_minus_32_px_in_place_of_642_is_no_explanation(share, is_free, leaves):
    focal = Candidate(FocalLengthCorrection("left", 641.9), np.array([6]))
    tests = ScoreTests([focal], {})
    values = np.zeros(7)
    values[6] = share
    free = np.arange(7) if is_free else np.arange(6)
    step = SimpleNamespace(free_index=free, correction_values=values)
    assert tests._leaves_linear_range(step) is leaves
