"""What labs get wrong, alone and all together: what is found of it, and what it costs the poses."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarking.accuracy.error_metrics import compute_nees, compute_pose_error, sigma_mm_deg
from calib.geometry.se3 import invert_pose, se3_log

LAB_ARGUMENTS = (
    "--rig sim --placements 12 --hold-s 0.8 --move-s 0.7 --sector-deg 80 --camera-hz 5 "
    "--range-noise-m 0.005 --image-noise 1.8 --blur-px 0.7 --mcs-noise-m 0.0001 "
    "--mcs-noise-deg 0.01 --mcs-bias-m 0.00005 --mcs-bias-deg 0.005"
)
FOCAL_LENGTH_FACTOR = 1.005  # focal length as the config states it, over the true one
TIME_OFFSET_ARGUMENTS = "--mcs-late-s 0.025"
MOUNT_ARGUMENTS = "--mount-m 0.006 --mount-deg 1"
BEAM_BIAS_ARGUMENTS = "--beam-bias-m 0.01"
NO_FAULT, ALL_FAULTS = "none", "all"
LAB_FAULTS = {  # title, more arguments of simulate.py, whether the lens is stated wrong
    NO_FAULT: ("none", "", False),
    "clock": ("MCS stamps 25 ms late", TIME_OFFSET_ARGUMENTS, False),
    "clock far": ("MCS stamps 200 ms late", "--mcs-late-s 0.2", False),
    "drift": (
        "MCS stamps 25 ms late, growing by 200 ppm",
        f"{TIME_OFFSET_ARGUMENTS} --mcs-drift-ppm 200",
        False,
    ),
    "mount": ("targets 6 mm and 1° from where they are said to be", MOUNT_ARGUMENTS, False),
    "clock and mount": (
        "MCS stamps 25 ms late, targets 6 mm and 1° off",
        f"{TIME_OFFSET_ARGUMENTS} {MOUNT_ARGUMENTS}",
        False,
    ),
    "lens": ("focal length stated 0.5 % too long", "", True),
    "beams": ("beams of the lidar off by 10 mm, one by one", BEAM_BIAS_ARGUMENTS, False),
    ALL_FAULTS: (
        "clock, mount, lens and beams",
        f"{TIME_OFFSET_ARGUMENTS} {MOUNT_ARGUMENTS} {BEAM_BIAS_ARGUMENTS}",
        True,
    ),
}
QUICK_FAULTS = (NO_FAULT, ALL_FAULTS)
DISABLED_ESTIMATES = {
    "time_offset": False,
    "target_alignment": False,
    "intrinsics": False,
    "lidar_corrections": False,
}


@dataclass(frozen=True)
class LabOutcome:
    """What came of one log: errors {sensor: (mm, deg)} and σ likewise, nees {sensor: over 6}; what
    was found {quantity: (error, σ)} of the faults, in ms, ppm, mm, deg, px; verdict, and its
    first reason."""

    errors: dict[str, tuple[float, float]]
    sigma: dict[str, tuple[float, float]]
    nees_ratio: dict[str, float]
    fault_errors: dict[str, tuple[float, float]]
    verdict: str
    first_finding: str


def lab_log_name(fault: str, seed: int) -> str:
    """Of a simulated log."""
    return f"lab-{fault.replace(' ', '-')}-s{seed}"


def plan_lab_simulations(faults: Sequence[str], seeds: Sequence[int]) -> dict[str, list[str]]:
    """{folder: arguments of simulate.py}."""
    return {
        lab_log_name(fault, seed): f"{LAB_ARGUMENTS} --seed {seed} {LAB_FAULTS[fault][1]}".split()
        for fault in faults
        for seed in seeds
    }


def lab_estimate_options(fault: str, has_options_on: bool) -> dict[str, Any]:
    """Block solve.estimate of a fault's config, with all that it asks for on, or all off."""
    return {"intrinsics": LAB_FAULTS[fault][2]} if has_options_on else DISABLED_ESTIMATES


