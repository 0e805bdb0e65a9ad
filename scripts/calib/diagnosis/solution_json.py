"""The content of solution.json."""

import itertools
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from calib.diagnosis.consider_covariance import common_range_sigmas
from calib.diagnosis.leave_one_out import LeaveOneOut, leave_one_out, sigma_by_placements_json
from calib.diagnosis.model_selection import sensor_corrections_json
from calib.diagnosis.observability import (
    MOUNT_DIRECTION_NAMES,
    describe_pose_direction,
    direction_spread_deg,
    find_undetermined_directions,
    least_certain_direction,
    shared_direction,
)
from calib.diagnosis.residual_statistics import (
    fit_statistics,
    guess_deviation_in_sigma,
    influences_json,
    leave_one_out_statistics,
    target_directions,
    usage_counts,
)
from calib.diagnosis.sensor_status import recording_advice, sensor_status
from calib.estimation.corrections.camera_intrinsics import get_intrinsics_estimate
from calib.estimation.corrections.clock_drift import clock_drift_json
from calib.estimation.corrections.clock_offset import stream_lags_json, time_offset_json
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.geometry.se3 import invert_pose, relative_pose_covariance, se3_log
from calib.io.pose_block import pose_json
from calib.io.status import Status
from calib.sensors.camera.camera_model import CameraModel

# σ over that of the prior, above which only the prior determines a direction.
MIN_PRIOR_SIGMA_RATIO = 0.9
PROVENANCE_PACKAGES = (
    "casadi",
    "mcap",
    "numpy",
    "opencv-python-headless",
    "pyarrow",
    "rosbags",
    "scipy",
)


@dataclass(frozen=True)
class _SolvedSensors:
    """Sensors with a pose, in order, and their joint covariance (6k, 6k)."""

    names: list[str]
    joint_covariance: np.ndarray
    leave_one_outs: list[LeaveOneOut]

    def covariance(self, sensor: str) -> np.ndarray:
        """Return the covariance (6, 6) of a sensor pose."""
        at = 6 * self.names.index(sensor)
        return self.joint_covariance[at : at + 6, at : at + 6]


def solution_json(
    setup: Setup,
    result: EstimationResult,
    suspected_errors: list[dict[str, Any]],
    status_and_guess: dict[str, tuple[Status, dict[str, Any]]],
    options: dict[str, Any],
) -> dict[str, Any]:
    """Return the content of solution.json.

    status_and_guess: by sensor, its status before the solve and guess.json.
    """
    undetermined = {n: undetermined_directions_json(setup, result, n) for n in sorted(setup.models)}
    statuses = {
        name: before
        if not before.ok
        else sensor_status(setup, result, name, [d["description"] for d in undetermined[name]])
        for name, (before, _) in status_and_guess.items()
    }
    names = [n for n in sorted(setup.models) if statuses[n].ok]
    solved = _SolvedSensors(
        names,
        marginal_joint_covariance(setup, result, names) if names else np.zeros((0, 0)),
        leave_one_out(setup, result) if names else [],
    )
    sensors = {}
    for name, (_, guess) in sorted(status_and_guess.items()):
        kind = options["sensors"][name]["kind"]
        sensors[name] = {
            "kind": kind,
            "frame": guess["frame"],
            "status": statuses[name].to_dict(),
            "guess": {k: guess[k] for k in ("T_robot_sensor", "sigma", "source", "time_offset_s")},
            "undetermined": undetermined.get(name, []),
            **sensor_pose_json(name, result, guess, solved),
            **intrinsics_json(name, setup, result),
            **time_offset_json(name, setup, result, guess),
            "clock_drift": clock_drift_json(name, setup, result, guess),
            **usage_counts(name, kind, setup, result),
            **sensor_tests_json(name, setup, result, solved),
        }
    return {
        "rig": options["rig"],
        "has_converged": result.has_converged,
        "ipopt_status": result.solve_result.status if result.solve_result else None,
        "sensors": sensors,
        **joint_estimate_json(result, solved, suspected_errors),
        "targets": target_mounts_json(setup, result, options),
        "sessions": dict.fromkeys(options["sessions"]),
        "mocap_offsets_s": stream_lags_json(setup, result),
        "influences": influences_json(setup, solved.leave_one_outs),
        "noise": noise_json(setup, result),
        "provenance": {
            "sessions": options["sessions"],
            "packages": {p: version(p) for p in PROVENANCE_PACKAGES},
        },
    }


