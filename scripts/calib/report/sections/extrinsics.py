"""Poses as they are told: first guess, result with σ, correction, and error where truth is known.

A pose is told in six numbers: x, y, z of the sensor's origin in the robot's frame, mm, and roll,
pitch, yaw, deg, with R = Rz(yaw) Ry(pitch) Rx(roll). Each σ is that of the number beside it. Near a
pitch of ±90° roll and yaw have no meaning of their own: σ and differences are then those of turns
about x, y, z of the robot.
"""

import itertools
import warnings

import numpy as np

from calib.geometry import se3
from calib.report import number_format

MM, DEG = 1e3, np.degrees(1.0)
NAMES = (("x", "mm"), ("y", "mm"), ("z", "mm"), ("roll", "°"), ("pitch", "°"), ("yaw", "°"))
GIMBAL = 0.1  # cosine of a pitch below which roll and yaw have no meaning of their own
NEES_95 = (0.206, 2.408)  # NEES / 6 of an honest covariance lies here 95 times of 100


def numbers(T):
    """(6,) x, y, z, mm, and roll, pitch, yaw, deg, of T (4, 4)."""
    with warnings.catch_warnings():
        # At a pitch of ±90° one of the two angles is chosen, which is as good as any other.
        warnings.simplefilter("ignore", UserWarning)
        return np.concatenate([T[:3, 3] * MM, se3.to_rpy(T) * DEG])


def locked(T):
    """Whether roll and yaw of T (4, 4) have no meaning of their own: its x axis is near ±z."""
    return np.hypot(T[0, 0], T[1, 0]) < GIMBAL


def sigmas(T, covariance):
    """(6,) standard deviations of numbers(T); of turns about x, y, z of the robot where locked."""
    J = np.zeros((6, 6))
    J[:3, :3] = J[3:, 3:] = T[:3, :3]
    if not locked(T):
        roll, pitch, _ = se3.to_rpy(T)
        # Rates about the sensor's axes from those of roll, pitch and yaw.
        from_rates = [
            [1.0, 0.0, -np.sin(pitch)],
            [0.0, np.cos(roll), np.cos(pitch) * np.sin(roll)],
            [0.0, -np.sin(roll), np.cos(pitch) * np.cos(roll)],
        ]
        J[3:, 3:] = np.linalg.inv(from_rates)
    return np.sqrt(np.diag(J @ np.asarray(covariance) @ J.T)) * np.repeat([MM, DEG], 3)


def difference(T, T_from):
    """(6,) numbers(T) less numbers(T_from), the angles within ±180°; where locked, the turn about
    x, y, z of the robot that leads from one to the other."""
    if locked(T):
        turn = se3.so3_log(T[:3, :3] @ T_from[:3, :3].T) * DEG
        return np.concatenate([(T - T_from)[:3, 3] * MM, turn])
    d = numbers(T) - numbers(T_from)
    return np.concatenate([d[:3], (d[3:] + 180) % 360 - 180])


def distance(T, T_from):
    """How far two poses lie apart: mm, and deg of the rotation between them."""
    apart = np.linalg.norm(T[:3, 3] - T_from[:3, 3]) * MM
    return float(apart), float(np.degrees(se3.angle(se3.inverse(T_from) @ T)))


def error(T, covariance, T_true):
    """(mm, deg, NEES / 6) of an estimate T against the truth."""
    xi = se3.se3_log(se3.inverse(T_true) @ T)
    nees = xi @ np.linalg.solve(np.asarray(covariance), xi)
    return *distance(T, T_true), float(nees / 6)


def decimals(sigma):
    """Decimals (6,) that show the least σ of the position, and of the rotation, in two digits."""
    return [number_format.places(s) for s in np.repeat(np.reshape(sigma, (2, 3)).min(1), 3)]


def fixed(values, places, sign=False):
    """Values (6,) as text; sign: a plus before what is positive."""
    told = [number_format.fixed(v, p) for v, p in zip(values, places, strict=True)]
    return [f"+{t}" if sign and v > 0 else t for t, v in zip(told, values, strict=True)]


def told_error(T, covariance, T_true):
    """What is said of an estimate against the truth; None without one."""
    if T_true is None:
        return None
    mm, deg, nees = error(T, covariance, T_true)
    told = {
        "mm": number_format.number(mm, 2),
        "deg": number_format.number(deg, 2),
        "nees": number_format.number(nees, 2),
    }
    inside = NEES_95[0] <= nees <= NEES_95[1]
    return told | {"sigmas": number_format.number(np.sqrt(nees), 2), "inside": inside}


