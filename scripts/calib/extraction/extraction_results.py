"""Keypoints and outcomes of the views of one sensor."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.io.parquet_tables import concatenate_columns, empty_columns
from calib.io.status import OK, Status, failure_status
from calib.io.table_schemas import KEYPOINTS_SCHEMA
from calib.views.target_placements import Columns


class ViewKeypoints(NamedTuple):
    """Columns of keypoints.parquet of one view, None if nothing was found, and why.

    is_wanted: False for a view that is not used, because its target is not in view or others are
    enough.
    """

    columns: Columns | None
    status: Status
    is_wanted: bool = True


class ViewOutcome(NamedTuple):
    """Status of one view of views.parquet by its number; is_wanted: see ViewKeypoints."""

    view: int
    status: Status
    is_wanted: bool = True


@dataclass(frozen=True)
class Extraction:
    """Keypoints of a sensor's views, their outcomes, and the working pose T_robot_sensor (4, 4).

    The pose is None if nothing was found. agreeing_views: numbers of the views with measurements
    that agree with that pose.
    """

    keypoints: Columns
    outcomes: list[ViewOutcome]
    T_robot_sensor: np.ndarray | None = None
    agreeing_views: frozenset[int] = frozenset()

    @classmethod
    def empty(cls) -> "Extraction":
        return cls(empty_columns(KEYPOINTS_SCHEMA), [])

    @classmethod
    def collect(
        cls,
        views: Columns,
        results: Mapping[int, ViewKeypoints],
        T_robot_sensor: np.ndarray | None = None,
    ) -> "Extraction":
        """Collect the results by row of views."""
        parts = [r.columns for r in results.values() if r.status.ok and r.columns is not None]
        outcomes = [
            ViewOutcome(int(views["view"][i]), r.status, r.is_wanted) for i, r in results.items()
        ]
        return cls(concatenate_columns(parts, KEYPOINTS_SCHEMA), outcomes, T_robot_sensor)

    @property
    def n_keypoints(self) -> int:
        return len(self.keypoints["view"])

    @property
    def n_used_views(self) -> int:
        return sum(outcome.status.ok for outcome in self.outcomes)

    def outcomes_json(self) -> list[dict]:
        """Return the outcomes as the notes of keypoints.parquet hold them."""
        return [{"view": o.view, "status": o.status.to_dict()} for o in self.outcomes]


def extraction_status(sensor_name: str, extraction: Extraction) -> Status:
    """Return ok, or why no keypoint was extracted from the kept views."""
    if extraction.n_keypoints:
        return OK
    statuses = [outcome.status for outcome in extraction.outcomes]
    reasons = [status.reason for status in statuses]
    counts = ", ".join(f"{reasons.count(r)} × {r}" for r in sorted(set(reasons)))
    most_common = max(statuses, key=lambda status: reasons.count(status.reason), default=OK)
    return failure_status(
        f"{sensor_name}: nothing found in {len(statuses)} views",
        f"{counts}: {most_common.found}" if most_common.found else counts,
        most_common.expected or "a target in some",
        most_common.remedy
        or "Look at the views in the report. Check the size and `body` of the target, and "
        "T_robot_sensor.",
    )
