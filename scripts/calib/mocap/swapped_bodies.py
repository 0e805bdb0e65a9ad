"""Bodies whose names motion capture swapped for a while."""

import numpy as np

from calib.geometry.mask_runs import find_runs
from calib.io.parquet_tables import Columns
from calib.mocap.pose_faults import exceeds_speed

SWAP_FAULT = "names swapped"


def flag_swaps(tracks: dict[str, Columns]) -> dict[str, Columns]:
    """Flag the jumps by which two bodies continue each other's track at the same time.

    tracks: {body: columns} of the bodies in one frame. Returns them with SWAP_FAULT in place of
    "jump" at these poses.
    """
    out = {name: c | {"fault": c["fault"].copy()} for name, c in tracks.items()}
    for name, other in _jumping_pairs(tracks):
        for first, last in _find_exchanges(tracks[name], tracks[other]):
            out[name]["fault"][first : last + 1] = SWAP_FAULT
    return out


def _jumping_pairs(tracks: dict[str, Columns]) -> list[tuple[str, str]]:
    jumped = [name for name, c in tracks.items() if (c["fault"] == "jump").any()]
    return [(a, b) for a in jumped for b in jumped if a != b]


def _find_exchanges(track: Columns, other_track: Columns) -> list[tuple[int, int]]:
    """Return the runs (first, last) of jumps of a body by which both exchange their places."""
    t, other_t = track["stamp_ns"], other_track["stamp_ns"]
    returns = [(other_t[a], other_t[b]) for a, b in _find_takeovers(other_track, track)]
    return [
        (first, last)
        for first, last in _find_takeovers(track, other_track)
        if any(t[first] <= end and start <= t[last] for start, end in returns)
    ]


def _find_takeovers(track: Columns, other_track: Columns) -> list[tuple[int, int]]:
    """Return the runs (first, last) of jumps of a body that continue the track of the other.

    Such a run begins where the other was seen last before, or ends where it is seen next.
    """
    good = np.flatnonzero(other_track["fault"] == "")
    t, takeovers = other_track["stamp_ns"][good], []
    for first, last in find_runs(track["fault"] == "jump").tolist():
        before = np.searchsorted(t, track["stamp_ns"][first]) - 1
        after = np.searchsorted(t, track["stamp_ns"][last])
        begins = before >= 0 and _can_continue(other_track, good[before], track, first)
        if begins or (after < len(t) and _can_continue(track, last, other_track, good[after])):
            takeovers.append((first, last))
    return takeovers


def _can_continue(track: Columns, row: int, other_track: Columns, other_row: int) -> bool:
    """Return whether a body can have moved from a pose of one track to a pose of the other."""
    xyz, quat = (np.stack([track[c][row], other_track[c][other_row]]) for c in ("xyz", "quat"))
    t = np.array([track["stamp_ns"][row], other_track["stamp_ns"][other_row]])
    return not exceeds_speed(t, xyz, quat)[0]
