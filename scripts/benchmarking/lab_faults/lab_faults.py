"""Common faults of labs, one by one and together: how well they are estimated, and pose errors."""

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
FOCAL_LENGTH_FACTOR = 1.005  # focal length in the config over the true one
TIME_OFFSET_ARGUMENTS = "--mcs-late-s 0.025"
MOUNT_ARGUMENTS = "--mount-m 0.006 --mount-deg 1"
BEAM_BIAS_ARGUMENTS = "--beam-bias-m 0.01"
NO_FAULT, ALL_FAULTS = "none", "all"
LAB_FAULTS = {  # title, additional arguments of simulate.py, whether the config's lens is wrong
    NO_FAULT: ("none", "", False),
    "clock": ("MCS stamps 25 ms late", TIME_OFFSET_ARGUMENTS, False),
    "clock far": ("MCS stamps 200 ms late", "--mcs-late-s 0.2", False),
    "drift": (
        "MCS stamps 25 ms late, growing by 200 ppm",
        f"{TIME_OFFSET_ARGUMENTS} --mcs-drift-ppm 200",
        False,
    ),
    "mount": ("targets 6 mm and 1° off their mount in the config", MOUNT_ARGUMENTS, False),
    "clock and mount": (
        "MCS stamps 25 ms late, targets 6 mm and 1° off",
        f"{TIME_OFFSET_ARGUMENTS} {MOUNT_ARGUMENTS}",
        False,
    ),
    "lens": ("focal length in the config 0.5 % too long", "", True),
    "beams": ("range bias of 10 mm in each lidar beam", BEAM_BIAS_ARGUMENTS, False),
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
    """Result of one log.

    errors, sigma: (mm, deg) by sensor; nees_ratio: NEES/6 by sensor; fault_errors: (error, σ) of
    the estimated faults by quantity, in ms, ppm, mm, ° or px; first_finding: of the verdict, or "".
    """

    errors: dict[str, tuple[float, float]]
    sigma: dict[str, tuple[float, float]]
    nees_ratio: dict[str, float]
    fault_errors: dict[str, tuple[float, float]]
    verdict: str
    first_finding: str


def lab_log_name(fault: str, seed: int) -> str:
    """Return the folder name of a simulated log."""
    return f"lab-{fault.replace(' ', '-')}-s{seed}"


def plan_lab_simulations(faults: Sequence[str], seeds: Sequence[int]) -> dict[str, list[str]]:
    """Return the arguments of simulate.py by folder."""
    return {
        lab_log_name(fault, seed): f"{LAB_ARGUMENTS} --seed {seed} {LAB_FAULTS[fault][1]}".split()
        for fault in faults
        for seed in seeds
    }


def lab_estimate_options(fault: str, has_options_on: bool) -> dict[str, Any]:
    """Return block solve.estimate of a config, with the corrections of a fault on, or all off."""
    return {"intrinsics": LAB_FAULTS[fault][2]} if has_options_on else DISABLED_ESTIMATES


def make_lab_rig(fault: str, rig_config: dict[str, Any]) -> dict[str, Any]:
    """Return the simulated rig config without the truth, with a wrong lens if the fault has one."""
    sensors = {n: dict(s) for n, s in rig_config["sensors"].items()}
    if LAB_FAULTS[fault][2]:
        fx, fy, *rest = sensors["camera"]["params"]
        sensors["camera"]["params"] = [FOCAL_LENGTH_FACTOR * fx, FOCAL_LENGTH_FACTOR * fy, *rest]
    return {k: v for k, v in rig_config.items() if k != "truth"} | {"sensors": sensors}


def read_lab_outcome(results: Path, log: Path) -> LabOutcome:
    """Read the result of one log.

    results: the folder results/<rig>; log: the simulated log, with truth.json.
    """
    truth = json.loads((log / "truth.json").read_text())
    calibration = json.loads((results / "calibration.json").read_text())
    findings = json.loads((results / "verdict.json").read_text())["findings"]
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
        first_finding=findings[0]["text"] if findings else "",
    )


def _clock_errors(
    solved_sensors: dict[str, Any], truth: dict[str, Any]
) -> list[tuple[str, tuple[float, float]]]:
    late, ppm, out = truth["time_offset_s"], truth["time_drift_ppm"], []
    for name, sensor in solved_sensors.items():
        for session in (sensor["clock_drift"] or {}).values():
            drift = session["drift_ppm"]
            out.append((f"drift of {name}, ppm", (drift["value"] - ppm, drift["sigma"])))
        # With drift, the offset is that of the middle of the session, which truth.json lacks.
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
            if name == "cylinder":  # a rotation about its axis cannot be seen
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
