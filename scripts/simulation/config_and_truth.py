"""Write the config that a user would write for simulated logs, and the truth about them."""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from calib.geometry.se3 import pose_to_quat, pose_to_rpy
from simulation.sensor_mounts import BuiltRig
from simulation.session_recording import MAP_FRAME, ROBOT_BODY, SessionTruth, topic_namespace
from simulation.simulated_rigs import CONFIG_BY_RIG, SimulatedCamera, SimulatedLidar
from simulation.world.room_scene import SIMULATED_TARGETS

MIN_MCS_SIGMA_M, MIN_MCS_SIGMA_DEG = 1e-8, 1e-6
MIN_RANGE_SIGMA_M = 0.001
MIN_GUESS_SIGMA_M, MIN_GUESS_SIGMA_DEG = 0.005, 0.5
UNIFORM_TO_SIGMA = 3**-0.5  # σ of a uniform distribution over half its width
CONFIG_DECIMALS = 6  # of metres and degrees


def simulated_log_path(session_name: str) -> str:
    """Return where the log of a session is, relative to the working directory."""
    return f"logs/{session_name}.mcap"


def make_rig_config(
    rig: BuiltRig, guesses: Mapping[str, np.ndarray], args: argparse.Namespace
) -> dict[str, Any]:
    """Make the content of rigs/<rig>.yaml; guesses: T_robot_sensor (4, 4) by sensor."""
    guess_sigma = _sigma_json(
        max(args.guess_error_m, MIN_GUESS_SIGMA_M) * UNIFORM_TO_SIGMA,
        max(args.guess_error_deg, MIN_GUESS_SIGMA_DEG) * UNIFORM_TO_SIGMA,
    )
    sensors = {}
    for name, T in guesses.items():
        spec = rig.sensor_specs[name]
        is_camera = isinstance(spec, SimulatedCamera)
        is_compressed = isinstance(spec, SimulatedCamera) and spec.is_compressed
        sensors[name] = {
            "kind": "camera" if is_camera else "lidar",
            "topic": spec.topic + ("/compressed" if is_compressed else ""),
            "T_robot_sensor": rounded_pose_json(T),
            "guess_sigma": guess_sigma,
            **_sensor_model_config(spec, args),
        }
    truth = {
        name: {"xyz_m": _float_list(T[:3, 3]), "quat_xyzw": _float_list(pose_to_quat(T))}
        for name, T in rig.T_robot_sensor.items()
    }
    return {
        "body": ROBOT_BODY,
        "mocap": _mocap_config(args),
        "sensors": sensors,
        "truth": truth,
    }


def _mocap_config(args: argparse.Namespace) -> dict[str, Any]:
    topics = {"topics": ["/tf"], "map": MAP_FRAME}
    if args.mcs_wander_m or any(args.mcs_wander_deg):
        return topics  # noise that no user knows: the defaults
    return topics | {
        "pose_sigma": _sigma_json(
            max(args.mcs_noise_m, MIN_MCS_SIGMA_M), max(args.mcs_noise_deg, MIN_MCS_SIGMA_DEG)
        ),
        "pose_bias_sigma": _sigma_json(
            max(args.mcs_bias_m, MIN_MCS_SIGMA_M), max(args.mcs_bias_deg, MIN_MCS_SIGMA_DEG)
        ),
    }


def _sensor_model_config(
    spec: SimulatedLidar | SimulatedCamera, args: argparse.Namespace
) -> dict[str, Any]:
    if isinstance(spec, SimulatedCamera):
        return _lens_config(spec, args)
    return _lidar_config(spec, args)


def _lidar_config(spec: SimulatedLidar, args: argparse.Namespace) -> dict[str, Any]:
    column_step, ring_step = spec.scan_pattern.angular_steps_deg
    return {
        "azimuth_step_deg": round(column_step, CONFIG_DECIMALS),
        "elevation_step_deg": round(ring_step, CONFIG_DECIMALS),
        "azimuth_deg": [-spec.sector_deg, spec.sector_deg],
        "range_sigma_m": max(args.range_noise_m, MIN_RANGE_SIGMA_M),
    }


def _lens_config(spec: SimulatedCamera, args: argparse.Namespace) -> dict[str, Any]:
    if args.camera_info:
        return {"camera_info": f"{topic_namespace(spec.topic)}/camera_info"}
    return _camera_model_config(spec)


def _camera_model_config(spec: SimulatedCamera) -> dict[str, Any]:
    params = [float(p) for p in spec.params]
    return {"model": spec.model, "size_px": list(spec.size_px), "params": params}


def rounded_pose_json(T: np.ndarray) -> dict[str, list[float]]:
    """Return a pose (4, 4) as configs state it."""
    rpy = np.rad2deg(pose_to_rpy(T))
    return {
        "xyz_m": _float_list(T[:3, 3], CONFIG_DECIMALS),
        "rpy_deg": _float_list(rpy, CONFIG_DECIMALS),
    }


