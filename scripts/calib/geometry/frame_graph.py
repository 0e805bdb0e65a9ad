"""Frames joined by transforms: the shortest path between two frames, and the pose along it."""

from collections import deque
from collections.abc import Iterable, Mapping

import numpy as np

Edge = tuple[str, str]  # parent frame, child frame


class FrameGraph:
    """Frames joined by edges (parent, child)."""

    def __init__(self, edges: Iterable[Edge]) -> None:
        self._children: dict[str, set[str]] = {}
        self._parents: dict[str, set[str]] = {}
        for parent, child in edges:
            self._children.setdefault(parent, set()).add(child)
            self._parents.setdefault(child, set()).add(parent)

    def find_path(self, start: str, goal: str, towards_parents: bool = True) -> list[Edge] | None:
        """Return the steps (frame, next frame) from start to goal, or None if there is no path.

        The path has the fewest steps; among equally short paths the alphabetically first is
        taken. Without `towards_parents` only steps from a parent to its child count.
        """
        previous: dict[str, str | None] = {start: None}
        queue = deque([start])
        while queue and goal not in previous:
            frame = queue.popleft()
            neighbours = self._children.get(frame, set())
            if towards_parents:
                neighbours = neighbours | self._parents.get(frame, set())
            for neighbour in sorted(neighbours - previous.keys()):
                previous[neighbour] = frame
                queue.append(neighbour)
        if goal not in previous:
            return None
        path, frame = [], goal
        while (before := previous[frame]) is not None:
            path.append((before, frame))
            frame = before
        return path[::-1]


def lookup_transform(
    transforms: Mapping[Edge, np.ndarray], from_frame: str, to_frame: str
) -> np.ndarray | None:
    """Return T_from_to (4, 4) along the shortest path, or None if there is none.

    transforms: {(parent, child): T_parent_child (4, 4)}, used in both directions.
    """
    # Not at the top: decode uses the graph alone, and SciPy takes 0.3 s to import.
    from calib.geometry.se3 import invert_pose

    path = FrameGraph(transforms).find_path(from_frame, to_frame)
    if path is None:
        return None
    T = np.eye(4)
    for frame, neighbour in path:
        forward = transforms.get((frame, neighbour))
        T = T @ (invert_pose(transforms[neighbour, frame]) if forward is None else forward)
    return T
