"""Static transforms: a graph of frames, and the pose between two of them."""

import numpy as np

from calib.geometry import se3


def chain(edges, start, goal):
    """T_start_goal (4, 4) along the fewest edges {(parent, child): T_parent_child}, or None.

    Edges are walked both ways; among equally short ways the alphabetically first is taken.
    """
    steps = {}
    for (parent, child), T in sorted(edges.items()):
        steps.setdefault(parent, []).append((child, T))
        steps.setdefault(child, []).append((parent, se3.inverse(T)))
    reached, todo = {start: np.eye(4)}, [start]
    while todo and goal not in reached:
        here = todo.pop(0)
        for there, T in sorted(steps.get(here, []), key=lambda s: s[0]):
            if there not in reached:
                reached[there] = reached[here] @ T
                todo.append(there)
    return reached.get(goal)