def make_target_config(name: str, args: argparse.Namespace) -> dict[str, Any]:
    """Make the content of targets/<name>.yaml."""
    spec = dict(SIMULATED_TARGETS[name])
    if args.mount_m or args.mount_deg:
        spec["alignment_sigma"] = _sigma_json(max(args.mount_m, 1e-4), max(args.mount_deg, 1e-2))
    return spec


def write_simulated_config(
    folder: Path,
    rig_name: str,
    sessions: Sequence[SessionTruth],
    guesses: Mapping[str, np.ndarray],
) -> None:
    """Write config.yaml, rigs/<name>.yaml and targets/*.yaml below a folder."""
    rig, args, targets = sessions[0].rig, sessions[0].arguments, sessions[0].T_body_target
    logs = {
        s.name: {"rig": rig_name, "log": simulated_log_path(s.name), **_remounted_flag(s)}
        for s in sessions
    }
    files: dict[str, dict[str, Any]] = {}
    files["config.yaml"] = {"sessions": logs, **CONFIG_BY_RIG.get(rig_name, {})}
    files[f"rigs/{rig_name}.yaml"] = make_rig_config(rig, guesses, args)
    for target in targets:
        files[f"targets/{target}.yaml"] = make_target_config(target, args)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(
            yaml.dump(content, Dumper=_NoAliasDumper, sort_keys=False, default_flow_style=None)
        )


def _remounted_flag(session: SessionTruth) -> dict[str, bool]:
    """Return the key of a session whose markers were remounted."""
    return {} if np.array_equal(session.T_robot_markers, np.eye(4)) else {"remounted": True}


class _NoAliasDumper(yaml.SafeDumper):
    """Writes content that occurs twice in full, without anchors."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def truth_json(
    sessions: Sequence[SessionTruth], guesses: Mapping[str, np.ndarray]
) -> dict[str, Any]:
    """Make the content of truth.json: everything that was drawn, and the arguments.

    Placements and swaps are at the top for a single session, below `sessions` otherwise.
    """
    rig, args, targets = sessions[0].rig, sessions[0].arguments, sessions[0].T_body_target
    drawn = {session.name: _session_truth_json(session) for session in sessions}
    return {
        "arguments": {k: v for k, v in sorted(vars(args).items()) if k != "out"},
        "sensors": {
            name: {
                "T_robot_sensor": full_pose_json(T),
                "guess": full_pose_json(guesses[name]),
                **(
                    {}
                    if name in rig.camera_models
                    else {"beam_bias_m": _float_list(rig.beam_bias_m[name])}
                ),
            }
            for name, T in rig.T_robot_sensor.items()
        },
        "cameras": {
            name: _camera_model_config(rig.camera_spec(name)) for name in rig.camera_models
        },
        "time_offset_s": args.mcs_late_s,
        "time_drift_ppm": args.mcs_drift_ppm,
        "targets": {name: {"T_body_target": full_pose_json(T)} for name, T in targets.items()},
        **({"sessions": drawn} if len(drawn) > 1 else drawn[sessions[0].name]),
    }


def _session_truth_json(session: SessionTruth) -> dict[str, Any]:
    swaps = [
        {"start_ns": start, "end_ns": end, "bodies": list(pair)}
        for start, end, pair in session.label_swaps
    ]
    placements = [_placement_truth_json(session, k) for k in range(len(session.placement_times_ns))]
    markers = {"T_robot_markers": full_pose_json(session.T_robot_markers)}
    return {"placements": placements, "label_swaps": swaps, **markers}


def _placement_truth_json(session: SessionTruth, placement_index: int) -> dict[str, Any]:
    start, end = (int(t) for t in session.placement_times_ns[placement_index])
    T_world_robot = session.placement_poses["robot"][placement_index]
    return {
        "start_ns": start,
        "end_ns": end,
        "T_world_robot": full_pose_json(T_world_robot),
        "T_robot_target": {
            name: full_pose_json(
                np.linalg.solve(T_world_robot, session.placement_poses[name][placement_index])
            )
            for name in session.T_body_target
        },
        "mcs_bias": {
            name: {
                "xyz_m": _float_list(b[placement_index, :3]),
                "rotvec_deg": _float_list(np.rad2deg(b[placement_index, 3:])),
            }
            for name, b in session.mcs_biases.items()
        },
    }


def write_truth(
    path: Path, sessions: Sequence[SessionTruth], guesses: Mapping[str, np.ndarray]
) -> None:
    """Write truth.json."""
    path.write_text(json.dumps(truth_json(sessions, guesses), indent=1) + "\n")


def full_pose_json(T: np.ndarray) -> dict[str, list]:
    """Return a pose (4, 4) as xyz_m, quat_xyzw and matrix."""
    return {
        "xyz_m": _float_list(T[:3, 3]),
        "quat_xyzw": _float_list(pose_to_quat(T)),
        "matrix": T.tolist(),
    }


def _sigma_json(xyz_m: float, rpy_deg: float) -> dict[str, float]:
    return {"xyz_m": float(f"{xyz_m:.5g}"), "rpy_deg": float(f"{rpy_deg:.5g}")}


def _float_list(values: np.ndarray, decimals: int | None = None) -> list[float]:
    values = np.asarray(values, float)
    return (values if decimals is None else np.round(values, decimals)).tolist()
