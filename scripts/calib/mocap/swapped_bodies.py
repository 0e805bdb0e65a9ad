"""Bodies that motion capture called by each other's name for a while."""

import numpy as np

from calib.mocap import pose_faults

NAMED = "names swapped"


def named(tracks):
    """{name: columns} of bodies in one frame, with NAMED for those jumps by which two bodies go on
    where the other was, at the same time."""
    out = {name: c | {"fault": c["fault"].copy()} for name, c in tracks.items()}
    for name, other in _pairs(tracks):
        for first, last in _exchanged(tracks[name], tracks[other]):
            out[name]["fault"][first : last + 1] = NAMED
    return out


def _pairs(tracks):
    jumped = [name for name, c in tracks.items() if (c["fault"] == "jump").any()]
    return [(a, b) for a in jumped for b in jumped if a != b]


def _exchanged(one, other):
    """Runs (first, last) of jumps of one body in the other's place while that is in its place."""
    back = [(other["t"][a], other["t"][b]) for a, b in _taken_over(other, one)]
    return [
        (a, b)
        for a, b in _taken_over(one, other)
        if any(one["t"][a] <= end and start <= one["t"][b] for start, end in back)
    ]


def _taken_over(one, other):
    """Runs (first, last) of jumps of one body that begin where the other was seen last before, or
    end where it is seen first again."""
    edges = np.diff(np.concatenate([[False], one["fault"] == "jump", [False]]).astype(int))
    runs = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1, strict=True)
    fine = np.flatnonzero(other["fault"] == "")
    t, found = other["t"][fine], []
    for first, last in runs:
        before, after = np.searchsorted(t, one["t"][first]) - 1, np.searchsorted(t, one["t"][last])
        near = before >= 0 and _goes_on(other, fine[before], one, first)
        if near or (after < len(t) and _goes_on(one, last, other, fine[after])):
            found.append((int(first), int(last)))
    return found


def _goes_on(one, i, other, k):
    """Whether pose k of a track may be where pose i of another went."""
    xyz, quat = (np.stack([one[c][i], other[c][k]]) for c in ("xyz", "quat"))
    return not pose_faults.far(np.array([one["t"][i], other["t"][k]]), xyz, quat)[0]
