"""Poses as they are told: first guess, result with σ, correction, and error where truth is known.

A pose is told in six numbers: x, y, z of the sensor's origin in the robot's frame, mm, and roll,
pitch, yaw, deg, with R = Rz(yaw) Ry(pitch) Rx(roll). Each σ is that of the number beside it. Near a
pitch of ±90° roll and yaw have no meaning of their own: σ and differences are then those of turns
about x, y, z of the robot.
"""

import itertools
import warnings

import numpy as np

from calib.geometry.se3 import (
    invert_pose,
    pose_to_rpy,
    relative_pose_covariance,
    rotation_angle,
    se3_log,
    so3_log,
    transform_points,
)
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
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
GIMBAL_LOCK_COS = 0.1  # cosine of a pitch below which roll and yaw have no meaning of their own
NEES_PER_DOF_95 = (0.206, 2.408)  # NEES / 6 of an honest covariance lies here 95 times of 100


def xyz_rpy_mm_deg(T):
    """(6,) x, y, z, mm, and roll, pitch, yaw, deg, of T (4, 4)."""
    with warnings.catch_warnings():
        # At a pitch of ±90° one of the two angles is chosen, which is as good as any other.
        warnings.simplefilter("ignore", UserWarning)
        return np.concatenate([T[:3, 3] * MM_PER_M, pose_to_rpy(T) * DEG_PER_RAD])


def is_gimbal_locked(T):
    """Whether roll and yaw of T (4, 4) have no meaning of their own: its x axis is near ±z."""
    return np.hypot(T[0, 0], T[1, 0]) < GIMBAL_LOCK_COS


def xyz_rpy_sigma(T, covariance):
    """(6,) standard deviations of numbers(T); of turns about x, y, z of the robot where locked."""
    J = np.zeros((6, 6))
    J[:3, :3] = J[3:, 3:] = T[:3, :3]
    if not is_gimbal_locked(T):
        roll, pitch, _ = pose_to_rpy(T)
        # Rates about the sensor's axes from those of roll, pitch and yaw.
        from_rates = [
            [1.0, 0.0, -np.sin(pitch)],
            [0.0, np.cos(roll), np.cos(pitch) * np.sin(roll)],
            [0.0, -np.sin(roll), np.cos(pitch) * np.cos(roll)],
        ]
        J[3:, 3:] = np.linalg.inv(from_rates)
    return np.sqrt(np.diag(J @ np.asarray(covariance) @ J.T)) * np.repeat(
        [MM_PER_M, DEG_PER_RAD], 3
    )


def xyz_rpy_difference(T, T_reference):
    """(6,) numbers(T) less numbers(T_from), the angles within ±180°; where locked, the turn about
    x, y, z of the robot that leads from one to the other."""
    if is_gimbal_locked(T):
        turn = so3_log(T[:3, :3] @ T_reference[:3, :3].T) * DEG_PER_RAD
        return np.concatenate([(T - T_reference)[:3, 3] * MM_PER_M, turn])
    d = xyz_rpy_mm_deg(T) - xyz_rpy_mm_deg(T_reference)
    return np.concatenate([d[:3], (d[3:] + 180) % 360 - 180])


def pose_distance_mm_deg(T, T_reference):
    """How far two poses lie apart: mm, and deg of the rotation between them."""
    apart = np.linalg.norm(T[:3, 3] - T_reference[:3, 3]) * MM_PER_M
    return float(apart), float(np.degrees(rotation_angle(invert_pose(T_reference) @ T)))


def pose_error_nees(T, covariance, T_true):
    """(mm, deg, NEES / 6) of an estimate T against the truth."""
    xi = se3_log(invert_pose(T_true) @ T)
    nees = xi @ np.linalg.solve(np.asarray(covariance), xi)
    return *pose_distance_mm_deg(T, T_true), float(nees / 6)


def choose_pose_decimals(sigma):
    """Decimals (6,) that show the least σ of the position, and of the rotation, in two digits."""
    return [choose_decimals(s) for s in np.repeat(np.reshape(sigma, (2, 3)).min(1), 3)]


def format_pose_numbers(values, decimals, has_plus_sign=False):
    """Values (6,) as text; has_plus_sign: a plus before what is positive."""
    told = [format_decimals(v, p) for v, p in zip(values, decimals, strict=True)]
    return [f"+{t}" if has_plus_sign and v > 0 else t for t, v in zip(told, values, strict=True)]


def format_pose_error(T, covariance, T_true):
    """What is said of an estimate against the truth; None without one."""
    if T_true is None:
        return None
    mm, deg, nees = pose_error_nees(T, covariance, T_true)
    told = {
        "mm": format_number(mm, 2),
        "deg": format_number(deg, 2),
        "nees": format_number(nees, 2),
    }
    inside = NEES_PER_DOF_95[0] <= nees <= NEES_PER_DOF_95[1]
    return told | {"sigmas": format_number(np.sqrt(nees), 2), "inside": inside}


