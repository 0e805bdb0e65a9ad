"""The block of one sensor in solution.json."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.diagnosis.correction_selection import sensor_corrections_json
from calib.diagnosis.covariance.consider_covariance import common_range_sigmas
from calib.diagnosis.leave_one_out import LeaveOneOut, sigma_by_placements_json
from calib.diagnosis.observability import (
    describe_pose_direction,
    direction_spread_deg,
    find_undetermined_directions,
    least_certain_direction,
    shared_direction,
)
from calib.diagnosis.residual_statistics import (
    fit_statistics,
    guess_deviation_in_sigma,
    leave_one_out_statistics,
    target_directions,
    usage_counts,
)
from calib.diagnosis.sensor_status import recording_advice
from calib.estimation.corrections.camera.camera_intrinsics import get_intrinsics_estimate
from calib.estimation.corrections.clock_drift import clock_drift_json
from calib.estimation.corrections.clock_offset import time_offset_json
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.io.pose_block import pose_json
from calib.io.status import Status
from calib.sensors.camera.camera_model import CameraModel


@dataclass(frozen=True)
class SolvedSensors:
    """What is known of all sensors after the solve.

    statuses: by sensor. undetermined: by sensor of the setup, see undetermined_directions_json.
    names: k sensors with a pose, in order. joint_covariance: (6k, 6k) of their poses.
    leave_one_outs: empty without such sensors.
    """

    statuses: dict[str, Status]
    undetermined: dict[str, list[dict[str, Any]]]
    names: list[str]
    joint_covariance: np.ndarray
    leave_one_outs: list[LeaveOneOut]

    def covariance(self, sensor: str) -> np.ndarray:
        """Return the covariance (6, 6) of a sensor pose."""
        at = 6 * self.names.index(sensor)
        return self.joint_covariance[at : at + 6, at : at + 6]


def sensor_json(
    sensor: str,
    setup: Setup,
    result: EstimationResult,
    solved: SolvedSensors,
    *,
    kind: str,
    guess: dict[str, Any],
) -> dict[str, Any]:
    """Return the block of a sensor. kind: camera or lidar. guess: its guess.json."""
    return {
        "kind": kind,
        "frame": guess["frame"],
        "status": solved.statuses[sensor].to_dict(),
        "guess": {k: guess[k] for k in ("T_robot_sensor", "sigma", "source", "time_offset_s")},
        "undetermined": solved.undetermined.get(sensor, []),
        **sensor_pose_json(sensor, result, guess, solved),
        **intrinsics_json(sensor, setup, result),
        **time_offset_json(sensor, setup, result, guess),
        "clock_drift": clock_drift_json(sensor, setup, result, guess),
        **usage_counts(sensor, kind, setup, result),
        **sensor_tests_json(sensor, setup, result, solved),
    }


def undetermined_directions_json(
    setup: Setup, result: EstimationResult, sensor: str
) -> list[dict[str, Any]]:
    """Return the undetermined directions of a sensor: [{direction (6,), description}].

    direction: unit twist of the sensor.
    """
    T = result.state.T_robot_sensor[sensor]
    shared = shared_direction(target_directions(sensor, setup, result)[0])
    information = result.solved.information
    directions = find_undetermined_directions(
        information, len(setup.models), sorted(setup.models).index(sensor)
    )
    return [
        {"direction": d.tolist(), "description": describe_pose_direction(d, T, shared)}
        for d in directions
    ]


def sensor_pose_json(
    sensor: str, result: EstimationResult, guess: dict[str, Any], solved: SolvedSensors
) -> dict[str, Any]:
    """Return pose, covariance, least certain direction and deviation from the guess of a sensor.

    All are None for a sensor without a pose.
    """
    keys = ("T_robot_sensor", "covariance", "least_certain", "guess_deviation_in_sigma")
    if sensor not in solved.names:
        return dict.fromkeys(keys)
    T, covariance = result.state.T_robot_sensor[sensor], solved.covariance(sensor)
    direction = least_certain_direction(covariance)
    return {
        "T_robot_sensor": pose_json(T),
        "covariance": covariance.tolist(),
        "least_certain": {
            "direction": describe_pose_direction(direction.weights, T),
            "sigma": direction.sigma,
        },
        "guess_deviation_in_sigma": guess_deviation_in_sigma(T, guess),
    }


def intrinsics_json(sensor: str, setup: Setup, result: EstimationResult) -> dict[str, Any]:
    """Return {intrinsics, intrinsics_note} of a sensor; the note says why they are not estimated.

    intrinsics: {model, params, sigma} or None.
    """
    estimate = get_intrinsics_estimate(setup, result, sensor) if result.solve_result else None
    camera = setup.models.get(sensor)
    if estimate is None or not isinstance(camera, CameraModel):
        reason = setup.estimable_intrinsics.get(sensor)
        return {
            "intrinsics": None,
            "intrinsics_note": reason if isinstance(reason, str) else "",
        }
    params, sigma, _ = estimate
    block = {"model": camera.model, "params": params.tolist(), "sigma": sigma.tolist()}
    return {"intrinsics": block, "intrinsics_note": ""}


def sensor_tests_json(
    sensor: str, setup: Setup, result: EstimationResult, solved: SolvedSensors
) -> dict[str, Any]:
    """Return what the verdict needs to know of a sensor besides its pose."""
    out: dict[str, Any] = {
        "direction_spread_deg": {},
        "fit_by_kind": {},
        "corrections": [],
        "common_range_sigma_m": None,
        "recording_advice": "",
        "leave_one_out": None,
        "sigma_by_placements": None,
    }
    if sensor not in setup.models:
        return out
    directions, _ = target_directions(sensor, setup, result)
    out |= {
        "direction_spread_deg": direction_spread_deg(directions),
        "fit_by_kind": fit_statistics(sensor, setup, result),
        "recording_advice": recording_advice(sensor, setup, result),
    }
    if sensor in solved.names and solved.leave_one_outs:
        out |= {
            "corrections": sensor_corrections_json(setup, result, sensor),
            "common_range_sigma_m": common_range_sigmas(setup, result.state).get(sensor),
            "leave_one_out": leave_one_out_statistics(sensor, solved.leave_one_outs),
            "sigma_by_placements": sigma_by_placements_json(setup, result, sensor),
        }
    return out
