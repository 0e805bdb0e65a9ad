"""Repeatability: sensor poses of each session alone, compared with those of the other sessions."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from calib.diagnosis.covariance.cluster_covariance import with_cluster_covariance
from calib.diagnosis.observability import UNDETERMINED_SIGMA
from calib.estimation.corrections.base import ModelCorrection
from calib.estimation.estimate_state import get_correction_values
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.pose_chain import ROBOT_MARKERS
from calib.estimation.round_solution import targets_at_estimate
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import adjoint, invert_pose, se3_exp, se3_log


class SessionPose(NamedTuple):
    """A sensor pose of one session: twist (6,) from the joint pose, and its covariance (6, 6)."""

    twist: np.ndarray
    covariance: np.ndarray


def session_setup(setup: Setup, result: EstimationResult, session: str) -> Setup:
    """Return the setup of the still placements of one session.

    Targets, their shapes and the robot's markers are at the joint estimate: one session alone does
    not determine them.
    """
    indices = [
        i for i, p in enumerate(setup.placements) if p.session == session and p.moving_view is None
    ]
    markers_twist = get_correction_values(setup, result.state, ROBOT_MARKERS, session)
    T_robot_markers = np.eye(4) if markers_twist is None else se3_exp(markers_twist)
    alone = setup.at_placements(indices)
    placements = [
        replace(
            p,
            T_robot_body=T_robot_markers @ p.T_robot_body,
            T_body_target=result.state.mounts.get(p.target, p.T_body_target),
        )
        for p in alone.placements
    ]
    corrections = [c for c in alone.corrections if isinstance(c, ModelCorrection)]
    return replace(
        alone,
        targets=alone.targets | targets_at_estimate(setup, result.state),
        placements=placements,
        groups=[replace(g, initial_features=None) for g in alone.groups],
        initial_mounts={},
        corrections=tuple(corrections),
    )


def session_poses(
    setup: Setup, result: EstimationResult, session: str, **limits: Any
) -> dict[str, SessionPose]:
    """Return the sensor poses of one session alone, of the sensors that it determines.

    limits: of estimate_poses.
    """
    alone = session_setup(setup, result, session)
    start = {n: result.state.T_robot_sensor[n] for n in alone.models}
    estimate = with_cluster_covariance(alone, estimate_poses(alone, start, **limits))
    if estimate.solve_result is None:
        return {}
    covariance, out = estimate.solve_result.covariance, {}
    for i, name in enumerate(sorted(alone.models)):
        block = covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
        variances = np.diag(block)
        is_positive = np.isfinite(variances).all() and (variances > 0).all()
        if is_positive and (variances < UNDETERMINED_SIGMA**2).all():
            shift = invert_pose(start[name]) @ estimate.state.T_robot_sensor[name]
            out[name] = SessionPose(se3_log(shift), block)
    return out


def repeatability_json(
    setup: Setup, result: EstimationResult, **limits: Any
) -> list[dict[str, Any]]:
    """Return [{session, sensor, shift, sigma, n_other_sessions, p_value, markers}], by time.

    [] for one session. shift (6,): of the sensor pose of this session from that of the others, m
    and rad, along the sensor's axes. sigma (6,): of this shift. p_value: of so large a shift if
    nothing moved. markers: {shift (6,), explained_share} of the robot's markers in the robot frame
    that explains the shifts of all sensors of the session best, None for one sensor.
    """
    starts: dict[str, int] = {}
    for p in setup.placements:
        starts[p.session] = min(starts.get(p.session, p.start_ns), p.start_ns)
    sessions = sorted(starts, key=lambda s: (starts[s], s))
    if len(sessions) < 2 or result.solve_result is None:
        return []
    poses = {s: session_poses(setup, result, s, **limits) for s in sessions}
    out = []
    for session in sessions:
        shifts, rows = {}, []
        for sensor, pose in poses[session].items():
            others = [poses[s][sensor] for s in sessions if s != session and sensor in poses[s]]
            if others:
                shifts[sensor], values = _compare_with_others(pose, others)
                rows.append({"session": session, "sensor": sensor, **values})
        markers = _markers_json(shifts, result.state.T_robot_sensor)
        out += [row | {"markers": markers} for row in rows]
    return out


def _markers_json(
    shifts: dict[str, SessionPose], T_robot_sensor: Mapping[str, np.ndarray]
) -> dict[str, Any] | None:
    """Return the shift of the robot's markers that explains the shifts of all sensors best.

    explained_share: of the squares of the sensors' shifts, in their σ.
    """
    if len(shifts) < 2:
        return None
    information, weighted, squares = np.zeros((6, 6)), np.zeros(6), 0.0
    for sensor, shift in shifts.items():
        to_sensor = adjoint(invert_pose(T_robot_sensor[sensor]))
        weight = np.linalg.inv(shift.covariance)
        information += to_sensor.T @ weight @ to_sensor
        weighted += to_sensor.T @ weight @ shift.twist
        squares += shift.twist @ weight @ shift.twist
    common = np.linalg.solve(information, weighted)
    return {"shift": common.tolist(), "explained_share": float(common @ weighted / squares)}


def _compare_with_others(
    pose: SessionPose, others: list[SessionPose]
) -> tuple[SessionPose, dict[str, Any]]:
    """Return the shift from the others, and the same as JSON."""
    weights = [np.linalg.inv(other.covariance) for other in others]
    covariance = np.linalg.inv(sum(weights))
    mean = covariance @ sum(W @ other.twist for W, other in zip(weights, others, strict=True))
    shift, shift_covariance = pose.twist - mean, pose.covariance + covariance
    p_value = stats.chi2.sf(shift @ np.linalg.solve(shift_covariance, shift), 6)
    return SessionPose(shift, shift_covariance), {
        "shift": shift.tolist(),
        "sigma": np.sqrt(np.diag(shift_covariance)).tolist(),
        "n_other_sessions": len(others),
        "p_value": float(p_value),
    }