def make_lab_rig(fault: str, rig_config: dict[str, Any]) -> dict[str, Any]:
    """The simulated rig's config, without the truth, as the fault's lab states it."""
    sensors = {n: dict(s) for n, s in rig_config["sensors"].items()}
    if LAB_FAULTS[fault][2]:
        fx, fy, *rest = sensors["camera"]["params"]
        sensors["camera"]["params"] = [FOCAL_LENGTH_FACTOR * fx, FOCAL_LENGTH_FACTOR * fy, *rest]
    return {k: v for k, v in rig_config.items() if k != "truth"} | {"sensors": sensors}


def read_lab_outcome(results: Path, log: Path) -> LabOutcome:
    """The Outcome of results/<rig> of a log's folder."""
    truth = json.loads((log / "truth.json").read_text())
    calibration = json.loads((results / "calibration.json").read_text())
    reasons = json.loads((results / "verdict.json").read_text())["findings"]
    solved = {n: s for n, s in calibration["sensors"].items() if s["T_robot_sensor"]}
    poses = {
        n: (
            np.array(truth["sensors"][n]["T_robot_sensor"]["matrix"]),
            np.array(s["T_robot_sensor"]["matrix"]),
        )
        for n, s in solved.items()
    }
    return LabOutcome(
        errors={n: compute_pose_error(*T) for n, T in poses.items()},
        sigma={n: sigma_mm_deg(np.array(s["covariance"])) for n, s in solved.items()},
        nees_ratio={
            n: compute_nees(*poses[n], np.array(s["covariance"])) for n, s in solved.items()
        },
        fault_errors=dict(
            _clock_errors(solved, truth)
            + _mount_errors(calibration, truth)
            + _lens_errors(solved, truth)
        ),
        verdict=calibration["verdict"],
        first_finding=reasons[0]["text"] if reasons else "",
    )


def _clock_errors(
    solved_sensors: dict[str, Any], truth: dict[str, Any]
) -> list[tuple[str, tuple[float, float]]]:
    late, ppm, out = truth["time_offset_s"], truth["time_drift_ppm"], []
    for name, sensor in solved_sensors.items():
        for session in (sensor["clock_drift"] or {}).values():
            drift = session["drift_ppm"]
            out.append((f"drift of {name}, ppm", (drift["value"] - ppm, drift["sigma"])))
        # Where the offset grows it is told in the middle of the session, of which truth says less.
        if sensor["time_offset_s"] and not ppm:
            found = sensor["time_offset_s"]
            off = 1e3 * (found["value"] - late), 1e3 * found["sigma"]
            out.append((f"offset of {name}, ms", off))
    return out


def _mount_errors(
    calibration: dict[str, Any], truth: dict[str, Any]
) -> list[tuple[str, tuple[float, float]]]:
    out = []
    for name, found in sorted(calibration["targets"].items()):
        if found:
            T = np.array(truth["targets"][name]["T_body_target"]["matrix"])
            off = se3_log(invert_pose(T) @ np.array(found["T_body_target"]["matrix"])).reshape(2, 3)
            sigma = np.sqrt(np.diag(found["covariance"])).reshape(2, 3)
            if name == "cylinder":  # about its own axis nothing tells it, and nothing needs it
                off[1, 0] = sigma[1, 0] = 0.0
            for i, (unit, scale) in enumerate((("mm", 1e3), ("°", np.degrees(1.0)))):
                sizes = scale * np.linalg.norm(off[i]), scale * np.linalg.norm(sigma[i])
                out.append((f"{name}, {unit}", sizes))
    return out


def _lens_errors(
    solved_sensors: dict[str, Any], truth: dict[str, Any]
) -> list[tuple[str, tuple[float, float]]]:
    out = []
    for name, sensor in solved_sensors.items():
        if sensor["intrinsics"]:
            known = truth["cameras"][name]["params"][:4]
            params, sigma = (sensor["intrinsics"][k][:4] for k in ("params", "sigma"))
            for what, a, b, s in zip(("fx", "fy", "cx", "cy"), params, known, sigma, strict=True):
                out.append((f"{what} of {name}, px", (a - b, s)))
    return out
