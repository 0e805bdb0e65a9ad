"""Covariance by choice: what halves of the placements that adopt other corrections would move.

If the corrections that both halves adopt are the same, the choice is certain. Otherwise all
placements are estimated with either choice. The result is no more certain than these two differ:
½ Σ δ δᵀ over both, δ from the result to the pose with that choice, is the sample variance of two
results; its mean over many recordings is p (1 - p) δ δᵀ, p being how often a correction is adopted.
"""

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np

from calib.diagnosis.error_search.supported_corrections import (
    MOUNT,
    Choice,
    list_adopted_corrections,
)
from calib.diagnosis.split_halves import HalfEstimate
from calib.estimation.corrections.correction_catalog import list_testable_corrections
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.solver import continue_estimate
from calib.geometry.se3 import invert_pose, se3_log


def choice_covariance(
    requested: Setup,
    estimate: tuple[Setup, EstimationResult],
    halves: tuple[HalfEstimate, HalfEstimate] | None,
    **limits: Any,
) -> np.ndarray:
    """Return the covariance (m, m) of sensor poses and mounts that the choice of corrections adds.

    requested: the Setup before corrections were adopted; estimate: that with them, and its result;
    limits: of estimate_poses.
    """
    setup, result = estimate
    m = setup.n_pose_unknowns
    if halves is None or halves[0].adopted == halves[1].adopted or result.solve_result is None:
        return np.zeros((m, m))
    adopted = list_adopted_corrections(requested, setup)
    shifts = [np.zeros(m)]
    for half in halves:
        if half.adopted != adopted:
            other = with_choice(setup, adopted, half.adopted)
            other_result = continue_estimate(other, (setup, result), **limits)
            shifts.append(pose_shifts(setup, result, other, other_result))
    return np.sum([np.outer(shift, shift) for shift in shifts], axis=0) / 2


def with_choice(setup: Setup, adopted: Collection[Choice], choice: Collection[Choice]) -> Setup:
    """Return the Setup with the corrections of a choice instead of the adopted ones.

    What the Setup already estimates keeps its place.
    """
    dropped = set(adopted) - set(choice)
    out = replace(
        setup,
        corrections=tuple(c for c in setup.corrections if (c.name, c.subject) not in dropped),
        initial_mounts={n: T for n, T in setup.initial_mounts.items() if (MOUNT, n) not in dropped},
    )
    for correction in list_testable_corrections(out):
        if (correction.name, correction.subject) in choice:
            out = correction.add_to_setup(out) or out
    return out


def pose_shifts(
    setup: Setup, result: EstimationResult, other: Setup, other_result: EstimationResult
) -> np.ndarray:
    """Return the twists (m,) from the poses of a result to those of another, mounts after sensors.

    A mount that the other does not estimate is where its config says.
    """
    configured = {p.target: p.T_body_target for p in reversed(other.placements)}
    pairs = [
        (result.state.T_robot_sensor[n], other_result.state.T_robot_sensor[n])
        for n in sorted(setup.models)
    ]
    pairs += [
        (result.state.mounts[n], (configured | other_result.state.mounts)[n])
        for n in sorted(setup.initial_mounts)
    ]
    return np.concatenate([se3_log(invert_pose(a) @ b) for a, b in pairs])
