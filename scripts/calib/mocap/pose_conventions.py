"""Units, quaternion order and up axis of motion capture, found from the poses."""

import numpy as np

from calib.mocap.pose_faults import MAX_POSITION_M, flag_single_poses

MAX_MOCAP_DISTANCE_M = 50.0  # no motion capture sees as far: it sends millimetres
MAX_FLOOR_THICKNESS_RATIO, MIN_FLOOR_SPREAD_M, MIN_TURN_RAD = (
    0.1,
    0.2,
    0.5,
)  # of a body that drives and turns on a floor
MIN_COS_ALONG_NORMAL, MAX_COS_ACROSS_NORMAL = (
    0.9,
    0.5,
)  # cosines of the axis it turns about to the floor's normal
MIN_COS_UPRIGHT, MAX_COS_LYING = (
    0.94,
    0.5,
)  # cosines of the tilt of a body that stands, and of one that does not
MAX_POSES_CHECKED = 2000  # poses of a stream


def to_si_xyzw(columns_by_edge):
    """The edges of a topic in metres and xyzw, and what was found and done, in words.

    columns_by_edge: {(parent, child): columns}.
    """
    words = []
    far = max(_median_distance(c["xyz"]) for c in columns_by_edge.values())
    if far > MAX_MOCAP_DISTANCE_M:
        words.append(f"millimetres, taken as such: bodies are {far:.0f} from the origin")
        columns_by_edge = {k: c | {"xyz": c["xyz"] / 1000} for k, c in columns_by_edge.items()}
    turns = [
        t
        for c in columns_by_edge.values()
        if (t := _compare_turn_axes(c["xyz"], c["quat"])) is not None
    ]
    if turns and all(
        as_sent < MAX_COS_ACROSS_NORMAL and turned > MIN_COS_ALONG_NORMAL
        for as_sent, turned, _ in turns
    ):
        words.append("quaternions as wxyz, taken as such: as xyzw a body would roll as it drives")
        columns_by_edge = {
            k: c | {"quat": np.roll(c["quat"], -1, axis=1)} for k, c in columns_by_edge.items()
        }
    elif standing := [child for (_, child), c in columns_by_edge.items() if _is_upright_as_wxyz(c)]:
        words.append(
            f"quaternions may be wxyz, taken as xyzw: {standing[0]} never stands upright, and "
            "always would as wxyz; mend what publishes them if no target is found"
        )
    if turns and all(abs(normal[1]) > MIN_COS_ALONG_NORMAL for *_, normal in turns):
        words.append(
            "the y axis of the map points up: bodies drive across it; no result depends on it"
        )
    return columns_by_edge, words


def _median_distance(xyz):
    """Median distance of positions to the origin, zeros and what is no number left out."""
    sane = (np.abs(xyz) < 1e3 * MAX_POSITION_M).all(1)  # neither NaN nor a wrong bit
    far = np.linalg.norm(xyz[sane], axis=1)
    far = far[far > 0]
    return float(np.median(far)) if len(far) else 0.0


def _is_upright_as_wxyz(columns):
    """Whether a body stands upright all the time if its quaternions are read as wxyz, and never as
    they are sent."""
    xyz, quat = columns["xyz"], columns["quat"]
    quat = quat[flag_single_poses(xyz, quat) == ""]
    as_sent, turned = (1 - 2 * (q[:, :2] ** 2).sum(1) for q in (quat, np.roll(quat, -1, axis=1)))
    return len(quat) > 0 and as_sent.max() < MAX_COS_LYING and turned.min() > MIN_COS_UPRIGHT


def _compare_turn_axes(xyz, quat):
    """How well the axis about which a body turns while it drives on a floor fits the floor's
    normal (cosines), its quaternions read as xyzw and as wxyz, and that normal (3,); None of a body
    that does not."""
    fine = np.flatnonzero(flag_single_poses(xyz, quat) == "")
    fine = fine[:: max(1, len(fine) // MAX_POSES_CHECKED)]
    if len(fine) < 10:
        return None
    _, size, axes = np.linalg.svd(xyz[fine] - xyz[fine].mean(0), full_matrices=False)
    size = size / np.sqrt(len(fine))
    if size[1] < MIN_FLOOR_SPREAD_M or size[2] > MAX_FLOOR_THICKNESS_RATIO * size[1]:
        return None
    readings = [quat[fine], np.roll(quat[fine], -1, axis=1)]
    turned = [_find_turn_axis(q) for q in readings]
    if any(a is None for a in turned):
        return None
    return *(abs(float(a @ axes[2])) for a in turned), axes[2]


def _find_turn_axis(quat):
    """Unit vector about which orientations differ most, in the map; None if they hardly do."""
    v, w, v0, w0 = quat[:, :3], quat[:, 3:], quat[0, :3], quat[0, 3]
    turns = w0 * v - w * v0 - np.cross(v, v0)  # vector part of q q0⁻¹
    _, size, axes = np.linalg.svd(turns, full_matrices=False)
    return axes[0] if size[0] / np.sqrt(len(turns)) > np.sin(MIN_TURN_RAD / 2) else None
