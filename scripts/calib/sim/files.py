"""The configuration that a user would write for a simulated log, and the truth about it."""

import json

import numpy as np
import yaml

from calib.geometry import to_quat, to_rpy
from calib.sim import record, scene

LOG = "logs/sim.mcap"
MCS_FLOOR_M, MCS_FLOOR_DEG = 1e-6, 0.0001
RANGE_FLOOR_M = 0.001
DECIMALS = 6  # decimals of a metre or degree in the written guess


def rig_config(session, guesses):
    """rigs/sim.yaml as a dict; guesses: T_robot_sensor (4, 4) by sensor."""
    args, camera = session.args, session.rig.camera
    xyz_m = max(args.mcs_noise_m, MCS_FLOOR_M)
    rpy_deg = max(args.mcs_noise_deg, MCS_FLOOR_DEG)
    bias = _sigma(max(args.mcs_bias_m, MCS_FLOOR_M), max(args.mcs_bias_deg, MCS_FLOOR_DEG))
    mocap = {
        "topics": ["/tf"],
        "map": record.MAP,
        "pose_sigma": _sigma(xyz_m, rpy_deg),
        "pose_bias_sigma": bias,
    }
    of_guess = _sigma(max(args.guess_error_m, 0.005), max(args.guess_error_deg, 0.5), 3**-0.5)
    common = {
        name: {
            "topic": record.TOPICS[name],
            "T_robot_sensor": written_pose(T),
            "guess_sigma": of_guess,
        }
        for name, T in guesses.items()
    }
    velodyne = {"azimuth_step_deg": 0.2, "range_sigma_m": max(args.range_noise_m, RANGE_FLOOR_M)}
    pinhole = {
        "model": camera.model,
        "size_px": list(camera.size),
        "params": list(camera.params[:8]),
    }
    sensors = {
        "velodyne": {"kind": "lidar", **common["velodyne"], **velodyne},
        "camera": {"kind": "camera", **common["camera"], **pinhole},
    }
    return {"body": record.ROBOT, "mocap": mocap, "sensors": sensors}


def written_pose(T):
    """A pose (4, 4) as configs write it."""
    rpy = np.rad2deg(to_rpy(T))
    return {"xyz_m": _floats(T[:3, 3], DECIMALS), "rpy_deg": _floats(rpy, DECIMALS)}


def target_config(name, args):
    """targets/<name>.yaml as a dict."""
    spec = dict(scene.TARGETS[name])
    if args.mount_m or args.mount_deg:
        spec["alignment_sigma"] = _sigma(max(args.mount_m, 1e-4), max(args.mount_deg, 1e-2))
    return spec


def write_config(folder, session, guesses):
    """Write config.yaml, rigs/sim.yaml and targets/*.yaml below folder."""
    files = {
        "config.yaml": {"sessions": {"sim": {"rig": "sim", "log": LOG}}},
        "rigs/sim.yaml": rig_config(session, guesses),
    }
    for name in session.mounts:
        files[f"targets/{name}.yaml"] = target_config(name, session.args)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.dump(content, Dumper=_Plain, sort_keys=False, default_flow_style=None))


class _Plain(yaml.SafeDumper):
    """Without anchors for what occurs twice."""

    def ignore_aliases(self, data):
        return True


def truth(session, guesses):
    """All that was drawn, as JSON types, with the arguments."""
    rig = session.rig
    return {
        "arguments": {k: v for k, v in sorted(vars(session.args).items()) if k != "out"},
        "sensors": {
            name: {"T_robot_sensor": full_pose(T), "guess": full_pose(guesses[name])}
            for name, T in rig.sensors.items()
        },
        "camera": {
            "model": rig.camera.model,
            "params": list(rig.camera.params),
            "size_px": list(rig.camera.size),
        },
        "time_offset_s": session.args.mcs_late_s,
        "targets": {name: {"T_body_target": full_pose(T)} for name, T in session.mounts.items()},
        "placements": [_placement(session, k) for k in range(len(session.times))],
    }


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


def write_truth(path, session, guesses):
    """Write truth.json."""
    path.write_text(json.dumps(truth(session, guesses), indent=1) + "\n")


def full_pose(T):
    """A pose (4, 4) as xyz_m, quat_xyzw and matrix."""
    return {"xyz_m": _floats(T[:3, 3]), "quat_xyzw": _floats(to_quat(T)), "matrix": T.tolist()}


def _sigma(xyz_m, rpy_deg, scale=1.0):
    return {"xyz_m": round(float(xyz_m * scale), 6), "rpy_deg": round(float(rpy_deg * scale), 6)}


def _floats(values, decimals=None):
    values = np.asarray(values, float)
    return (values if decimals is None else np.round(values, decimals)).tolist()
