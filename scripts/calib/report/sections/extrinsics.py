"""Poses of the sensors: initial guess, result with σ, and the error where the truth is known.

A pose is printed as six numbers: x, y, z of the origin of the sensor in the robot frame, mm, and
roll, pitch, yaw, deg, with R = Rz(yaw) Ry(pitch) Rx(roll). Each σ belongs to the number beside it.
Near a pitch of ±90° (gimbal lock) roll and yaw alone are meaningless: σ and differences are then
those of rotations about x, y, z of the robot.
"""

import warnings
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.geometry.se3 import (
    invert_pose,
    pose_to_rpy,
    rotation_angle,
    se3_log,
    so3_log,
    transform_points,
)
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.data.run_data import ReportRun
from calib.report.number_format import (
    DASH,
    choose_decimals,
    format_count,
    format_decimals,
    format_number,
    format_percent,
)

POSE_NUMBER_UNITS = (
    ("x", "mm"),
    ("y", "mm"),
    ("z", "mm"),
    ("roll", "°"),
    ("pitch", "°"),
    ("yaw", "°"),
)
GIMBAL_LOCK_COS = 0.1  # cosine of the pitch below which roll and yaw alone are meaningless
NEES_PER_DOF_95 = (0.206, 2.408)  # contains NEES / 6 of a correct covariance in 95 of 100 cases


class PoseError(NamedTuple):
    """Error of a pose: mm, deg, and NEES / 6."""

    mm: float
    deg: float
    nees: float


def xyz_rpy_mm_deg(T: np.ndarray) -> np.ndarray:
    """Return x, y, z, mm, and roll, pitch, yaw, deg, (6,) of T (4, 4)."""
    with warnings.catch_warnings():
        # At a pitch of ±90° SciPy sets one of the two angles to 0 and warns.
        warnings.simplefilter("ignore", UserWarning)
        return np.concatenate([T[:3, 3] * MM_PER_M, pose_to_rpy(T) * DEG_PER_RAD])


def is_gimbal_locked(T: np.ndarray) -> bool:
    """Return whether the x axis of T (4, 4) is so near to ±z that roll and yaw are meaningless."""
    return bool(np.hypot(T[0, 0], T[1, 0]) < GIMBAL_LOCK_COS)


def xyz_rpy_sigma(T: np.ndarray, covariance: np.ndarray | list[list[float]]) -> np.ndarray:
    """Return the σ (6,) of xyz_rpy_mm_deg(T), in mm and deg.

    covariance (6, 6): of the right perturbation of T. In gimbal lock: σ of the rotations about
    x, y, z of the robot.
    """
    J = np.zeros((6, 6))
    J[:3, :3] = J[3:, 3:] = T[:3, :3]
    if not is_gimbal_locked(T):
        roll, pitch, _ = pose_to_rpy(T)
        # Rates about the axes of the sensor from the rates of roll, pitch and yaw.
        from_rates = [
            [1.0, 0.0, -np.sin(pitch)],
            [0.0, np.cos(roll), np.cos(pitch) * np.sin(roll)],
            [0.0, -np.sin(roll), np.cos(pitch) * np.cos(roll)],
        ]
        J[3:, 3:] = np.linalg.inv(from_rates)
    scale = np.repeat([MM_PER_M, DEG_PER_RAD], 3)
    return np.sqrt(np.diag(J @ np.asarray(covariance) @ J.T)) * scale


def xyz_rpy_difference(T: np.ndarray, T_reference: np.ndarray) -> np.ndarray:
    """Return xyz_rpy_mm_deg(T) - xyz_rpy_mm_deg(T_reference), (6,), angles within ±180°.

    In gimbal lock: the rotation about x, y, z of the robot from the reference to T.
    """
    if is_gimbal_locked(T):
        rotation = so3_log(T[:3, :3] @ T_reference[:3, :3].T) * DEG_PER_RAD
        return np.concatenate([(T - T_reference)[:3, 3] * MM_PER_M, rotation])
    d = xyz_rpy_mm_deg(T) - xyz_rpy_mm_deg(T_reference)
    return np.concatenate([d[:3], (d[3:] + 180) % 360 - 180])


def pose_distance_mm_deg(T: np.ndarray, T_reference: np.ndarray) -> tuple[float, float]:
    """Return the distance, mm, and the angle, deg, between two poses (4, 4)."""
    distance = np.linalg.norm(T[:3, 3] - T_reference[:3, 3]) * MM_PER_M
    return float(distance), float(np.degrees(rotation_angle(invert_pose(T_reference) @ T)))


def pose_error_nees(
    T: np.ndarray, covariance: np.ndarray | list[list[float]], T_true: np.ndarray
) -> PoseError:
    """Return the error of an estimate T with its covariance (6, 6)."""
    xi = se3_log(invert_pose(T_true) @ T)
    nees = xi @ np.linalg.solve(np.asarray(covariance), xi)
    mm, deg = pose_distance_mm_deg(T, T_true)
    return PoseError(mm, deg, float(nees / 6))


def choose_pose_decimals(sigma: np.ndarray) -> list[int]:
    """Return decimals (6,) that show two digits of the smallest σ of position and rotation."""
    return [choose_decimals(s) for s in np.repeat(np.reshape(sigma, (2, 3)).min(1), 3)]


def format_pose_numbers(
    values: Iterable[float], decimals: Sequence[int], has_plus_sign: bool = False
) -> list[str]:
    """Format six values; has_plus_sign: write a plus before positive values."""
    return [
        ("+" if has_plus_sign and value > 0 else "") + format_decimals(value, n)
        for value, n in zip(values, decimals, strict=True)
    ]


