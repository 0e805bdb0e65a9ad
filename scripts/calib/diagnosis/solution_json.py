"""What a settled estimate says, as solution.json and as rows of residuals.parquet."""

import itertools
from importlib.metadata import version

import numpy as np

from calib.diagnosis.consider_covariance import common_range_sigmas
from calib.diagnosis.leave_one_out import leave_one_out, sigma_by_placements_json
from calib.diagnosis.model_selection import sensor_corrections_json
from calib.diagnosis.observability import (
    MOUNT_DIRECTION_NAMES,
    advise_views,
    describe_least_certain_direction,
    describe_pose_direction,
    direction_spread_deg,
    find_undetermined_directions,
    shared_direction,
)
from calib.diagnosis.residual_statistics import (
    find_flipped_pattern,
    fit_statistics,
    guess_deviation_in_sigma,
    influences_json,
    leave_one_out_statistics,
    target_directions,
    usage_counts,
)
from calib.estimation.corrections.camera_intrinsics import get_intrinsics_estimate
from calib.estimation.corrections.clock_drift import clock_drift_json
from calib.estimation.corrections.clock_offset import stream_lags_json, time_offset_json
from calib.geometry.se3 import invert_pose, relative_pose_covariance, se3_log
from calib.io.pose_block import pose_json
from calib.io.status import OK, failure_status
from calib.sensors.lidar.lidar_model import LidarModel

MIN_PRIOR_SIGMA_RATIO = 0.9  # of the σ of a prior: what is known no better is told by nothing else
PROVENANCE_PACKAGES = (
    "casadi",
    "mcap",
    "numpy",
    "opencv-python-headless",
    "pyarrow",
    "rosbags",
    "scipy",
)


def solution_json(setup, result, suspected_errors, status_and_guess, options):
    """The content of solution.json; status_and_guess: sensor -> (status before the solve, guess.json)."""
    names = sorted(setup.models)
    open_directions = {n: undetermined_directions_json(setup, result, n) for n in names}
    status = {
        n: sensor_status(n, status_and_guess, open_directions, setup, result)
        for n in options["sensors"]
    }
    solved = [n for n in names if status[n].ok]
    joint = marginal_joint_covariance(setup, result, solved) if solved else None
    left = leave_one_out(setup, result) if solved else []
    sensors = {}
    for name, (_, guess) in sorted(status_and_guess.items()):
        sensors[name] = {
            "kind": options["sensors"][name]["kind"],
            "frame": guess["frame"],
            "status": status[name].to_dict(),
            "guess": {k: guess[k] for k in ("T_robot_sensor", "sigma", "source", "time_offset_s")},
            "undetermined": open_directions.get(name, []),
            **sensor_pose_json(name, result, solved, joint, guess),
            **intrinsics_json(name, setup, result),
            **time_offset_json(name, setup, result, guess),
            "clock_drift": clock_drift_json(name, setup, result, guess),
            **usage_counts(name, options["sensors"][name]["kind"], setup, result),
            **sensor_tests_json(name, setup, result, left if name in solved else []),
        }
    return {
        "rig": options["rig"],
        "has_converged": result.has_converged,
        "ipopt_status": result.solve_result.status if result.solve_result else None,
        "sensors": sensors,
        "joint_covariance": {"order": solved, "matrix": joint.tolist()} if solved else None,
        "pairs": relative_poses_json(result.state.T_robot_sensor, solved, joint),
        "targets": target_mounts_json(setup, result, options),
        "suspected_errors": [
            s | {"pose_shift": {n: s["pose_shift"][n] for n in solved}} for s in suspected_errors
        ]
        if solved
        else [],
        "sessions": dict.fromkeys(options["sessions"]),
        "mocap_offsets_s": stream_lags_json(setup, result),
        "influences": influences_json(setup, left),
        "noise": noise_json(setup, result),
        "provenance": {
            "sessions": options["sessions"],
            "packages": {p: version(p) for p in PROVENANCE_PACKAGES},
        },
    }


