"""Which frames of a sensor show its targets, and which of those are kept."""

from functools import cache

import numpy as np

from calib.geometry.se3 import invert_pose, pose_from_xyz_quat, rotation_angle
from calib.geometry.units import NS_PER_S
from calib.io.pose_block import pose_from_config
from calib.io.status import OK, failure_status
from calib.views.sensor_reader import read_and_cut_frame

NO_TRIM_CLOCK_SIGMA_S = (
    0.05  # σ of a clock that the ends which gate cuts off the rests are enough for
)
SPARE_PLACEMENT_FACTOR = (
    1.5  # of max_placements: what is kept, for some may prove to be out of view
)


def mounts_from_guess(targets, guess):
    """T_body_target (4, 4) by target: of the config blocks `targets`, or as guess.json found it;
    without those whose mount is unknown and was not found."""
    stated = {
        n: pose_from_config(c["T_body_target"]) for n, c in targets.items() if "mount" not in c
    }
    found = {n: np.array(m["T_body_target"]["matrix"]) for n, m in guess["mounts"].items()}
    return stated | found


def compute_target_poses(placements, mounts):
    """T_robot_target (n, 4, 4) of every placement; mounts: T_body_target (4, 4) by target."""
    T_robot_body = pose_from_xyz_quat(placements["xyz"], placements["quat"])
    T_body_target = [mounts.get(name, np.eye(4)) for name in placements["target"]]
    return T_robot_body @ np.reshape(T_body_target, (-1, 4, 4))


def with_mocap_time(frames, offset_s):
    """Columns of frames.parquet with `seen`, stamps on the clock of the MCS, ns; offset, s."""
    return frames | {"mocap_time_ns": np.asarray(frames["stamp_ns"]) + round(offset_s * NS_PER_S)}


