"""Evidence for or against the result: suspected errors, leave-one-out, sessions, rejections."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.data.run_data import ReportRun
from calib.report.number_format import (
    format_count,
    format_kind,
    format_number,
    format_percent,
)
from calib.verdict.findings import level_by_limits
from calib.verdict.split_half_findings import format_choice

N_TOP_INFLUENCES = 3
MIN_SHOWN_SHIFT_SIGMA = 0.5  # smaller shifts of a pose by a suspected error are not shown
MIN_SHOWN_SHARE = 0.05  # smaller shares of the residuals are not shown
MIN_SHOWN_P_VALUE = 1e-12


@dataclass(frozen=True)
class PlacementInfluence:
    """Leave-one-out of one placement and sensor.

    influence: shift of the pose without the placement, in its σ, None if the pose needs it;
    nees_per_direction: squared difference from the prediction of the others, in σ, or None.
    """

    session: str
    target: str
    placement: int
    influence: float | None
    nees_per_direction: float | None


def tabulate_suspected_errors(run: ReportRun) -> list[dict[str, Any]]:
    """Return one row per suspected error, the most important first."""
    findings = [f["text"] for f in run.verdict["findings"] if f["check"] == "suspected_error"]
    return [
        {
            "text": error["description"],
            "remedy": error["remedy"],
            "is_in_verdict": any(error["description"] in text for text in findings),
            "p_value": _format_p_value(error["p_value"]),
            "pose_shift": [
                _format_pose_shift(sensor, shift)
                for sensor, shift in sorted(error["pose_shift"].items())
                if shift["sigmas"] > MIN_SHOWN_SHIFT_SIGMA
            ],
            "explained_share": [
                f"{format_percent(share)} of {_format_explained_part(part)}"
                for part, share in sorted(error["explained_share"].items())
                if share > MIN_SHOWN_SHARE
            ],
            "alternatives": [alternative["description"] for alternative in error["alternatives"]],
        }
        for error in run.calibration["suspected_errors"]
    ]


def _format_p_value(p_value: float) -> str:
    return format_number(p_value, 1) if p_value > MIN_SHOWN_P_VALUE else "below 1e−12"


def _format_explained_part(part: str) -> str:
    """Format a part of the residuals, `<sensor>/<kind>` or `mocap`."""
    sensor, slash, kind = part.rpartition("/")
    return sensor + slash + format_kind(kind)


def _format_pose_shift(sensor: str, shift: dict[str, float]) -> str:
    """Format the shift of a pose: `lidar 6.7 mm, 0.19° (3.6 σ)`."""
    mm, deg = shift["m"] * MM_PER_M, shift["rad"] * DEG_PER_RAD
    sigmas = format_number(shift["sigmas"], 2)
    return f"{sensor} {format_number(mm, 2)} mm, {format_number(deg, 2)}° ({sigmas} σ)"


def tabulate_session_repeatability(run: ReportRun) -> list[dict[str, Any]]:
    """Return one row per session and sensor: the pose of that session against the others."""
    moved_sensors = {
        name
        for f in run.verdict["findings"]
        if f["check"] == "sensor_moved"
        for name in f["sensors"]
    }
    rows = []
    for block in run.calibration["repeatability"]:
        row = {
            "session": block["session"],
            "sensor": block["sensor"],
            "p_value": _format_p_value(block["p_value"]),
            "has_moved": block["sensor"] in moved_sensors,
        }
        for key, part, scale in (
            ("mm", slice(0, 3), MM_PER_M),
            ("deg", slice(3, 6), DEG_PER_RAD),
        ):
            shift, sigma = np.asarray(block["shift"][part]), np.asarray(block["sigma"][part])
            row[key] = format_number(float(np.linalg.norm(shift * scale)), 2)
            row[f"sigma_{key}"] = format_number(float(np.linalg.norm(sigma * scale)), 2)
        rows.append(row)
    return rows


def tabulate_split_halves(run: ReportRun) -> list[dict[str, Any]]:
    """Return one row per sensor: its poses from two halves of the placements, and their choices."""
    halves = run.calibration["split_halves"]
    if halves is None:
        return []
    choices = [format_choice(adopted) for adopted in halves["adopted"]]
    rows = []
    for name, sensor in sorted(halves["sensors"].items()):
        row = {"name": name, "placements": " + ".join(map(format_count, sensor["placements"]))}
        row["choices"] = choices[0] if choices[0] == choices[1] else " | ".join(choices)
        for key, part, scale in (
            ("mm", slice(0, 3), MM_PER_M),
            ("deg", slice(3, 6), DEG_PER_RAD),
        ):
            shift, sigma = np.asarray(sensor["shift"][part]), np.asarray(sensor["sigma"][part])
            row[key] = format_number(float(np.linalg.norm(shift * scale)), 2)
            row[f"sigma_{key}"] = format_number(float(np.linalg.norm(sigma * scale)), 2)
        ratio = sensor["nees"] / sensor["n_directions"]
        row["ratio"] = format_number(ratio, 2)
        row["level"] = "warn" if ratio > run.verdict["limits"]["warn_split_half"] else ""
        rows.append(row)
    return rows


def tabulate_leave_one_out(run: ReportRun) -> list[dict[str, Any]]:
    """Return one row per sensor: leave-one-out error beside the σ of the pose.

    All of them are lengths over three axes.
    """
    rows = []
    for name, sensor in run.sensors.items():
        error = sensor["leave_one_out"]
        if not error:
            continue
        ratio = error["error_over_sigma"]
        variances = np.diag(sensor["covariance"]).reshape(2, 3)
        sigma_m, sigma_rad = (float(np.sqrt(part.sum())) for part in variances)
        rows.append(
            {
                "name": name,
                "placements": format_count(error["placements"]),
                "mm": format_number(error["rms_m"] * MM_PER_M, 2),
                "deg": format_number(error["rms_rad"] * DEG_PER_RAD, 2),
                "ratio": format_number(ratio, 3),
                "sigma_mm": format_number(sigma_m * MM_PER_M, 2),
                "sigma_deg": format_number(sigma_rad * DEG_PER_RAD, 2),
                "level": level_by_limits(ratio, run.verdict["limits"], "leave_one_out"),
                "top_influences": format_top_influences(run, name),
            }
        )
    return rows


def list_placement_influences(run: ReportRun, sensor: str) -> list[PlacementInfluence]:
    """Return the leave-one-out results of all placements of one sensor."""
    influences = []
    for row in run.calibration["influences"]:
        block = row["sensors"].get(sensor)
        if block:
            n_directions = block["n_directions"]
            influences.append(
                PlacementInfluence(
                    session=row["session"],
                    target=row["target"],
                    placement=row["placement"],
                    influence=block["influence"],
                    nees_per_direction=block["nees"] / n_directions if n_directions else None,
                )
            )
    return influences


def format_top_influences(run: ReportRun, sensor: str) -> list[str]:
    """Format the placements that move a pose most: `7 (board, morning) 1.3 σ`."""
    influences = list_placement_influences(run, sensor)
    influences.sort(key=lambda i: -(np.inf if i.influence is None else i.influence))
    texts = []
    for i in influences[:N_TOP_INFLUENCES]:
        session = f", {i.session}" if len(run.sessions) > 1 else ""
        if i.influence is None:
            effect = "no pose without it"
        else:
            effect = f"{format_number(i.influence, 2)} σ"
        texts.append(f"{i.placement} ({i.target}{session}) {effect}")
    return texts


def tabulate_rejected_regions(run: ReportRun, sensor: str) -> list[dict[str, Any]]:
    """Return one row per target and kind of the excluded measurements: where they lie.

    regions: (count, share, region).
    """
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for block in run.sensors[sensor]["rejected_by_region"]:
        key = block["target"], block["kind"]
        row = rows.setdefault(
            key, {"n_measurements": format_count(block["n_measurements"]), "regions": []}
        )
        share = format_percent(block["count"] / max(block["n_measurements"], 1))
        row["regions"].append((format_count(block["count"]), share, block["region"]))
    return [
        {"target": target, "kind": format_kind(kind)} | row
        for (target, kind), row in sorted(rows.items())
    ]
