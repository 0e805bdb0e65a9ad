"""Directions of a pose that the data determine well or hardly, and the view to add next."""

from typing import Any, NamedTuple

import numpy as np

from calib.diagnosis.observability import (
    GENERAL_ADVICE,
    describe_pose_direction,
    principal_directions,
)
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.data.run_data import ReportRun
from calib.report.number_format import format_number


class PrincipalDirectionText(NamedTuple):
    """A principal direction of a pose: description, σ with its unit, and σ in m at LEVER_ARM_M."""

    description: str
    sigma_text: str
    sigma_m: float


def principal_pose_directions(
    covariance: list[list[float]], T_robot_sensor: np.ndarray
) -> list[PrincipalDirectionText]:
    """Return the six principal directions of a pose, the least certain first.

    covariance (6, 6): of the pose; a rotation counts as the shift that it makes at LEVER_ARM_M.
    """
    directions = []
    for direction in principal_directions(np.asarray(covariance)):
        is_rotation = direction.unit == "rad"
        shown = direction.sigma * (DEG_PER_RAD if is_rotation else MM_PER_M)
        text = f"{format_number(shown, 2)} {'°' if is_rotation else 'mm'}"
        description = describe_pose_direction(direction.weights, T_robot_sensor)
        directions.append(PrincipalDirectionText(description, text, direction.sigma_m))
    return directions


def format_next_view(next_view: dict[str, Any] | None) -> dict[str, str]:
    """Return description and σ with one and with four placements of the view to add next."""
    if not next_view:
        return {}
    scale, unit = (DEG_PER_RAD, "°") if next_view["unit"] == "rad" else (MM_PER_M, "mm")
    sigma = {
        key: f"{format_number(next_view[key] * scale, 2)} {unit}"
        for key in ("sigma_one", "sigma_four")
    }
    return {"description": f"{next_view['target']} {next_view['description']}"} | sigma


def tabulate_observability(run: ReportRun) -> list[dict[str, Any]]:
    """Return one row per sensor: principal and undetermined directions, and what to record next."""
    rows = []
    for name, sensor in run.sensors.items():
        T = run.T_robot_sensor(name)
        directions = principal_pose_directions(sensor["covariance"], T) if T is not None else []
        ratio = None
        if directions and directions[-1].sigma_m > 0:
            ratio = directions[0].sigma_m / directions[-1].sigma_m
        rows.append(
            {
                "name": name,
                "principal_directions": [(d.description, d.sigma_text) for d in directions],
                "sigma_ratio": format_number(ratio, 2),
                "undetermined": [d["description"] for d in sensor["undetermined"]],
                "next_view": format_next_view(sensor["next_view"]),
                "is_general_advice": sensor["recording_advice"] == GENERAL_ADVICE,
                "advice": sensor["recording_advice"] or sensor["status"]["remedy"],
            }
        )
    return rows
