"""What speaks for or against the result: suspicions, placements and measurements left out."""

import numpy as np

from calib.report import number_format
from calib.report.sections.extrinsics import DEG, MM
from calib.verdict import findings

MOST_INFLUENTIAL = 3


def suspicions(run):
    """Rows of what the residuals speak for, the gravest first, and whether the verdict names it."""
    told = [f["text"] for f in run.verdict["findings"] if f["check"] == "suspicion"]
    return [
        {
            "text": s["text"],
            "remedy": s["remedy"],
            "named": any(s["text"] in t for t in told),
            "chance": _chance(s["chance"]),
            "shift": [_shift(n, by) for n, by in sorted(s["shift"].items()) if by["sigmas"] > 0.5],
            "explained": [
                f"{number_format.percent(v)} of {k}"
                for k, v in sorted(s["explained"].items())
                if v > 0.05
            ],
            "rivals": [r["text"] for r in s["rivals"]],
        }
        for s in run.calibration["suspicions"]
    ]


def _chance(value):
    return number_format.number(value, 1) if value > 1e-12 else "below 1e−12"


def _shift(name, by):
    """`lidar 6.7 mm, 0.19° (3.6 σ)`."""
    far = f"{number_format.number(by['m'] * MM, 2)} mm, {number_format.number(by['rad'] * DEG, 2)}°"
    return f"{name} {far} ({number_format.number(by['sigmas'], 2)} σ)"


def sessions(run):
    """Rows of every sensor and session: its pose by that session alone, against the others."""
    rows = []
    moved = {n for f in run.verdict["findings"] if f["check"] == "moved" for n in f["sensors"]}
    for row in run.calibration["repeatability"]:
        shift, sigma = np.reshape([row["shift"], row["sigma"]], (2, 2, 3)) * [[[MM], [DEG]]]
        told = {k: row[k] for k in ("session", "sensor")} | {"chance": _chance(row["chance"])}
        for i, unit in enumerate(("mm", "deg")):
            told[unit] = number_format.number(np.linalg.norm(shift[i]), 2)
            told[f"sigma_{unit}"] = number_format.number(np.linalg.norm(sigma[i]), 2)
        told["moved"] = row["sensor"] in moved
        rows.append(told)
    return rows


def held_out(run):
    """Rows of every sensor: what its placements say against what the others predict, beside σ, all
    of them lengths over three axes."""
    rows = []
    for name, sensor in run.sensors.items():
        held = sensor["held_out"]
        if held:
            rows.append(
                {
                    "name": name,
                    "placements": number_format.count(held["placements"]),
                    "mm": number_format.number(held["rms_m"] * MM, 2),
                    "deg": number_format.number(held["rms_rad"] * DEG, 2),
                    "ratio": number_format.number(held["ratio"], 3),
                    "sigma_mm": number_format.number(_pose_sigma(sensor, 0) * MM, 2),
                    "sigma_deg": number_format.number(_pose_sigma(sensor, 1) * DEG, 2),
                    "level": findings.level(held["ratio"], run.verdict["limits"], "heldout"),
                    "most": most_influential(run, name),
                }
            )
    return rows


def _pose_sigma(sensor, part):
    """Length, m or rad, of the σ of a pose's position (part 0) or rotation (part 1)."""
    variances = np.diag(sensor["covariance"]).reshape(2, 3)[part]
    return float(np.sqrt(variances.sum()))


def influences(run, sensor):
    """[(session, target, placement, influence in σ or None, NEES per direction or None)]."""
    out = []
    for row in run.calibration["influences"]:
        own = row["sensors"].get(sensor)
        if own:
            nees = own["nees"] / own["directions"] if own["directions"] else None
            at = row["session"], row["target"], row["placement"]
            out.append((*at, own["influence"], nees))
    return out


def most_influential(run, sensor):
    """`7 (board, morning) 1.3 σ` of the few placements that move a pose the most."""
    rows = influences(run, sensor)
    rows.sort(key=lambda r: -(np.inf if r[3] is None else r[3]))
    several = len(run.sessions) > 1
    return [
        f"{placement} ({target}{f', {session}' if several else ''}) "
        + ("cannot be spared" if moved is None else f"{number_format.number(moved, 2)} σ")
        for session, target, placement, moved, _ in rows[:MOST_INFLUENTIAL]
    ]


def left_out(run, sensor):
    """Rows of the measurements that are no members: target, kind, and where they lie."""
    rows = {}
    for row in run.sensors[sensor]["left_out"]:
        at = rows.setdefault((row["target"], row["kind"]), {"of": row["of"], "where": []})
        share = number_format.percent(row["count"] / max(row["of"], 1))
        at["where"].append((number_format.count(row["count"]), share, row["where"]))
    return [
        {"target": t, "kind": k, "of": number_format.count(r["of"]), "where": r["where"]}
        for (t, k), r in sorted(rows.items())
    ]