def undetermined_directions_json(setup, result, name):
    """The undetermined directions of a sensor: [{direction (6,), unit twist, words}]."""
    i, T = sorted(setup.models).index(name), result.state.T_robot_sensor[name]
    common = shared_direction(target_directions(name, setup, result)[0])
    found = find_undetermined_directions(result.solve_result.information, len(setup.models), i)
    return [
        {"direction": d.tolist(), "description": describe_pose_direction(d, T, common)}
        for d in found
    ]


def sensor_status(sensor, status_and_guess, open_directions, setup, result):
    """Status of one sensor after the solve."""
    before, guess = status_and_guess[sensor]
    if not before.ok:
        return before
    if open_directions[sensor]:
        if misread := find_flipped_pattern(sensor, setup, result):
            return flipped_pattern_status(sensor, *misread)
        words = "; ".join(d["description"] for d in open_directions[sensor])
        return failure_status(
            f"the data do not determine {sensor}: {words}",
            f"{len(open_directions[sensor])} open directions",
            "none",
            recording_advice(sensor, setup, result),
        )
    if not result.solve_result.has_converged:
        return failure_status(
            f"IPOPT ended with {result.solve_result.status}", remedy="See solve.log."
        )
    return OK


def flipped_pattern_status(sensor, target, pattern, stated_misfit_px, flipped_misfit_px):
    """The Status of a camera that sees the pattern of a target counted from another end."""
    colour = {"black": "white", "white": "black"}[pattern.first_square_color]
    return failure_status(
        f"{sensor} sees the pattern of {target} the other way round than stated",
        f"corners {flipped_misfit_px:.1f} px from their places counted from a {colour} first square",
        f"from a {pattern.first_square_color} one, but so they are {stated_misfit_px:.0f} px off",
        f"Set first_square of {target} to {colour}. Where the sheet should begin with "
        f"{pattern.first_square_color}, it was printed or mounted mirrored: print it anew as it is.",
    )


def recording_advice(name, setup, result):
    """Which views would tell more of a sensor's pose (observability.advice)."""
    lidar = isinstance(setup.models[name], LidarModel)
    return advise_views(*target_directions(name, setup, result), lidar)


def intrinsics_json(name, setup, result):
    """{intrinsics: {model, params, sigma} or None, lens: why not} of one sensor."""
    found = get_intrinsics_estimate(setup, result, name) if result.solve_result else None
    why = setup.estimable_intrinsics.get(name)
    if found is None:
        return {"intrinsics": None, "intrinsics_note": why if isinstance(why, str) else ""}
    params, sigma, _ = found
    model = setup.models[name].model
    told = {"model": model, "params": params.tolist(), "sigma": sigma.tolist()}
    return {"intrinsics": told, "intrinsics_note": ""}


def marginal_joint_covariance(setup, result, solved):
    """(6k, 6k) over the solved sensors in order; what is not solved is marginalised out."""
    names = sorted(setup.models)
    rows = [6 * names.index(n) + i for n in solved for i in range(6)]
    return result.solve_result.covariance[np.ix_(rows, rows)]


def relative_poses_json(T_robot_sensor, order, joint_covariance):
    """[{from, to, T, covariance}] of every two of the sensors in order: T maps points of `to` into
    `from`, with the covariance (6, 6) of its right perturbation, T·Exp(ξ), along the axes of `to`.

    joint_covariance (6k, 6k): the covariance of their poses; what both share cancels.
    """
    out = []
    for a, b in itertools.combinations(order, 2):
        at = [6 * order.index(n) + i for n in (a, b) for i in range(6)]
        T_r_a, T_r_b = T_robot_sensor[a], T_robot_sensor[b]
        spread = relative_pose_covariance(T_r_a, T_r_b, joint_covariance[np.ix_(at, at)])
        T = pose_json(invert_pose(T_r_a) @ T_r_b)
        out.append({"from": a, "to": b, "T": T, "covariance": spread.tolist()})
    return out


