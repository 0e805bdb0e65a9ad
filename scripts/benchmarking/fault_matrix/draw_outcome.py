"""What the verdict on a draw says, and by how much the poses err."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.geometry.se3 import invert_pose, se3_log
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.io.config_change import ConfigChange

NO_CAUSE = ""  # of a pass


@dataclass(frozen=True)
class DrawOutcome:
    """A verdict and the errors of the poses that it is about.

    level: of the rig; first: text and remedy of the first finding without its rivals, NO_CAUSE
    without one; change: what it advises to write, None if that needs a person; errors: (mm, °, in
    σ) by sensor with a pose; in σ: of the worst of the six directions.
    """

    level: str
    first: str
    change: ConfigChange | None
    errors: dict[str, tuple[float, float, float]]

    @property
    def worst_sigmas(self) -> float:
        """The largest error of all sensors, in σ; 0 without a pose."""
        return max((e[2] for e in self.errors.values()), default=0.0)

    def names(self, causes: tuple[str, ...]) -> bool:
        """Return whether the first finding matches one of the patterns."""
        return any(re.search(cause, self.first) for cause in causes)


def read_draw_outcome(results: Path, truth_path: Path) -> DrawOutcome:
    """Read the outcome of a rig's results folder."""
    verdict = json.loads((results / "verdict.json").read_text())
    sensors = json.loads((results / "calibration.json").read_text())["sensors"]
    truth = json.loads(truth_path.read_text())["sensors"]
    found = {name: s for name, s in sensors.items() if s["T_robot_sensor"]}
    errors = {n: _pose_error(s, truth[n]["T_robot_sensor"]["matrix"]) for n, s in found.items()}
    first = verdict["findings"][0] if verdict["findings"] else None
    return DrawOutcome(
        level=verdict["verdict"],
        first=_describe_without_rivals(first) if first else NO_CAUSE,
        change=first["change"] if first else None,
        errors=errors,
    )


def _describe_without_rivals(finding: dict[str, Any]) -> str:
    """Return text and remedy of a finding, without what it says may be true instead."""
    text, remedy = finding["text"].split("; or else ")[0], finding["remedy"]
    return f"{text}. {remedy.split('; if that is right: ')[0]}"


def _pose_error(sensor: dict[str, Any], T_true: list[list[float]]) -> tuple[float, float, float]:
    """Return the error of a sensor of calibration.json: mm, °, and σ of its worst direction."""
    error = se3_log(invert_pose(np.array(T_true)) @ np.array(sensor["T_robot_sensor"]["matrix"]))
    sigma = np.sqrt(np.diag(np.array(sensor["covariance"])))
    shift, turn = (float(np.linalg.norm(e)) for e in (error[:3], error[3:]))
    return MM_PER_M * shift, DEG_PER_RAD * turn, float(np.max(np.abs(error) / sigma))
