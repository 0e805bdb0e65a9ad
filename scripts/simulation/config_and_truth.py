"""The configuration that a user would write for simulated logs, and the truth about them."""

import json

import numpy as np
import yaml

from calib.geometry.se3 import pose_to_quat, pose_to_rpy
from simulation import session_recording
from simulation.session_recording import topic_namespace
from simulation.simulated_rigs import CONFIG_BY_RIG
from simulation.world.room_scene import SIMULATED_TARGETS

MIN_MCS_SIGMA_M, MIN_MCS_SIGMA_DEG = 1e-8, 1e-6
MIN_RANGE_SIGMA_M = 0.001
CONFIG_DECIMALS = 6  # decimals of a metre or degree in the written guess


def simulated_log_path(session_name):
    """Where the log of the session so named is, relative to the working directory."""
    return f"logs/{session_name}.mcap"


def make_rig_config(rig, guesses, args):
    """rigs/<rig>.yaml as a dict, of a mounts.Built; guesses: T_robot_sensor (4, 4) by sensor."""
    xyz_m = max(args.mcs_noise_m, MIN_MCS_SIGMA_M)
    rpy_deg = max(args.mcs_noise_deg, MIN_MCS_SIGMA_DEG)
    bias = _sigma_json(
        max(args.mcs_bias_m, MIN_MCS_SIGMA_M), max(args.mcs_bias_deg, MIN_MCS_SIGMA_DEG)
    )
    mocap = {
        "topics": ["/tf"],
        "map": session_recording.MAP_FRAME,
        "pose_sigma": _sigma_json(xyz_m, rpy_deg),
        "pose_bias_sigma": bias,
    }
    of_guess = _sigma_json(max(args.guess_error_m, 0.005), max(args.guess_error_deg, 0.5), 3**-0.5)
    sensors = {}
    for name, T in guesses.items():
        spec = rig.sensor_specs[name]
        is_camera = name in rig.camera_models
        sensors[name] = {
            "kind": "camera" if is_camera else "lidar",
            "topic": spec.topic + ("/compressed" if is_camera and spec.is_compressed else ""),
            "T_robot_sensor": rounded_pose_json(T),
            "guess_sigma": of_guess,
            **(_lens_config(spec, args) if is_camera else _lidar_config(spec, args)),
        }
    truth = {
        name: {"xyz_m": _float_list(T[:3, 3]), "quat_xyzw": _float_list(pose_to_quat(T))}
        for name, T in rig.T_robot_sensor.items()
    }
    return {
        "body": session_recording.ROBOT_BODY,
        "mocap": mocap,
        "sensors": sensors,
        "truth": truth,
    }


def _lidar_config(spec, args):
    columns, rings = spec.scan_pattern.angular_steps_deg
    return {
        "azimuth_step_deg": round(columns, CONFIG_DECIMALS),
        "elevation_step_deg": round(rings, CONFIG_DECIMALS),
        "azimuth_deg": [-spec.sector_deg, spec.sector_deg],
        "range_sigma_m": max(args.range_noise_m, MIN_RANGE_SIGMA_M),
    }


def _lens_config(spec, args):
    if args.camera_info:
        return {"camera_info": f"{topic_namespace(spec.topic)}/camera_info"}
    return _camera_model_config(spec)


def _camera_model_config(spec):
    params = [float(p) for p in spec.params]
    return {"model": spec.model, "size_px": list(spec.size_px), "params": params}


def rounded_pose_json(T):
    """A pose (4, 4) as configs write it."""
    rpy = np.rad2deg(pose_to_rpy(T))
    return {
        "xyz_m": _float_list(T[:3, 3], CONFIG_DECIMALS),
        "rpy_deg": _float_list(rpy, CONFIG_DECIMALS),
    }


def make_target_config(name, args):
    """targets/<name>.yaml as a dict."""
    spec = dict(SIMULATED_TARGETS[name])
    if args.mount_m or args.mount_deg:
        spec["alignment_sigma"] = _sigma_json(max(args.mount_m, 1e-4), max(args.mount_deg, 1e-2))
    return spec


def write_simulated_config(folder, rig_name, sessions, guesses):
    """Write config.yaml, rigs/<name>.yaml and targets/*.yaml below folder."""
    rig, args, targets = sessions[0].rig, sessions[0].arguments, sessions[0].T_body_target
    logs = {
        s.name: {"rig": rig_name, "log": simulated_log_path(s.name), **_remounted_flag(s)}
        for s in sessions
    }
    files = {"config.yaml": {"sessions": logs, **CONFIG_BY_RIG.get(rig_name, {})}}
    files[f"rigs/{rig_name}.yaml"] = make_rig_config(rig, guesses, args)
    for target in targets:
        files[f"targets/{target}.yaml"] = make_target_config(target, args)
    for path, content in files.items():
        path = folder / path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(
            yaml.dump(content, Dumper=_NoAliasDumper, sort_keys=False, default_flow_style=None)
        )


def _remounted_flag(session):
    """The key of a session whose markers were mounted anew."""
    return {} if np.array_equal(session.T_robot_markers, np.eye(4)) else {"remounted": True}


class _NoAliasDumper(yaml.SafeDumper):
    """Without anchors for what occurs twice."""

    def ignore_aliases(self, data):
        return True


def truth_json(sessions, guesses):
    """All that was drawn, as JSON types, with the arguments.

    Placements and swaps stand at the top of a single session's truth, below `sessions` otherwise.
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
            name: _camera_model_config(rig.sensor_specs[name]) for name in rig.camera_models
        },
        "time_offset_s": args.mcs_late_s,
        "time_drift_ppm": args.mcs_drift_ppm,
        "targets": {name: {"T_body_target": full_pose_json(T)} for name, T in targets.items()},
        **({"sessions": drawn} if len(drawn) > 1 else drawn[sessions[0].name]),
    }


def _session_truth_json(session):
    swaps = [
        {"start_ns": start, "end_ns": end, "bodies": list(pair)}
        for start, end, pair in session.label_swaps
    ]
    placements = [_placement_truth_json(session, k) for k in range(len(session.placement_times_ns))]
    markers = {"T_robot_markers": full_pose_json(session.T_robot_markers)}
    return {"placements": placements, "label_swaps": swaps, **markers}


def _placement_truth_json(session, placement_index):
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


def write_truth(path, sessions, guesses):
    """Write truth.json."""
    path.write_text(json.dumps(truth_json(sessions, guesses), indent=1) + "\n")


def full_pose_json(T):
    """A pose (4, 4) as xyz_m, quat_xyzw and matrix."""
    return {
        "xyz_m": _float_list(T[:3, 3]),
        "quat_xyzw": _float_list(pose_to_quat(T)),
        "matrix": T.tolist(),
    }


def _sigma_json(xyz_m, rpy_deg, scale=1.0):
    return {"xyz_m": float(f"{xyz_m * scale:.5g}"), "rpy_deg": float(f"{rpy_deg * scale:.5g}")}


def _float_list(values, decimals=None):
    values = np.asarray(values, float)
    return (values if decimals is None else np.round(values, decimals)).tolist()