def sensor_pose_json(sensor, result, solved_sensors, joint_covariance, guess):
    """T_robot_sensor, its covariance, weakest direction, and distance from the guess in its σ; null
    for a sensor without a pose."""
    if sensor not in solved_sensors:
        return dict.fromkeys(
            ("T_robot_sensor", "covariance", "least_certain", "guess_deviation_in_sigma")
        )
    T = result.state.T_robot_sensor[sensor]
    at = 6 * solved_sensors.index(sensor)
    block = joint_covariance[at : at + 6, at : at + 6]
    words, sigma = describe_least_certain_direction(block, T)
    return {
        "T_robot_sensor": pose_json(T),
        "covariance": block.tolist(),
        "least_certain": {"direction": words, "sigma": sigma},
        "guess_deviation_in_sigma": guess_deviation_in_sigma(T, guess),
    }


def sensor_tests_json(sensor, setup, result, leave_one_outs):
    """What a verdict asks of one sensor beside its pose; leave_one_outs: crossvalidation.Left, or none."""
    if sensor not in setup.models:
        none = {
            "direction_spread_deg": {},
            "fit_by_kind": {},
            "recording_advice": "",
            "leave_one_out": None,
            "sigma_by_placements": None,
        }
        return none | {"corrections": [], "common_range_sigma_m": None}
    directions, _ = target_directions(sensor, setup, result)
    return {
        "direction_spread_deg": direction_spread_deg(directions),
        "fit_by_kind": fit_statistics(sensor, setup, result),
        "corrections": sensor_corrections_json(setup, result, sensor) if leave_one_outs else [],
        "common_range_sigma_m": common_range_sigmas(setup, result.state).get(sensor)
        if leave_one_outs
        else None,
        "recording_advice": recording_advice(sensor, setup, result),
        "leave_one_out": leave_one_out_statistics(sensor, leave_one_outs),
        "sigma_by_placements": sigma_by_placements_json(setup, result, sensor)
        if leave_one_outs
        else None,
    }


def target_mounts_json(setup, result, options):
    """{name: {T_body_target, covariance, shift, prior, open} where it was estimated, else None}.

    shift (6,): from where the config puts it; prior (6,): the σ of that; None for unknown mounts.
    open: in words, what of it nothing tells and the prior alone holds, though it matters.
    """
    out = dict.fromkeys(sorted(options["targets"]))
    first = 6 * len(setup.models)
    for i, name in enumerate(sorted(setup.initial_mounts)):
        at = slice(first + 6 * i, first + 6 * i + 6)
        block = result.solve_result.covariance[at, at]
        pose = pose_json(result.state.mounts[name])
        out[name] = {"T_body_target": pose, "covariance": block.tolist()}
        out[name] |= {"shift": None, "prior_sigma": None, "undetermined": []}
        if name in setup.mount_sigma:
            off = invert_pose(setup.initial_mounts[name]) @ result.state.mounts[name]
            prior = setup.mount_sigma[name]
            ratio = np.sqrt(np.diag(block)) / prior
            unseen = [3 + axis for axis in setup.targets[name].symmetry_axes]
            held = [
                MOUNT_DIRECTION_NAMES[k]
                for k in range(6)
                if ratio[k] > MIN_PRIOR_SIGMA_RATIO and k not in unseen
            ]
            shift = se3_log(off).tolist()
            out[name] |= {"shift": shift, "prior_sigma": prior.tolist(), "undetermined": held}
    return out


def noise_json(setup, result):
    """Re-estimated σ by sensor and kind, SI or px, and the factor on the priors of the MCS."""
    out = {}
    for (sensor, kind), scale in sorted(result.state.noise.items()):
        if sensor not in setup.models:
            continue
        sigmas = [
            g.keypoints["sigma"] for g in setup.groups if (g.sensor, g.kind) == (sensor, kind)
        ]
        out.setdefault(sensor, {})[kind] = float(scale.total * np.median(np.concatenate(sigmas)))
    return {"sensors": out, "mocap_factor": float(result.state.mocap_noise_factor)}


def _pad_to_two_columns(value):
    """Values (n, k) as the table holds them (n, 2): u and v, or a length and 0."""
    if value.shape[1] == 2:
        return value
    length = value[:, 0] if value.shape[1] == 1 else np.linalg.norm(value, axis=1)
    return np.column_stack([length, np.zeros(len(value))])
