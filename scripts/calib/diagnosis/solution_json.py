"""The content of solution.json."""

import itertools
from importlib.metadata import version
from typing import Any

import numpy as np

from calib.diagnosis.leave_one_out import leave_one_out
from calib.diagnosis.observability import MOUNT_DIRECTION_NAMES
from calib.diagnosis.residual_statistics import influences_json
from calib.diagnosis.sensor_json import SolvedSensors, sensor_json, undetermined_directions_json
from calib.diagnosis.sensor_status import find_floating_sensors_of_setup, sensor_status
from calib.estimation.corrections.board_shape import board_shapes_json
from calib.estimation.corrections.clock_offset import stream_lags_json
from calib.estimation.corrections.mocap.mocap_scale import mocap_scales_json
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.nlp.information_matrix import invert_information
from calib.estimation.noise.noise_estimation import mocap_scatter
from calib.geometry.se3 import invert_pose, relative_pose_covariance, se3_log
from calib.io.pose_block import pose_json
from calib.io.status import Status

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
    solved = _solved_sensors(setup, result, status_and_guess)
    kinds = {name: options["sensors"][name]["kind"] for name in status_and_guess}
    sensors = {
        name: sensor_json(name, setup, result, solved, kind=kinds[name], guess=guess)
        for name, (_, guess) in sorted(status_and_guess.items())
    }
    return {
        "rig": options["rig"],
        "has_converged": result.has_converged,
        "ipopt_status": result.solve_result.status if result.solve_result else None,
        "sensors": sensors,
        **joint_estimate_json(result, solved, suspected_errors),
        "targets": target_mounts_json(setup, result, options),
        "board_shapes": board_shapes_json(setup, result),
        "sessions": dict.fromkeys(options["sessions"]),
        "mocap_offsets_s": stream_lags_json(setup, result),
        "mocap_scales": mocap_scales_json(setup, result),
        "influences": influences_json(setup, solved.leave_one_outs),
        "noise": noise_json(setup, result),
        "provenance": {
            "sessions": options["sessions"],
            "packages": {p: version(p) for p in PROVENANCE_PACKAGES},
        },
    }


def _solved_sensors(
    setup: Setup,
    result: EstimationResult,
    status_and_guess: dict[str, tuple[Status, dict[str, Any]]],
) -> SolvedSensors:
    undetermined = {n: undetermined_directions_json(setup, result, n) for n in sorted(setup.models)}
    floating = find_floating_sensors_of_setup(setup)
    statuses = {
        name: before
        if not before.ok
        else floating.get(name)
        or sensor_status(setup, result, name, [d["description"] for d in undetermined[name]])
        for name, (before, _) in status_and_guess.items()
    }
    names = [n for n in sorted(setup.models) if statuses[n].ok]
    return SolvedSensors(
        statuses,
        undetermined,
        names,
        joint_covariance=(
            marginal_joint_covariance(setup, result, names) if names else np.zeros((0, 0))
        ),
        leave_one_outs=leave_one_out(setup, result) if names else [],
    )


def joint_estimate_json(
    result: EstimationResult, solved: SolvedSensors, suspected_errors: list[dict[str, Any]]
) -> dict[str, Any]:
    """Return joint covariance, relative poses and suspected errors of the solved sensors."""
    names, joint = solved.names, solved.joint_covariance
    errors = []
    if names:
        sigma = dict(zip(names, np.sqrt(np.diag(joint)).reshape(-1, 6), strict=True))
        errors = [
            e | {"pose_shift": {n: _reported_shift(e["pose_shift"][n], sigma[n]) for n in names}}
            for e in suspected_errors
        ]
    return {
        "joint_covariance": {"order": names, "matrix": joint.tolist()} if names else None,
        "pairs": relative_poses_json(result.state.T_robot_sensor, names, joint),
        "suspected_errors": errors,
    }


def _reported_shift(pose_shift: dict[str, Any], sigma: np.ndarray) -> dict[str, float]:
    """Return m, rad and sigmas of a shift of a pose, in its reported σ (6,) where that is larger.

    An error that moves a pose by less than its reported σ is contained in it.
    """
    in_reported_sigma = float((np.abs(pose_shift["shift"]) / sigma).max())
    sigmas = min(pose_shift["sigmas"], in_reported_sigma)
    return {"m": pose_shift["m"], "rad": pose_shift["rad"], "sigmas": sigmas}


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
    """Return the estimated σ by sensor and kind (m, rad, px), and the noise of the MCS.

    mocap_factor: on its configured σ. mocap_scatter: σ of its errors of placements, as configured
    and as estimated, m and rad; None if the data do not determine it.
    """
    out: dict[str, dict[str, float]] = {}
    for (sensor, kind), noise in sorted(result.state.noise.items()):
        if sensor in setup.models:
            sigmas = [
                g.keypoints["sigma"] for g in setup.groups if (g.sensor, g.kind) == (sensor, kind)
            ]
            sigma = float(noise.total * np.median(np.concatenate(sigmas)))
            out.setdefault(sensor, {})[kind] = sigma
    scatter = None
    if result.solve_result:
        covariance = invert_information(result.solve_result.information)
        scatter = mocap_scatter(setup, result.state, covariance)
    return {
        "sensors": out,
        "mocap_factor": float(result.state.mocap_noise_factor),
        "mocap_scatter": scatter
        and {
            name: {"m": float(m), "rad": float(rad)}
            for name, (m, rad) in zip(("configured", "estimated"), scatter, strict=True)
        },
    }
