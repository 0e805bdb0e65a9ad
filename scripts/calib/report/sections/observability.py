"""Directions of a pose that the data determine well or hardly, and the view to add next."""

from typing import Any

import numpy as np

from calib.diagnosis.observability import (
    GENERAL_ADVICE,
    LEVER_ARM_M,
    describe_pose_direction,
    principal_directions,
)
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.data.run_data import ReportRun
from calib.report.number_format import format_number


def format_sigma(sigma: float, unit: str) -> str:
    """Format a σ in m or rad as `0.43 mm` or `0.02 °`."""
    if unit == "rad":
        return f"{format_number(sigma * DEG_PER_RAD, 2)} °"
    return f"{format_number(sigma * MM_PER_M, 2)} mm"


def format_next_view(next_view: dict[str, Any] | None) -> dict[str, str]:
    """Return description and σ with one and with four placements of the view to add next."""
    if not next_view:
        return {}
    sigma = {
        key: format_sigma(next_view[key], next_view["unit"]) for key in ("sigma_one", "sigma_four")
    }
    return {"description": f"{next_view['target']} {next_view['description']}"} | sigma


def tabulate_observability(run: ReportRun) -> list[dict[str, Any]]:
    """Return one row per sensor: principal and undetermined directions, and what to record next."""
    rows = []
    for name, sensor in run.sensors.items():
        T = run.T_robot_sensor(name)
        directions = [] if T is None else principal_directions(np.array(sensor["covariance"]))
        descriptions = (
            [] if T is None else [describe_pose_direction(d.weights, T) for d in directions]
        )
        # σ of a rotation counts as the shift that it makes at LEVER_ARM_M.
        sigma_m = [d.sigma * (LEVER_ARM_M if d.unit == "rad" else 1.0) for d in directions]
        ratio = sigma_m[0] / sigma_m[-1] if directions and sigma_m[-1] > 0 else None
        rows.append(
            {
                "name": name,
                "principal_directions": [
                    (description, format_sigma(d.sigma, d.unit))
                    for description, d in zip(descriptions, directions, strict=True)
                ],
                "sigma_ratio": format_number(ratio, 2),
                "undetermined": [d["description"] for d in sensor["undetermined"]],
                "next_view": format_next_view(sensor["next_view"]),
                "is_general_advice": sensor["recording_advice"] == GENERAL_ADVICE,
                "advice": sensor["recording_advice"] or sensor["status"]["remedy"],
            }
        )
    return rows