def tabulate_pose(T, covariance, T_guess, T_true):
    """The six numbers of a pose with all that is known of each; None for what is not."""
    sigma = xyz_rpy_sigma(T, covariance)
    places = choose_pose_decimals(sigma)
    columns = {
        "value": format_pose_numbers(xyz_rpy_mm_deg(T), places),
        "sigma": format_pose_numbers(sigma, places),
    }
    if T_guess is not None:
        columns["guess"] = format_pose_numbers(xyz_rpy_mm_deg(T_guess), places)
        columns["change"] = format_pose_numbers(
            xyz_rpy_difference(T, T_guess), places, has_plus_sign=True
        )
    if T_true is not None:
        off = xyz_rpy_difference(T, T_true)
        columns["error"] = format_pose_numbers(off, places, has_plus_sign=True)
        columns["in_sigma"] = format_pose_numbers(off / sigma, [1] * 6, has_plus_sign=True)
    absent = dict.fromkeys(("guess", "change", "error", "in_sigma"))
    return [
        absent | {"name": n, "unit": u} | {k: v[i] for k, v in columns.items()}
        for i, (n, u) in enumerate(POSE_NUMBER_UNITS)
    ]


def summarize_sensor_pose(run, name):
    """What is said of one sensor's pose."""
    sensor = run.sensors[name]
    out = {"name": name, "sensor": sensor, "solved": bool(sensor["T_robot_sensor"])}
    out |= {k: format_count(sensor[k]) for k in ("placements", "observations", "points")}
    out["rejected"] = format_percent(sensor["rejected_share"])
    out["residual"] = format_residual_rms(**sensor["residual"])
    if not out["solved"]:
        return out
    T, T_true, covariance = (
        run.T_robot_sensor(name),
        run.T_robot_sensor_true(name),
        sensor["covariance"],
    )
    out |= {
        "rows": tabulate_pose(T, covariance, initial_guess_pose(sensor), T_true),
        "change": format_guess_change(sensor, T),
    }
    out |= {
        "error": format_pose_error(T, covariance, T_true),
        "least": format_least_certain(sensor),
    }
    out["locked"] = is_gimbal_locked(T)
    out["worked"] = ", ".join(format_decimals(v, 4) for v in transform_points(T, [1.0, 0.0, 0.0]))
    out["quat"] = ", ".join(format_decimals(v, 8) for v in sensor["T_robot_sensor"]["quat_xyzw"])
    out["matrix"] = "\n".join(" ".join(f"{v: .9f}" for v in row) for row in T)
    return out


def initial_guess_pose(sensor):
    """T_robot_sensor (4, 4) of a sensor's first guess, or None."""
    T = sensor["guess"]["T_robot_sensor"]
    return None if T is None else np.array(T["matrix"])


def format_least_certain(sensor):
    """`yaw, about z of the robot, σ 0.02 °` of a sensor with a pose."""
    weak = sensor["least_certain"]
    turning = weak["direction"].startswith("rotation")
    sigma = format_number(weak["sigma"] * (DEG_PER_RAD if turning else MM_PER_M), 2)
    return f"{weak['direction']}, σ {sigma} {'°' if turning else 'mm'}"


def format_residual_rms(rms, unit):
    """A residual of calibration.json in mm or px."""
    if rms is None:
        return DASH
    return f"{format_number(rms * MM_PER_M)} mm" if unit == "m" else f"{format_number(rms)} {unit}"


def format_guess_change(sensor, T):
    """How far the result lies from the first guess: mm, deg, and in σ of the guess."""
    T_guess = initial_guess_pose(sensor)
    if T_guess is None:
        return None
    mm, deg = pose_distance_mm_deg(T, T_guess)
    off = np.abs(se3_log(invert_pose(T_guess) @ T)) / sensor["guess"]["sigma"]
    told = {
        "mm": format_number(mm),
        "deg": format_number(deg),
        "sigmas": format_number(off.max(), 2),
    }
    return told | {"source": sensor["guess"]["source"]}


def list_sensor_pairs(run):
    """Pose of every solved sensor in every earlier one, with σ from their joint covariance."""
    joint = run.calibration["joint_covariance"]
    out = []
    for a, b in itertools.combinations(joint["order"] if joint else [], 2):
        at = [6 * joint["order"].index(n) + i for n in (a, b) for i in range(6)]
        T_r_a, T_r_b = run.T_robot_sensor(a), run.T_robot_sensor(b)
        block = np.array(joint["matrix"])[np.ix_(at, at)]
        covariance = relative_pose_covariance(T_r_a, T_r_b, block)
        T, T_true = invert_pose(T_r_a) @ T_r_b, None
        if run.T_robot_sensor_true(a) is not None and run.T_robot_sensor_true(b) is not None:
            T_true = invert_pose(run.T_robot_sensor_true(a)) @ run.T_robot_sensor_true(b)
        told = format_pose_error(T, covariance, T_true)
        pair = {"a": a, "b": b, "T": T, "covariance": covariance, "locked": is_gimbal_locked(T)}
        out.append(pair | {"rows": tabulate_pose(T, covariance, None, T_true), "error": told})
    return out