def trim_placement_ends(placements, clock_sigma_s):
    """The placements with both ends of each still one moved in, for clocks that are told no better
    than to sigma, s; by a third of it at most."""
    length = np.asarray(placements["end_ns"]) - placements["start_ns"]
    inside = round(2 * max(0.0, clock_sigma_s - NO_TRIM_CLOCK_SIGMA_S) * NS_PER_S)
    inside = np.where(placements["kind"] == "still", np.minimum(inside, length // 3), 0)
    return placements | {
        "start_ns": placements["start_ns"] + inside,
        "end_ns": placements["end_ns"] - inside,
    }


def assign_frames_to_placements(frames, placements, target_name):
    """Placement (n,) of one target that each frame (timed) lies in, or -1."""
    rows = np.flatnonzero((placements["target"] == target_name) & (placements["kind"] == "still"))
    if len(rows) == 0:
        return np.full(len(frames["mocap_time_ns"]), -1)
    start, end = placements["start_ns"][rows], placements["end_ns"][rows]
    at = np.searchsorted(start, frames["mocap_time_ns"], "right") - 1
    return np.where((at >= 0) & (frames["mocap_time_ns"] <= end[at]), rows[at], -1)


def select_frames(
    sensor, target, placement_by_frame, T_robot_target, T_robot_sensor, margin, options
):
    """Reason (n,) against each frame of one target; "" for those to be read.

    placement_by_frame: of each frame (considered); T_robot_target (k, 4, 4): of every placement. What is
    kept is a superset: extract decides again at the pose it finds, so half as many placements more
    than wanted are kept.
    """
    reason = np.full(len(placement_by_frame), "not still", dtype=object)
    numbers = np.unique(placement_by_frame[placement_by_frame >= 0])
    reason[placement_by_frame >= 0] = "not a new pose"
    T_sensor_robot, room = (
        invert_pose(T_robot_sensor),
        round(SPARE_PLACEMENT_FACTOR * options["max_placements"]),
    )
    for k in select_new_poses(T_robot_target, numbers, options):
        during = np.flatnonzero(placement_by_frame == k)
        T_sensor_target = T_sensor_robot @ T_robot_target[k]
        why = sensor.check_visibility(sensor.model, target, T_sensor_target, margin, options)
        room -= not why
        reason[during] = why or "enough placements"
        if not why and room >= 0:
            reason[during] = "enough frames of this placement"
            reason[during[space_evenly(len(during), options["max_frames"])]] = ""
    return reason


def visibility_status(sensor_name, reasons):
    """Ok, or why a sensor has no view at all; reasons: against each, "" for those kept."""
    if "" in reasons:
        return OK
    counts = ", ".join(f"{reasons.count(r)} {r}" for r in sorted(set(reasons)))
    return failure_status(
        f"{sensor_name} has no view of a target",
        counts or "no frame",
        "1 or more",
        _visibility_remedy(reasons),
    )


def _visibility_remedy(reasons):
    """What to do where nothing was kept, for these reasons."""
    if "seen from behind" in reasons:
        return (
            "Turn T_body_target of the board that is seen from behind, if it is mounted the other "
            "way round: who looks at its face sees x to the right, y up and z towards himself."
        )
    return "Check T_robot_sensor and the targets' bodies, or record this sensor's view."


def make_view_rows(
    sensor, targets, frames, placements, target_and_sensor_poses, margin, read_frame, options
):
    """Rows of views.parquet of one sensor's frames (timed); content_of(i) reads one, once for all
    targets.

    target_and_sensor_poses: T_robot_target (k, 4, 4) of every placement, and the guess T_robot_sensor (4, 4), which
    may be wrong by margin (6,).
    """
    plan, T_sensor_target = {}, invert_pose(target_and_sensor_poses[1]) @ target_and_sensor_poses[0]
    for name, target in sorted(targets.items()):
        placement = assign_frames_to_placements(frames, placements, name)
        reason = select_frames(sensor, target, placement, *target_and_sensor_poses, margin, options)
        plan[name] = target, placement, reason
    out = []
    for i, (t, seen) in enumerate(zip(frames["stamp_ns"], frames["mocap_time_ns"], strict=True)):
        once = cache(read_frame)
        for name, (target, placement, reason) in plan.items():
            k, why, payload = placement[i], reason[i], sensor.empty_payload()
            if not why:
                span = placements["start_ns"][k], placements["end_ns"][k]
                where = seen, span, target, T_sensor_target[k], margin
                payload, why = read_and_cut_frame(sensor, once, i, *where)
            about = {"stamp_ns": t, "target": name, "placement": k, "kept": not why, "reason": why}
            out.append(about | payload)
    return out


def select_new_poses(poses, numbers, options):
    """Of the placements `numbers` (k,) those that are new, the most different first; poses (n, 4, 4)
    of all placements, in the robot frame: no guess of a sensor has a part in it."""
    numbers = np.asarray(numbers, int)
    least = options["min_distance_m"], np.radians(options["min_angle_deg"])
    return numbers[select_most_different(poses[numbers], *least, len(numbers))]


def select_most_different(poses, min_distance, min_angle, n_max):
    """Indices of at most `most` poses poses (n, 4, 4), each new against all others chosen.

    Farthest first: the next is the one whose nearest chosen pose is farthest, with distances in
    units of min_distance, m, and min_angle, rad; ties go to the earlier. What is left over is
    nearer than one unit to a chosen one, or one too many.
    """
    if len(poses) == 0:
        return np.zeros(0, int)
    chosen, nearest = [], np.full(len(poses), np.inf)
    while len(chosen) < n_max and nearest.max() >= 1:
        chosen.append(int(nearest.argmax()))
        away = invert_pose(poses[chosen[-1]]) @ poses
        shift = np.linalg.norm(poses[:, :3, 3] - poses[chosen[-1], :3, 3], axis=1)
        # A threshold of zero makes every pose new.
        far = np.maximum(
            shift / max(min_distance, 1e-9), rotation_angle(away) / max(min_angle, 1e-9)
        )
        nearest = np.minimum(nearest, far)
        nearest[chosen] = -1
    return np.array(chosen)


def space_evenly(n, n_max):
    """At most `most` of the indices 0 .. n-1, evenly spread, ends included."""
    if n <= n_max:
        return np.arange(n)
    return np.unique(np.round(np.linspace(0, n - 1, n_max)).astype(int))
