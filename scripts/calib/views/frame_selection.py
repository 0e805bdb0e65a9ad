"""Which frames of a sensor show its targets, and which of those are kept."""

from functools import cache

import numpy as np

from calib.geometry import se3
from calib.io import pose_block
from calib.io.status import OK, failed
from calib.mocap.body_trajectory import NS
from calib.views import sensor_reader

TRIMMED_S = 0.05  # σ of a clock that the ends which gate cuts off the rests are enough for
SPARE = 1.5  # of max_placements: what is kept, for some may prove to be out of view


def mounts(targets, guess):
    """T_body_target (4, 4) by target: of the config blocks `targets`, or as guess.json found it;
    without those whose mount is unknown and was not found."""
    stated = {
        n: pose_block.pose(c["T_body_target"]) for n, c in targets.items() if "mount" not in c
    }
    found = {n: np.array(m["T_body_target"]["matrix"]) for n, m in guess["mounts"].items()}
    return stated | found


def placed(placements, mounts):
    """T_robot_target (n, 4, 4) of every placement; mounts: T_body_target (4, 4) by target."""
    T_robot_body = se3.from_xyz_quat(placements["xyz"], placements["quat"])
    T_body_target = [mounts.get(name, np.eye(4)) for name in placements["target"]]
    return T_robot_body @ np.reshape(T_body_target, (-1, 4, 4))


def timed(frames, offset):
    """Columns of frames.parquet with `seen`, stamps on the clock of the MCS, ns; offset, s."""
    return frames | {"seen": np.asarray(frames["t"]) + round(offset * NS)}


def trimmed(placements, sigma):
    """The placements with both ends of each still one moved in, for clocks that are told no better
    than to sigma, s; by a third of it at most."""
    length = np.asarray(placements["end"]) - placements["start"]
    inside = round(2 * max(0.0, sigma - TRIMMED_S) * NS)
    inside = np.where(placements["kind"] == "still", np.minimum(inside, length // 3), 0)
    return placements | {"start": placements["start"] + inside, "end": placements["end"] - inside}


def considered(frames, placements, name):
    """Placement (n,) of one target that each frame (timed) lies in, or -1."""
    rows = np.flatnonzero((placements["target"] == name) & (placements["kind"] == "still"))
    if len(rows) == 0:
        return np.full(len(frames["seen"]), -1)
    start, end = placements["start"][rows], placements["end"][rows]
    at = np.searchsorted(start, frames["seen"], "right") - 1
    return np.where((at >= 0) & (frames["seen"] <= end[at]), rows[at], -1)


def choose(sensor, target, placement, T_robot_target, T_robot_sensor, margin, options):
    """Reason (n,) against each frame of one target; "" for those to be read.

    placement: of each frame (considered); T_robot_target (k, 4, 4): of every placement. What is
    kept is a superset: extract decides again at the pose it finds, so half as many placements more
    than wanted are kept.
    """
    reason = np.full(len(placement), "not still", dtype=object)
    numbers = np.unique(placement[placement >= 0])
    reason[placement >= 0] = "not a new pose"
    T_sensor_robot, room = (
        se3.inverse(T_robot_sensor),
        round(SPARE * options["max_placements"]),
    )
    for k in new_poses(T_robot_target, numbers, options):
        during = np.flatnonzero(placement == k)
        T_sensor_target = T_sensor_robot @ T_robot_target[k]
        why = sensor.hidden(sensor.model, target, T_sensor_target, margin, options)
        room -= not why
        reason[during] = why or "enough placements"
        if not why and room >= 0:
            reason[during] = "enough frames of this placement"
            reason[during[evenly(len(during), options["max_frames"])]] = ""
    return reason


def seen(name, reasons):
    """Ok, or why a sensor has no view at all; reasons: against each, "" for those kept."""
    if "" in reasons:
        return OK
    counts = ", ".join(f"{reasons.count(r)} {r}" for r in sorted(set(reasons)))
    return failed(
        f"{name} has no view of a target",
        counts or "no frame",
        "1 or more",
        _remedy(reasons),
    )


def _remedy(reasons):
    """What to do where nothing was kept, for these reasons."""
    if "seen from behind" in reasons:
        return (
            "Turn T_body_target of the board that is seen from behind, if it is mounted the other "
            "way round: who looks at its face sees x to the right, y up and z towards himself."
        )
    return "Check T_robot_sensor and the targets' bodies, or record this sensor's view."


def rows(sensor, shapes, frames, placements, poses, margin, content_of, options):
    """Rows of views.parquet of one sensor's frames (timed); content_of(i) reads one, once for all
    targets.

    poses: T_robot_target (k, 4, 4) of every placement, and the guess T_robot_sensor (4, 4), which
    may be wrong by margin (6,).
    """
    plan, T_sensor_target = {}, se3.inverse(poses[1]) @ poses[0]
    for name, target in sorted(shapes.items()):
        placement = considered(frames, placements, name)
        reason = choose(sensor, target, placement, *poses, margin, options)
        plan[name] = target, placement, reason
    out = []
    for i, (t, seen) in enumerate(zip(frames["t"], frames["seen"], strict=True)):
        once = cache(content_of)
        for name, (target, placement, reason) in plan.items():
            k, why, payload = placement[i], reason[i], sensor.nothing()
            if not why:
                span = placements["start"][k], placements["end"][k]
                where = seen, span, target, T_sensor_target[k], margin
                payload, why = sensor_reader.cut(sensor, once, i, *where)
            about = {"t": t, "target": name, "placement": k, "kept": not why, "reason": why}
            out.append(about | payload)
    return out


def new_poses(T, numbers, options):
    """Of the placements `numbers` (k,) those that are new, the most different first; T (n, 4, 4)
    of all placements, in the robot frame: no guess of a sensor has a part in it."""
    numbers = np.asarray(numbers, int)
    least = options["min_distance_m"], np.radians(options["min_angle_deg"])
    return numbers[most_different(T[numbers], *least, len(numbers))]


def most_different(T, min_distance, min_angle, most):
    """Indices of at most `most` poses T (n, 4, 4), each new against all others chosen.

    Farthest first: the next is the one whose nearest chosen pose is farthest, with distances in
    units of min_distance, m, and min_angle, rad; ties go to the earlier. What is left over is
    nearer than one unit to a chosen one, or one too many.
    """
    if len(T) == 0:
        return np.zeros(0, int)
    chosen, nearest = [], np.full(len(T), np.inf)
    while len(chosen) < most and nearest.max() >= 1:
        chosen.append(int(nearest.argmax()))
        away = se3.inverse(T[chosen[-1]]) @ T
        shift = np.linalg.norm(T[:, :3, 3] - T[chosen[-1], :3, 3], axis=1)
        # A threshold of zero makes every pose new.
        far = np.maximum(shift / max(min_distance, 1e-9), se3.angle(away) / max(min_angle, 1e-9))
        nearest = np.minimum(nearest, far)
        nearest[chosen] = -1
    return np.array(chosen)


def evenly(n, most):
    """At most `most` of the indices 0 .. n-1, evenly spread, ends included."""
    if n <= most:
        return np.arange(n)
    return np.unique(np.round(np.linspace(0, n - 1, most)).astype(int))
