"""What speaks for or against the result: suspicions, placements and measurements left out."""

import numpy as np

from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.number_format import format_count, format_number, format_percent
from calib.verdict.findings import level_by_limits

N_TOP_INFLUENCES = 3


def tabulate_suspected_errors(run):
    """Rows of what the residuals speak for, the gravest first, and whether the verdict names it."""
    told = [f["text"] for f in run.verdict["findings"] if f["check"] == "suspected_error"]
    return [
        {
            "text": s["description"],
            "remedy": s["remedy"],
            "named": any(s["description"] in t for t in told),
            "chance": _format_p_value(s["p_value"]),
            "shift": [
                _format_pose_shift(n, by)
                for n, by in sorted(s["pose_shift"].items())
                if by["sigmas"] > 0.5
            ],
            "explained": [
                f"{format_percent(v)} of {k}"
                for k, v in sorted(s["explained_share"].items())
                if v > 0.05
            ],
            "rivals": [r["description"] for r in s["alternatives"]],
        }
        for s in run.calibration["suspected_errors"]
    ]


def _format_p_value(value):
    return format_number(value, 1) if value > 1e-12 else "below 1e−12"


def _format_pose_shift(name, shift):
    """`lidar 6.7 mm, 0.19° (3.6 σ)`."""
    far = f"{format_number(shift['m'] * MM_PER_M, 2)} mm, {format_number(shift['rad'] * DEG_PER_RAD, 2)}°"
    return f"{name} {far} ({format_number(shift['sigmas'], 2)} σ)"


def tabulate_session_repeatability(run):
    """Rows of every sensor and session: its pose by that session alone, against the others."""
    rows = []
    moved = {
        n for f in run.verdict["findings"] if f["check"] == "sensor_moved" for n in f["sensors"]
    }
    for row in run.calibration["repeatability"]:
        shift, sigma = np.reshape([row["shift"], row["sigma"]], (2, 2, 3)) * [
            [[MM_PER_M], [DEG_PER_RAD]]
        ]
        told = {k: row[k] for k in ("session", "sensor")} | {
            "chance": _format_p_value(row["p_value"])
        }
        for i, unit in enumerate(("mm", "deg")):
            told[unit] = format_number(np.linalg.norm(shift[i]), 2)
            told[f"sigma_{unit}"] = format_number(np.linalg.norm(sigma[i]), 2)
        told["moved"] = row["sensor"] in moved
        rows.append(told)
    return rows


def tabulate_leave_one_out(run):
    """Rows of every sensor: what its placements say against what the others predict, beside σ, all
    of them lengths over three axes."""
    rows = []
    for name, sensor in run.sensors.items():
        held = sensor["leave_one_out"]
        if held:
            rows.append(
                {
                    "name": name,
                    "placements": format_count(held["placements"]),
                    "mm": format_number(held["rms_m"] * MM_PER_M, 2),
                    "deg": format_number(held["rms_rad"] * DEG_PER_RAD, 2),
                    "ratio": format_number(held["error_over_sigma"], 3),
                    "sigma_mm": format_number(_sigma_length(sensor, 0) * MM_PER_M, 2),
                    "sigma_deg": format_number(_sigma_length(sensor, 1) * DEG_PER_RAD, 2),
                    "level": level_by_limits(
                        held["error_over_sigma"], run.verdict["limits"], "leave_one_out"
                    ),
                    "most": format_top_influences(run, name),
                }
            )
    return rows


def _sigma_length(sensor, part):
    """Length, m or rad, of the σ of a pose's position (part 0) or rotation (part 1)."""
    variances = np.diag(sensor["covariance"]).reshape(2, 3)[part]
    return float(np.sqrt(variances.sum()))


def list_placement_influences(run, sensor):
    """[(session, target, placement, influence in σ or None, NEES per direction or None)]."""
    out = []
    for row in run.calibration["influences"]:
        own = row["sensors"].get(sensor)
        if own:
            nees = own["nees"] / own["n_directions"] if own["n_directions"] else None
            at = row["session"], row["target"], row["placement"]
            out.append((*at, own["influence"], nees))
    return out


def format_top_influences(run, sensor):
    """`7 (board, morning) 1.3 σ` of the few placements that move a pose the most."""
    rows = list_placement_influences(run, sensor)
    rows.sort(key=lambda r: -(np.inf if r[3] is None else r[3]))
    several = len(run.sessions) > 1
    return [
        f"{placement} ({target}{f', {session}' if several else ''}) "
        + ("cannot be spared" if moved is None else f"{format_number(moved, 2)} σ")
        for session, target, placement, moved, _ in rows[:N_TOP_INFLUENCES]
    ]


def tabulate_rejected_regions(run, sensor):
    """Rows of the measurements that are no members: target, kind, and where they lie."""
    rows = {}
    for row in run.sensors[sensor]["rejected_by_region"]:
        at = rows.setdefault(
            (row["target"], row["kind"]), {"of": row["n_measurements"], "where": []}
        )
        share = format_percent(row["count"] / max(row["n_measurements"], 1))
        at["where"].append((format_count(row["count"]), share, row["region"]))
    return [
        {"target": t, "kind": k, "of": format_count(r["of"]), "where": r["where"]}
        for (t, k), r in sorted(rows.items())
    ]