def format_pose_error(
    T: np.ndarray, covariance: np.ndarray | list[list[float]], T_true: np.ndarray | None
) -> dict[str, Any] | None:
    """Return the error of an estimate as text; None without the truth."""
    if T_true is None:
        return None
    error = pose_error_nees(T, covariance, T_true)
    low, high = NEES_PER_DOF_95
    return {
        "mm": format_number(error.mm, 2),
        "deg": format_number(error.deg, 2),
        "nees": format_number(error.nees, 2),
        "sigmas": format_number(np.sqrt(error.nees), 2),
        "is_nees_plausible": low <= error.nees <= high,
    }


def tabulate_pose(
    T: np.ndarray,
    covariance: np.ndarray | list[list[float]],
    T_guess: np.ndarray | None = None,
    T_true: np.ndarray | None = None,
) -> list[dict[str, str | None]]:
    """Return one row per number of a pose; None for what is not known.

    Columns: value, sigma, guess, guess_change, error, error_in_sigma.
    """
    sigma = xyz_rpy_sigma(T, covariance)
    decimals = choose_pose_decimals(sigma)
    columns: dict[str, Sequence[str | None]] = {
        "value": format_pose_numbers(xyz_rpy_mm_deg(T), decimals),
        "sigma": format_pose_numbers(sigma, decimals),
    }
    columns |= dict.fromkeys(("guess", "guess_change", "error", "error_in_sigma"), [None] * 6)
    if T_guess is not None:
        change = xyz_rpy_difference(T, T_guess)
        columns["guess"] = format_pose_numbers(xyz_rpy_mm_deg(T_guess), decimals)
        columns["guess_change"] = format_pose_numbers(change, decimals, has_plus_sign=True)
    if T_true is not None:
        error = xyz_rpy_difference(T, T_true)
        columns["error"] = format_pose_numbers(error, decimals, has_plus_sign=True)
        columns["error_in_sigma"] = format_pose_numbers(error / sigma, [1] * 6, has_plus_sign=True)
    rows: list[dict[str, str | None]] = []
    for i, (name, unit) in enumerate(POSE_NUMBER_UNITS):
        rows.append({"name": name, "unit": unit, **{k: v[i] for k, v in columns.items()}})
    return rows


def summarize_sensor_pose(run: ReportRun, name: str) -> dict[str, Any]:
    """Return the card of one sensor: counts and, with a pose, its numbers in all forms."""
    sensor, T = run.sensors[name], run.T_robot_sensor(name)
    card = {"name": name, "sensor": sensor, "has_pose": T is not None}
    card |= {k: format_count(sensor[k]) for k in ("placements", "observations", "points")}
    card["rejected"] = format_percent(sensor["rejected_share"])
    card["residual"] = format_residual_rms(**sensor["residual"])
    if T is None:
        return card
    covariance, T_true = sensor["covariance"], run.T_robot_sensor_true(name)
    quat_xyzw = sensor["T_robot_sensor"]["quat_xyzw"]
    return card | {
        "rows": tabulate_pose(T, covariance, initial_guess_pose(sensor), T_true),
        "guess_change": format_guess_change(sensor, T),
        "error": format_pose_error(T, covariance, T_true),
        "least_certain": format_least_certain(sensor["least_certain"]),
        "is_gimbal_locked": is_gimbal_locked(T),
        "example_point": _format_vector(transform_points(T, [1.0, 0.0, 0.0]), 4),
        "quat_xyzw": _format_vector(quat_xyzw, 8),
        "matrix": "\n".join(" ".join(f"{v: .9f}" for v in row) for row in T),
    }


def _format_vector(values: Iterable[float], decimals: int) -> str:
    return ", ".join(format_decimals(v, decimals) for v in values)


def initial_guess_pose(sensor: dict[str, Any]) -> np.ndarray | None:
    """Return the initial guess of T_robot_sensor (4, 4), or None."""
    T = sensor["guess"]["T_robot_sensor"]
    return None if T is None else np.array(T["matrix"])


def format_least_certain(block: dict[str, Any]) -> str:
    """Format the least certain direction: `rotation about z of the robot body, σ 0.02 °`."""
    is_rotation = block["direction"].startswith("rotation")
    sigma = format_number(block["sigma"] * (DEG_PER_RAD if is_rotation else MM_PER_M), 2)
    return f"{block['direction']}, σ {sigma} {'°' if is_rotation else 'mm'}"


def format_residual_rms(rms: float | None, unit: str) -> str:
    """Format a residual of calibration.json in mm or px."""
    if rms is None:
        return DASH
    return f"{format_number(rms * MM_PER_M)} mm" if unit == "m" else f"{format_number(rms)} {unit}"


def format_guess_change(sensor: dict[str, Any], T: np.ndarray) -> dict[str, str] | None:
    """Return the change from the initial guess to T: mm, deg, and in σ of the guess."""
    T_guess = initial_guess_pose(sensor)
    if T_guess is None:
        return None
    mm, deg = pose_distance_mm_deg(T, T_guess)
    in_sigma = np.abs(se3_log(invert_pose(T_guess) @ T)) / sensor["guess"]["sigma"]
    return {
        "mm": format_number(mm),
        "deg": format_number(deg),
        "sigmas": format_number(in_sigma.max(), 2),
        "source": sensor["guess"]["source"],
    }
