"""Static transforms: a graph of frames, and the pose between two of them."""

import numpy as np

from calib.geometry.se3 import invert_pose


def lookup_transform(transforms, from_frame, to_frame):
    """T_start_goal (4, 4) along the fewest edges {(parent, child): T_parent_child}, or None.

    Edges are walked both ways; among equally short ways the alphabetically first is taken.
    """
    steps = {}
    for (parent, child), T in sorted(transforms.items()):
        steps.setdefault(parent, []).append((child, T))
        steps.setdefault(child, []).append((parent, invert_pose(T)))
    reached, todo = {from_frame: np.eye(4)}, [from_frame]
    while todo and to_frame not in reached:
        here = todo.pop(0)
        for there, T in sorted(steps.get(here, []), key=lambda s: s[0]):
            if there not in reached:
                reached[there] = reached[here] @ T
                todo.append(there)
    return reached.get(to_frame)
