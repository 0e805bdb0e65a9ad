"""Which directions of a pose the data tell well, which hardly, and what would tell more."""

import numpy as np

from calib.diagnosis.observability import GENERAL_ADVICE, LEVER_ARM_M, describe_pose_direction
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.number_format import DASH, format_number


def principal_pose_directions(sensor, T_robot_sensor):
    """[(words, σ as text)] of the six principal directions of a pose, the least certain first; a
    turn counts like the shift at 1 m that it makes."""
    scale = np.repeat([1.0, LEVER_ARM_M], 3)
    values, vectors = np.linalg.eigh(scale[:, None] * np.asarray(sensor["covariance"]) * scale)
    out = []
    for variance, twist in zip(values[::-1], vectors.T[::-1], strict=True):
        sigma = np.sqrt(max(variance, 0.0))
        turning = np.linalg.norm(twist[3:]) > np.linalg.norm(twist[:3])
        shown = sigma * DEG_PER_RAD / LEVER_ARM_M if turning else sigma * MM_PER_M
        words = describe_pose_direction(twist, T_robot_sensor)
        out.append((words, f"{format_number(shown, 2)} {'°' if turning else 'mm'}", float(sigma)))
    return out


def format_next_view(next_view):
    """{words, one, four}: the view to add next, and σ with one such placement and with four; empty
    where none is known."""
    if not next_view:
        return {}
    scale, unit = (DEG_PER_RAD, "°") if next_view["unit"] == "rad" else (MM_PER_M, "mm")
    one, four = (
        f"{format_number(next_view[k] * scale, 2)} {unit}" for k in ("sigma_one", "sigma_four")
    )
    return {"words": f"{next_view['target']} {next_view['description']}", "one": one, "four": four}


def tabulate_observability(run):
    """What is told of every sensor: open directions, the six of its pose, what to record next."""
    out = []
    for name, sensor in run.sensors.items():
        T = run.T_robot_sensor(name)
        six = principal_pose_directions(sensor, T) if T is not None else []
        told = {"name": name, "six": [(w, s) for w, s, _ in six], "ratio": DASH}
        if six and six[-1][2] > 0:
            told["ratio"] = format_number(six[0][2] / six[-1][2], 2)
        told["open"] = [d["description"] for d in sensor["undetermined"]]
        told["next"] = format_next_view(sensor["next_view"])
        told["general"] = sensor["recording_advice"] == GENERAL_ADVICE
        told["advice"] = sensor["recording_advice"] or sensor["status"]["remedy"]
        out.append(told)
    return out
