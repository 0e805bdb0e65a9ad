"""The unit of a motion capture's positions: one for all its topics.

Bodies of one room are between a hand and a hall apart: the distances between the wanted bodies tell
metres from millimetres wherever the origin is, and whatever else the topics carry.
"""

from collections.abc import Collection, Iterable, Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np

from calib.geometry.frame_graph import Edge
from calib.geometry.units import MM_PER_M
from calib.io.parquet_tables import Columns
from calib.mocap.pose_faults import MAX_POSITION_M

# Two bodies are never further apart, m; nor nearer, mm.
MAX_BODY_DISTANCE = 50.0
METRES, MILLIMETRES = "m", "mm"
MAX_POSES_COMPARED = 2000  # of a body


class PositionUnit(NamedTuple):
    """The unit of all positions of a motion capture, m or mm, and what tells it, in words."""

    name: str
    basis: str = ""

    def to_metres(self, columns: Columns) -> Columns:
        """Return columns with positions in m."""
        return columns if self.name == METRES else columns | {"xyz": columns["xyz"] / MM_PER_M}


def find_position_unit(
    columns_by_topic: Mapping[str, Mapping[Edge, Columns]],
    map_frame: str,
    wanted_frames: Collection[str],
) -> PositionUnit:
    """Return the unit that the distances between wanted bodies tell.

    wanted_frames: the wanted bodies and the frames that they are given in. With fewer than two of
    them in the map frame, the lengths of their transforms are taken.
    """
    edges = [
        (edge, columns)
        for by_edge in columns_by_topic.values()
        for edge, columns in by_edge.items()
        if edge[1] in wanted_frames
    ]
    tracks: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for (parent, child), columns in edges:
        times_and_xyz = _usable_positions(columns)
        if parent == map_frame and len(times_and_xyz[0]):
            tracks.setdefault(child, times_and_xyz)
    pairs = combinations([tracks[name] for name in sorted(tracks)], 2)
    distances, what = [_median_distance(a, b) for a, b in pairs], "apart"
    if not distances:
        distances, what = _transform_lengths(columns for _, columns in edges), "from their parent"
    distance = float(np.median(distances)) if distances else 0.0
    if distance <= MAX_BODY_DISTANCE:
        return PositionUnit(METRES)
    return PositionUnit(MILLIMETRES, f"bodies are {distance:.0f} {what}")


def _usable_positions(columns: Columns) -> tuple[np.ndarray, np.ndarray]:
    """Return log times (n,), ns, and positions (n, 3) without damaged ones and lost bodies.

    A lost body is at zero; one that is always there defines the map.
    """
    xyz = columns["xyz"]
    is_valid = (np.abs(xyz) < MM_PER_M * MAX_POSITION_M).all(1)  # neither NaN nor damaged
    is_zero = (xyz == 0).all(1)
    rows = np.flatnonzero(is_valid & (~is_zero | is_zero.all()))
    rows = rows[:: max(1, len(rows) // MAX_POSES_COMPARED)]
    return columns["log_time_ns"][rows], xyz[rows]


def _median_distance(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> float:
    """Return the median distance of two bodies at the times of the second one."""
    times, xyz = b
    order = np.argsort(a[0], kind="stable")
    other = [np.interp(times, a[0][order], a[1][order, k]) for k in range(3)]
    return float(np.median(np.linalg.norm(xyz - np.column_stack(other), axis=1)))


def _transform_lengths(columns: Iterable[Columns]) -> list[float]:
    """Return the median length of every transform that is not zero."""
    lengths = [np.linalg.norm(_usable_positions(c)[1], axis=1) for c in columns]
    return [float(np.median(length)) for length in lengths if length.any()]
