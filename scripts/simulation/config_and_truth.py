"""The configuration that a user would write for simulated logs, and the truth about them."""

import json

import numpy as np
import yaml

from calib.geometry.se3 import to_quat, to_rpy
from simulation import record_session, simulated_rigs
from simulation.world import room_scene

MCS_FLOOR_M, MCS_FLOOR_DEG = 1e-8, 1e-6
RANGE_FLOOR_M = 0.001
DECIMALS = 6  # decimals of a metre or degree in the written guess


def log_path(session):
    """Where the log of the session so named is, relative to the working directory."""
    return f"logs/{session}.mcap"


def rig_config(rig, guesses, args):
    """rigs/<rig>.yaml as a dict, of a mounts.Built; guesses: T_robot_sensor (4, 4) by sensor."""
    xyz_m = max(args.mcs_noise_m, MCS_FLOOR_M)
    rpy_deg = max(args.mcs_noise_deg, MCS_FLOOR_DEG)
    bias = _sigma(max(args.mcs_bias_m, MCS_FLOOR_M), max(args.mcs_bias_deg, MCS_FLOOR_DEG))
    mocap = {
        "topics": ["/tf"],
        "map": record_session.MAP,
        "pose_sigma": _sigma(xyz_m, rpy_deg),
        "pose_bias_sigma": bias,
    }
    of_guess = _sigma(max(args.guess_error_m, 0.005), max(args.guess_error_deg, 0.5), 3**-0.5)
    sensors = {}
    for name, T in guesses.items():
        spec = rig.specs[name]
        is_camera = name in rig.cameras
        sensors[name] = {
            "kind": "camera" if is_camera else "lidar",
            "topic": spec.topic + ("/compressed" if is_camera and spec.compressed else ""),
            "T_robot_sensor": written_pose(T),
            "guess_sigma": of_guess,
            **(_lens(spec, args) if is_camera else _lidar(spec, args)),
        }
    truth = {
        name: {"xyz_m": _floats(T[:3, 3]), "quat_xyzw": _floats(to_quat(T))}
        for name, T in rig.sensors.items()
    }
    return {"body": record_session.ROBOT, "mocap": mocap, "sensors": sensors, "truth": truth}


def _lidar(spec, args):
    columns, rings = spec.scans.steps_deg
    return {
        "azimuth_step_deg": round(columns, DECIMALS),
        "elevation_step_deg": round(rings, DECIMALS),
        "azimuth_deg": [-spec.sector_deg, spec.sector_deg],
        "range_sigma_m": max(args.range_noise_m, RANGE_FLOOR_M),
    }


def _lens(spec, args):
    if args.camera_info:
        return {"camera_info": f"{record_session.namespace(spec.topic)}/camera_info"}
    return _camera(spec)


def _camera(spec):
    params = [float(p) for p in spec.params]
    return {"model": spec.model, "size_px": list(spec.size_px), "params": params}


def written_pose(T):
    """A pose (4, 4) as configs write it."""
    rpy = np.rad2deg(to_rpy(T))
    return {"xyz_m": _floats(T[:3, 3], DECIMALS), "rpy_deg": _floats(rpy, DECIMALS)}


def target_config(name, args):
    """targets/<name>.yaml as a dict."""
    spec = dict(room_scene.TARGETS[name])
    if args.mount_m or args.mount_deg:
        spec["alignment_sigma"] = _sigma(max(args.mount_m, 1e-4), max(args.mount_deg, 1e-2))
    return spec


def write_config(folder, name, sessions, guesses):
    """Write config.yaml, rigs/<name>.yaml and targets/*.yaml below folder."""
    rig, args, targets = sessions[0].rig, sessions[0].args, sessions[0].mounts
    logs = {s.name: {"rig": name, "log": log_path(s.name), **_anew(s)} for s in sessions}
    files = {"config.yaml": {"sessions": logs, **simulated_rigs.SETTINGS.get(name, {})}}
    files[f"rigs/{name}.yaml"] = rig_config(rig, guesses, args)
    for target in targets:
        files[f"targets/{target}.yaml"] = target_config(target, args)
    for path, content in files.items():
        path = folder / path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.dump(content, Dumper=_Plain, sort_keys=False, default_flow_style=None))


def _anew(session):
    """The key of a session whose markers were mounted anew."""
    return {} if np.array_equal(session.markers, np.eye(4)) else {"remounted": True}


class _Plain(yaml.SafeDumper):
    """Without anchors for what occurs twice."""

    def ignore_aliases(self, data):
        return True


def truth(sessions, guesses):
    """All that was drawn, as JSON types, with the arguments.

    Placements and swaps stand at the top of a single session's truth, below `sessions` otherwise.
    """
    rig, args, targets = sessions[0].rig, sessions[0].args, sessions[0].mounts
    drawn = {session.name: _session(session) for session in sessions}
    return {
        "arguments": {k: v for k, v in sorted(vars(args).items()) if k != "out"},
        "sensors": {
            name: {
                "T_robot_sensor": full_pose(T),
                "guess": full_pose(guesses[name]),
                **({} if name in rig.cameras else {"beam_bias_m": _floats(rig.beam_bias[name])}),
            }
            for name, T in rig.sensors.items()
        },
        "cameras": {name: _camera(rig.specs[name]) for name in rig.cameras},
        "time_offset_s": args.mcs_late_s,
        "time_drift_ppm": args.mcs_drift_ppm,
        "targets": {name: {"T_body_target": full_pose(T)} for name, T in targets.items()},
        **({"sessions": drawn} if len(drawn) > 1 else drawn[sessions[0].name]),
    }


def _session(session):
    swaps = [
        {"start_ns": start, "end_ns": end, "bodies": list(pair)}
        for start, end, pair in session.swaps
    ]
    placements = [_placement(session, k) for k in range(len(session.times))]
    markers = {"T_robot_markers": full_pose(session.markers)}
    return {"placements": placements, "label_swaps": swaps, **markers}


def _placement(session, k):
    start, end = (int(t) for t in session.times[k])
    T_world_robot = session.knots["robot"][k]
    return {
        "start_ns": start,
        "end_ns": end,
        "T_world_robot": full_pose(T_world_robot),
        "T_robot_target": {
            name: full_pose(np.linalg.solve(T_world_robot, session.knots[name][k]))
            for name in session.mounts
        },
        "mcs_bias": {
            name: {"xyz_m": _floats(b[k, :3]), "rotvec_deg": _floats(np.rad2deg(b[k, 3:]))}
            for name, b in session.biases.items()
        },
    }


def write_truth(path, sessions, guesses):
    """Write truth.json."""
    path.write_text(json.dumps(truth(sessions, guesses), indent=1) + "\n")


def full_pose(T):
    """A pose (4, 4) as xyz_m, quat_xyzw and matrix."""
    return {"xyz_m": _floats(T[:3, 3]), "quat_xyzw": _floats(to_quat(T)), "matrix": T.tolist()}


def _sigma(xyz_m, rpy_deg, scale=1.0):
    return {"xyz_m": float(f"{xyz_m * scale:.5g}"), "rpy_deg": float(f"{rpy_deg * scale:.5g}")}


def _floats(values, decimals=None):
    values = np.asarray(values, float)
    return (values if decimals is None else np.round(values, decimals)).tolist()
