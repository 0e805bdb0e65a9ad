"""Which frames of a sensor show its targets, and the part of each around them."""

from functools import cache

import numpy as np

from calib import clouds, geometry, images, rig, tables, views
from calib.mocap import NS
from calib.status import OK, MessageError, failed

TRIMMED_S = 0.05  # σ of a clock that the ends which gate cuts off the rests are enough for
SPARE = 1.5  # of max_placements: what is kept, for some may prove to be out of view


class Lidar:
    """What crop does with a lidar's messages."""

    schema = tables.VIEWS_LIDAR
    hidden = staticmethod(views.hidden_from_lidar)

    def __init__(self, config):
        self.model = rig.Lidar.from_config(config)
        self.layout = clouds.Layout.from_dict(config["layout"])
        self.timed = self.layout.time is not None

    def nothing(self):
        return {"xyz": [], "ring": [], "dt": []}

    def read(self, message):
        """xyz (n, 3), m, ring (n,) and dt (n,), ns (clouds.points)."""
        return clouds.points(message, self.layout)

    def cut(self, points, t, span, target, T_sensor_target, margin):
        """(payload, reason why there is none) of the angular window around a target."""
        xyz, ring, dt = points
        if not len(xyz):
            return self.nothing(), "no return at all"
        # All of the scan, for the window's part of it would depend on the guess.
        first, last = self.layout.reach(dt)
        if t + first < span[0] or t + last > span[1]:
            return self.nothing(), "scan reaches into a move"
        inside = views.cone(xyz.astype(float), target, T_sensor_target, margin)
        if not inside.any():
            return self.nothing(), "no return in the window"
        return {"xyz": xyz[inside].reshape(-1), "ring": ring[inside], "dt": dt[inside]}, ""


class Camera:
    """What crop does with a camera's messages."""

    schema = tables.VIEWS_CAMERA
    timed = True
    hidden = staticmethod(views.hidden_from_camera)

    def __init__(self, config):
        self.model = rig.camera(config)

    def nothing(self):
        return {"u0": 0, "v0": 0, "png": b""}

    def read(self, message):
        """The image (h, w, 3) uint8 (images.bgr)."""
        return images.bgr(message)

    def cut(self, image, t, span, target, T_sensor_target, margin):
        """(payload, reason why there is none) of the image region around a target."""
        if image.shape[1::-1] != self.model.size:
            size = f"{image.shape[1]} x {image.shape[0]}"
            return self.nothing(), f"image of {size} px, size_px says otherwise"
        u0, u1, v0, v1 = views.region(self.model, target, T_sensor_target, margin)
        return {"u0": u0, "v0": v0, "png": images.to_png(image[v0:v1, u0:u1])}, ""


KINDS = {"lidar": Lidar, "camera": Camera}


def reader(log, config, frames):
    """content_of(i): what a sensor measured in its frame i (columns of frames.parquet): points or
    an image. It raises MessageError where that message cannot be read.

    config: the sensor's block, completed by what the log tells (rig.heard).
    """
    sensor = KINDS[config["kind"]](config)

    def content_of(i):
        place = (int(frames[k][i]) for k in ("file", "log_t", "ordinal"))
        return sensor.read(log.message(config["topic"], *place))

    return content_of


def cut(sensor, content_of, i, *where):
    """(payload, reason why there is none) of frame i around a target (cut of a sensor)."""
    try:
        return sensor.cut(content_of(i), *where)
    except MessageError as error:
        return sensor.nothing(), f"cannot be read: {error}"


def mounts(targets, guess):
    """T_body_target (4, 4) by target: of the config blocks `targets`, or as guess.json found it;
    without those whose mount is unknown and was not found."""
    stated = {n: rig.pose(c["T_body_target"]) for n, c in targets.items() if "mount" not in c}
    found = {n: np.array(m["T_body_target"]["matrix"]) for n, m in guess["mounts"].items()}
    return stated | found


def placed(placements, mounts):
    """T_robot_target (n, 4, 4) of every placement; mounts: T_body_target (4, 4) by target."""
    T_robot_body = geometry.from_xyz_quat(placements["xyz"], placements["quat"])
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
        geometry.inverse(T_robot_sensor),
        round(SPARE * options["max_placements"]),
    )
    for k in views.new_poses(T_robot_target, numbers, options):
        during = np.flatnonzero(placement == k)
        T_sensor_target = T_sensor_robot @ T_robot_target[k]
        why = sensor.hidden(sensor.model, target, T_sensor_target, margin, options)
        room -= not why
        reason[during] = why or "enough placements"
        if not why and room >= 0:
            reason[during] = "enough frames of this placement"
            reason[during[views.evenly(len(during), options["max_frames"])]] = ""
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
    plan, T_sensor_target = {}, geometry.inverse(poses[1]) @ poses[0]
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
                payload, why = cut(sensor, once, i, *where)
            about = {"t": t, "target": name, "placement": k, "kept": not why, "reason": why}
            out.append(about | payload)
    return out