def joint_estimate_json(
    result: EstimationResult, solved: _SolvedSensors, suspected_errors: list[dict[str, Any]]
) -> dict[str, Any]:
    """Return joint covariance, relative poses and suspected errors of the solved sensors."""
    names, joint = solved.names, solved.joint_covariance
    errors = []
    if names:
        errors = [
            e | {"pose_shift": {n: e["pose_shift"][n] for n in names}} for e in suspected_errors
        ]
    return {
        "joint_covariance": {"order": names, "matrix": joint.tolist()} if names else None,
        "pairs": relative_poses_json(result.state.T_robot_sensor, names, joint),
        "suspected_errors": errors,
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


def marginal_joint_covariance(
    setup: Setup, result: EstimationResult, sensors: list[str]
) -> np.ndarray:
    """Return the joint covariance (6k, 6k) of some sensors; all other unknowns are marginalised."""
    names = sorted(setup.models)
    rows = [6 * names.index(n) + i for n in sensors for i in range(6)]
    return result.solved.covariance[np.ix_(rows, rows)]


def relative_poses_json(
    T_robot_sensor: dict[str, np.ndarray], order: list[str], joint_covariance: np.ndarray
) -> list[dict[str, Any]]:
    """Return [{from, to, T, covariance}] of every two sensors; T maps points of `to` into `from`.

    joint_covariance: (6k, 6k) of the poses, in order. covariance: (6, 6) of the right perturbation
    T·Exp(ξ), along the axes of `to`; errors that both sensors share cancel.
    """
    out = []
    for a, b in itertools.combinations(order, 2):
        rows = [6 * order.index(n) + i for n in (a, b) for i in range(6)]
        T_robot_a, T_robot_b = T_robot_sensor[a], T_robot_sensor[b]
        covariance = relative_pose_covariance(
            T_robot_a, T_robot_b, joint_covariance[np.ix_(rows, rows)]
        )
        T = pose_json(invert_pose(T_robot_a) @ T_robot_b)
        out.append({"from": a, "to": b, "T": T, "covariance": covariance.tolist()})
    return out


def sensor_pose_json(
    sensor: str, result: EstimationResult, guess: dict[str, Any], solved: _SolvedSensors
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


def sensor_tests_json(
    sensor: str, setup: Setup, result: EstimationResult, solved: _SolvedSensors
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


def target_mounts_json(
    setup: Setup, result: EstimationResult, options: dict[str, Any]
) -> dict[str, Any]:
    """Return {T_body_target, covariance, shift, prior_sigma, undetermined} by target.

    None for a target whose mount was not estimated. shift (6,): from the configured mount, with
    prior_sigma (6,); None for mount: unknown. undetermined: relevant directions, as text, that only
    the prior determines.
    """
    out: dict[str, Any] = dict.fromkeys(sorted(options["targets"]))
    first = 6 * len(setup.models)
    for i, name in enumerate(sorted(setup.initial_mounts)):
        at = slice(first + 6 * i, first + 6 * i + 6)
        covariance = result.solved.covariance[at, at]
        out[name] = {
            "T_body_target": pose_json(result.state.mounts[name]),
            "covariance": covariance.tolist(),
            "shift": None,
            "prior_sigma": None,
            "undetermined": [],
        }
        if name in setup.mount_sigma:
            shift = invert_pose(setup.initial_mounts[name]) @ result.state.mounts[name]
            out[name] |= {
                "shift": se3_log(shift).tolist(),
                "prior_sigma": setup.mount_sigma[name].tolist(),
                "undetermined": _undetermined_mount_directions(setup, name, covariance),
            }
    return out


def _undetermined_mount_directions(setup: Setup, target: str, covariance: np.ndarray) -> list[str]:
    ratio = np.sqrt(np.diag(covariance)) / setup.mount_sigma[target]
    irrelevant = [3 + axis for axis in setup.targets[target].symmetry_axes]
    return [
        MOUNT_DIRECTION_NAMES[k]
        for k in range(6)
        if ratio[k] > MIN_PRIOR_SIGMA_RATIO and k not in irrelevant
    ]


def noise_json(setup: Setup, result: EstimationResult) -> dict[str, Any]:
    """Return the estimated σ by sensor and kind (m, rad, px), and the noise factor of the MCS."""
    out: dict[str, dict[str, float]] = {}
    for (sensor, kind), noise in sorted(result.state.noise.items()):
        if sensor in setup.models:
            sigmas = [
                g.keypoints["sigma"] for g in setup.groups if (g.sensor, g.kind) == (sensor, kind)
            ]
            sigma = float(noise.total * np.median(np.concatenate(sigmas)))
            out.setdefault(sensor, {})[kind] = sigma
    return {"sensors": out, "mocap_factor": float(result.state.mocap_noise_factor)}
