"""Which directions of a pose the data tell well, which hardly, and what would tell more."""

import numpy as np

from calib.diagnosis import observability
from calib.report import number_format
from calib.report.sections.extrinsics import DEG, MM


def principal(sensor, T_robot_sensor):
    """[(words, σ as text)] of the six principal directions of a pose, the least certain first; a
    turn counts like the shift at 1 m that it makes."""
    scale = np.repeat([1.0, observability.ARM], 3)
    values, vectors = np.linalg.eigh(scale[:, None] * np.asarray(sensor["covariance"]) * scale)
    out = []
    for variance, twist in zip(values[::-1], vectors.T[::-1], strict=True):
        sigma = np.sqrt(max(variance, 0.0))
        turning = np.linalg.norm(twist[3:]) > np.linalg.norm(twist[:3])
        shown = sigma * DEG / observability.ARM if turning else sigma * MM
        words = observability.in_words(twist, T_robot_sensor)
        out.append(
            (words, f"{number_format.number(shown, 2)} {'°' if turning else 'mm'}", float(sigma))
        )
    return out


def following(best):
    """{words, one, four}: the view to add next, and σ with one such placement and with four; empty
    where none is known."""
    if not best:
        return {}
    scale, unit = (DEG, "°") if best["unit"] == "rad" else (MM, "mm")
    one, four = (
        f"{number_format.number(best[k] * scale, 2)} {unit}" for k in ("sigma_one", "sigma_four")
    )
    return {"words": f"{best['target']} {best['words']}", "one": one, "four": four}


def rows(run):
    """What is told of every sensor: open directions, the six of its pose, what to record next."""
    out = []
    for name, sensor in run.sensors.items():
        T = run.T_robot_sensor(name)
        six = principal(sensor, T) if T is not None else []
        told = {"name": name, "six": [(w, s) for w, s, _ in six], "ratio": number_format.DASH}
        if six and six[-1][2] > 0:
            told["ratio"] = number_format.number(six[0][2] / six[-1][2], 2)
        told["open"] = [d["words"] for d in sensor["undetermined"]]
        told["next"] = following(sensor["next_view"])
        told["general"] = sensor["advice"] == observability.ANY
        told["advice"] = sensor["advice"] or sensor["status"]["remedy"]
        out.append(told)
    return out