def rows(T, covariance, T_guess, T_true):
    """The six numbers of a pose with all that is known of each; None for what is not."""
    sigma = sigmas(T, covariance)
    places = decimals(sigma)
    columns = {"value": fixed(numbers(T), places), "sigma": fixed(sigma, places)}
    if T_guess is not None:
        columns["guess"] = fixed(numbers(T_guess), places)
        columns["change"] = fixed(difference(T, T_guess), places, sign=True)
    if T_true is not None:
        off = difference(T, T_true)
        columns["error"] = fixed(off, places, sign=True)
        columns["in_sigma"] = fixed(off / sigma, [1] * 6, sign=True)
    absent = dict.fromkeys(("guess", "change", "error", "in_sigma"))
    return [
        absent | {"name": n, "unit": u} | {k: v[i] for k, v in columns.items()}
        for i, (n, u) in enumerate(NAMES)
    ]


def of_sensor(run, name):
    """What is said of one sensor's pose."""
    sensor = run.sensors[name]
    out = {"name": name, "sensor": sensor, "solved": bool(sensor["T_robot_sensor"])}
    out |= {k: number_format.count(sensor[k]) for k in ("placements", "observations", "points")}
    out["rejected"] = number_format.percent(sensor["rejected"])
    out["residual"] = residual(**sensor["residual"])
    if not out["solved"]:
        return out
    T, T_true, covariance = run.T_robot_sensor(name), run.truth(name), sensor["covariance"]
    out |= {"rows": rows(T, covariance, guess(sensor), T_true), "change": change(sensor, T)}
    out |= {"error": told_error(T, covariance, T_true), "least": least_certain(sensor)}
    out["locked"] = locked(T)
    out["worked"] = ", ".join(number_format.fixed(v, 4) for v in se3.transform(T, [1.0, 0.0, 0.0]))
    out["quat"] = ", ".join(
        number_format.fixed(v, 8) for v in sensor["T_robot_sensor"]["quat_xyzw"]
    )
    out["matrix"] = "\n".join(" ".join(f"{v: .9f}" for v in row) for row in T)
    return out


def guess(sensor):
    """T_robot_sensor (4, 4) of a sensor's first guess, or None."""
    T = sensor["guess"]["T_robot_sensor"]
    return None if T is None else np.array(T["matrix"])


def least_certain(sensor):
    """`yaw, about z of the robot, σ 0.02 °` of a sensor with a pose."""
    weak = sensor["weakest"]
    turning = weak["direction"].startswith("rotation")
    sigma = number_format.number(weak["sigma"] * (DEG if turning else MM), 2)
    return f"{weak['direction']}, σ {sigma} {'°' if turning else 'mm'}"


def residual(rms, unit):
    """A residual of calibration.json in mm or px."""
    if rms is None:
        return number_format.DASH
    return (
        f"{number_format.number(rms * MM)} mm"
        if unit == "m"
        else f"{number_format.number(rms)} {unit}"
    )


def change(sensor, T):
    """How far the result lies from the first guess: mm, deg, and in σ of the guess."""
    T_guess = guess(sensor)
    if T_guess is None:
        return None
    mm, deg = distance(T, T_guess)
    off = np.abs(se3.se3_log(se3.inverse(T_guess) @ T)) / sensor["guess"]["sigma"]
    told = {
        "mm": number_format.number(mm),
        "deg": number_format.number(deg),
        "sigmas": number_format.number(off.max(), 2),
    }
    return told | {"source": sensor["guess"]["source"]}


def between(run):
    """Pose of every solved sensor in every earlier one, with σ from their joint covariance."""
    joint = run.calibration["joint_covariance"]
    out = []
    for a, b in itertools.combinations(joint["order"] if joint else [], 2):
        at = [6 * joint["order"].index(n) + i for n in (a, b) for i in range(6)]
        T_r_a, T_r_b = run.T_robot_sensor(a), run.T_robot_sensor(b)
        block = np.array(joint["matrix"])[np.ix_(at, at)]
        covariance = se3.covariance_of_relative(T_r_a, T_r_b, block)
        T, T_true = se3.inverse(T_r_a) @ T_r_b, None
        if run.truth(a) is not None and run.truth(b) is not None:
            T_true = se3.inverse(run.truth(a)) @ run.truth(b)
        told = told_error(T, covariance, T_true)
        pair = {"a": a, "b": b, "T": T, "covariance": covariance, "locked": locked(T)}
        out.append(pair | {"rows": rows(T, covariance, None, T_true), "error": told})
    return out
