"""The noise to start from, per kind of measurement and sensor; noise_estimation updates it.

The configured noise of the motion capture is a lower bound; that of the measurements is where the
estimation starts.
"""

from collections.abc import Sequence

import numpy as np

from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.residuals.assignment import Assignment, Noise
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS, uses_template_points

NoiseKey = tuple[str, str]  # sensor (of moving views with a suffix), kind

MAD_TO_SIGMA = 1.4826
INITIAL_NOISE_FACTOR = 3.0  # on what the residuals show at a start that may be wrong
MOVING_VIEW_SUFFIX = " in motion"


def initial_noise(kind: str, factor: float) -> Noise:
    """Return the noise of a kind to start from: factor times the σ of the keypoints.

    Where σ is the step of a scan pattern, it is not scaled, and is common to all repetitions.
    """
    return Noise(factor, 0.0) if RESIDUAL_KINDS[kind].MIN_SIGMA is not None else Noise(0.0, 1.0)


def widen_initial_noise(
    setup: Setup, assignments: Sequence[Assignment], min_noise: dict[NoiseKey, Noise]
) -> dict[NoiseKey, Noise]:
    """Widen noise (min_noise) to what the residuals of all candidates show at a wrong start.

    Nearest template points shift with the start: their noise is left to the first round.
    """
    noise = dict(min_noise)
    for key in min_noise:
        groups = zip(setup.groups, assignments, strict=True)
        values = [a.residual_over_sigma0[a.is_candidate] for g, a in groups if noise_key(g) == key]
        residuals = np.abs(np.concatenate(values))
        if len(residuals) and not uses_template_points(key[1]):
            shown = INITIAL_NOISE_FACTOR * MAD_TO_SIGMA * float(np.median(residuals))
            ratio = max(1.0, shown / min_noise[key].total)
            noise[key] = Noise(*(ratio * part for part in min_noise[key]))
    return noise


def noise_key(group: MeasurementGroup) -> NoiseKey:
    """Return the key of a group's noise; moving views have their own."""
    return group.sensor + (MOVING_VIEW_SUFFIX if group.is_moving else ""), group.kind
