"""Units, quaternion order and up axis of motion capture, found from the poses."""

import numpy as np

from calib.mocap import pose_faults

FAR_M = 50.0  # no motion capture sees as far: it sends millimetres
PLANE, SPREAD_M, TURN_RAD = 0.1, 0.2, 0.5  # of a body that drives and turns on a floor
ALONG, ACROSS = 0.9, 0.5  # cosines of the axis it turns about to the floor's normal
UPRIGHT, LYING = 0.94, 0.5  # cosines of the tilt of a body that stands, and of one that does not
LOOKED_AT = 2000  # poses of a stream


def standard(edges):
    """The edges of a topic in metres and xyzw, and what was found and done, in words.

    edges: {(parent, child): columns}.
    """
    words = []
    far = max(_distance(c["xyz"]) for c in edges.values())
    if far > FAR_M:
        words.append(f"millimetres, taken as such: bodies are {far:.0f} from the origin")
        edges = {k: c | {"xyz": c["xyz"] / 1000} for k, c in edges.items()}
    turns = [t for c in edges.values() if (t := _turning(c["xyz"], c["quat"])) is not None]
    if turns and all(as_sent < ACROSS and turned > ALONG for as_sent, turned, _ in turns):
        words.append("quaternions as wxyz, taken as such: as xyzw a body would roll as it drives")
        edges = {k: c | {"quat": np.roll(c["quat"], -1, axis=1)} for k, c in edges.items()}
    elif standing := [child for (_, child), c in edges.items() if _stands_as_wxyz(c)]:
        words.append(
            f"quaternions may be wxyz, taken as xyzw: {standing[0]} never stands upright, and "
            "always would as wxyz; mend what publishes them if no target is found"
        )
    if turns and all(abs(normal[1]) > ALONG for *_, normal in turns):
        words.append(
            "the y axis of the map points up: bodies drive across it; no result depends on it"
        )
    return edges, words


def _distance(xyz):
    """Median distance of positions to the origin, zeros and what is no number left out."""
    sane = (np.abs(xyz) < 1e3 * pose_faults.MOST_M).all(1)  # neither NaN nor a wrong bit
    far = np.linalg.norm(xyz[sane], axis=1)
    far = far[far > 0]
    return float(np.median(far)) if len(far) else 0.0


def _stands_as_wxyz(columns):
    """Whether a body stands upright all the time if its quaternions are read as wxyz, and never as
    they are sent."""
    xyz, quat = columns["xyz"], columns["quat"]
    quat = quat[pose_faults.alone(xyz, quat) == ""]
    as_sent, turned = (1 - 2 * (q[:, :2] ** 2).sum(1) for q in (quat, np.roll(quat, -1, axis=1)))
    return len(quat) > 0 and as_sent.max() < LYING and turned.min() > UPRIGHT


def _turning(xyz, quat):
    """How well the axis about which a body turns while it drives on a floor fits the floor's
    normal (cosines), its quaternions read as xyzw and as wxyz, and that normal (3,); None of a body
    that does not."""
    fine = np.flatnonzero(pose_faults.alone(xyz, quat) == "")
    fine = fine[:: max(1, len(fine) // LOOKED_AT)]
    if len(fine) < 10:
        return None
    _, size, axes = np.linalg.svd(xyz[fine] - xyz[fine].mean(0), full_matrices=False)
    size = size / np.sqrt(len(fine))
    if size[1] < SPREAD_M or size[2] > PLANE * size[1]:
        return None
    readings = [quat[fine], np.roll(quat[fine], -1, axis=1)]
    turned = [_axis(q) for q in readings]
    if any(a is None for a in turned):
        return None
    return *(abs(float(a @ axes[2])) for a in turned), axes[2]


def _axis(quat):
    """Unit vector about which orientations differ most, in the map; None if they hardly do."""
    v, w, v0, w0 = quat[:, :3], quat[:, 3:], quat[0, :3], quat[0, 3]
    turns = w0 * v - w * v0 - np.cross(v, v0)  # vector part of q q0⁻¹
    _, size, axes = np.linalg.svd(turns, full_matrices=False)
    return axes[0] if size[0] / np.sqrt(len(turns)) > np.sin(TURN_RAD / 2) else None
