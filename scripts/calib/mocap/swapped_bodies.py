"""Bodies that motion capture called by each other's name for a while."""

import numpy as np

from calib.mocap.pose_faults import exceeds_speed

SWAP_FAULT = "names swapped"


def flag_swaps(tracks):
    """{name: columns} of bodies in one frame, with NAMED for those jumps by which two bodies go on
    where the other was, at the same time."""
    out = {name: c | {"fault": c["fault"].copy()} for name, c in tracks.items()}
    for name, other in _jumping_pairs(tracks):
        for first, last in _find_exchanges(tracks[name], tracks[other]):
            out[name]["fault"][first : last + 1] = SWAP_FAULT
    return out


def _jumping_pairs(tracks):
    jumped = [name for name, c in tracks.items() if (c["fault"] == "jump").any()]
    return [(a, b) for a in jumped for b in jumped if a != b]


def _find_exchanges(track, other_track):
    """Runs (first, last) of jumps of one body in the other's place while that is in its place."""
    back = [
        (other_track["stamp_ns"][a], other_track["stamp_ns"][b])
        for a, b in _find_takeovers(other_track, track)
    ]
    return [
        (a, b)
        for a, b in _find_takeovers(track, other_track)
        if any(track["stamp_ns"][a] <= end and start <= track["stamp_ns"][b] for start, end in back)
    ]


def _find_takeovers(track, other_track):
    """Runs (first, last) of jumps of one body that begin where the other was seen last before, or
    end where it is seen first again."""
    edges = np.diff(np.concatenate([[False], track["fault"] == "jump", [False]]).astype(int))
    runs = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1, strict=True)
    fine = np.flatnonzero(other_track["fault"] == "")
    t, found = other_track["stamp_ns"][fine], []
    for first, last in runs:
        before, after = (
            np.searchsorted(t, track["stamp_ns"][first]) - 1,
            np.searchsorted(t, track["stamp_ns"][last]),
        )
        near = before >= 0 and _can_continue(other_track, fine[before], track, first)
        if near or (after < len(t) and _can_continue(track, last, other_track, fine[after])):
            found.append((int(first), int(last)))
    return found


def _can_continue(track, row, other_track, other_row):
    """Whether pose k of a track may be where pose i of another went."""
    xyz, quat = (np.stack([track[c][row], other_track[c][other_row]]) for c in ("xyz", "quat"))
    return not exceeds_speed(
        np.array([track["stamp_ns"][row], other_track["stamp_ns"][other_row]]), xyz, quat
    )[0]
