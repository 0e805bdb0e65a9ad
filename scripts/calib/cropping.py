"""Which frames of a sensor show its targets, and the part of each around them."""

import numpy as np

from calib import clouds, geometry, images, rig, tables, views


class Lidar:
    """What crop does with a lidar's messages."""

    schema = tables.VIEWS_LIDAR
    hidden = staticmethod(views.hidden_from_lidar)

    def __init__(self, config):
        self.model = rig.Lidar.from_config(config)

    def nothing(self):
        return {"xyz": [], "ring": [], "dt": []}

    def cut(self, message, t, span, target, T_sensor_target, margin):
        """(payload, reason why there is none) of the angular window around a target."""
        xyz, ring, dt = clouds.points(message)
        inside = views.cone(xyz.astype(float), target, T_sensor_target, margin)
        if not inside.any():
            return self.nothing(), "no return in the window"
        xyz, ring, dt = xyz[inside], ring[inside], dt[inside]
        if t + dt.min() < span[0] or t + dt.max() > span[1]:
            return self.nothing(), "scan reaches into a move"
        return {"xyz": xyz.reshape(-1), "ring": ring, "dt": dt}, ""


class Camera:
    """What crop does with a camera's messages."""

    schema = tables.VIEWS_CAMERA
    hidden = staticmethod(views.hidden_from_camera)

    def __init__(self, config):
        self.model = rig.camera(config)

    def nothing(self):
        return {"u0": 0, "v0": 0, "png": b""}

    def cut(self, message, t, span, target, T_sensor_target, margin):
        """(payload, reason why there is none) of the image region around a target."""
        image = images.bgr(message)
        if image.shape[1::-1] != self.model.size:
            size = f"{image.shape[1]} x {image.shape[0]}"
            return self.nothing(), f"image of {size} px, size_px says otherwise"
        u0, u1, v0, v1 = views.region(self.model, target, T_sensor_target, margin)
        return {"u0": u0, "v0": v0, "png": images.to_png(image[v0:v1, u0:u1])}, ""


KINDS = {"lidar": Lidar, "camera": Camera}


def placed(placements, mounts):
    """T_robot_target (n, 4, 4) of every placement; mounts: T_body_target (4, 4) by target."""
    T_robot_body = geometry.from_xyz_quat(placements["xyz"], placements["quat"])
    T_body_target = [mounts.get(name, np.eye(4)) for name in placements["target"]]
    return T_robot_body @ np.reshape(T_body_target, (-1, 4, 4))


def considered(frames, placements, name):
    """Placement (n,) of one target that each frame lies in, or -1."""
    rows = np.flatnonzero((placements["target"] == name) & (placements["kind"] == "still"))
    if len(rows) == 0:
        return np.full(len(frames["t"]), -1)
    start, end = placements["start"][rows], placements["end"][rows]
    at = np.searchsorted(start, frames["t"], "right") - 1
    return np.where((at >= 0) & (frames["t"] <= end[at]), rows[at], -1)


def choose(sensor, target, placement, T_sensor_target, margin, options):
    """Reason (n,) against each frame of one target; "" for those to be read.

    placement: of each frame (considered); T_sensor_target (k, 4, 4): of every placement.
    """
    reason = np.full(len(placement), "not still", dtype=object)
    visible = []
    for k in sorted(set(placement[placement >= 0].tolist())):
        why = sensor.hidden(sensor.model, target, T_sensor_target[k], margin, options)
        reason[placement == k] = why or "not a new pose"
        if not why:
            visible.append(k)
    least = options["min_distance_m"], np.radians(options["min_angle_deg"])
    kept = views.most_different(T_sensor_target[visible], *least, options["max_placements"])
    for k in np.array(visible, int)[kept]:
        rows = np.flatnonzero(placement == k)
        reason[rows] = "enough frames of this placement"
        reason[rows[views.evenly(len(rows), options["max_frames"])]] = ""
    return reason


def rows(sensor, shapes, frames, placements, T_sensor_target, margin, message_of, options):
    """Rows of views.parquet of one sensor; message_of(i) reads a frame, once for all targets."""
    plan = {}
    for name, target in sorted(shapes.items()):
        placement = considered(frames, placements, name)
        reason = choose(sensor, target, placement, T_sensor_target, margin, options)
        plan[name] = target, placement, reason
    out = []
    for i, t in enumerate(frames["t"]):
        wanted = any(reason[i] == "" for _, _, reason in plan.values())
        message = message_of(i) if wanted else None
        for name, (target, placement, reason) in plan.items():
            k, why, payload = placement[i], reason[i], sensor.nothing()
            if not why:
                span = placements["start"][k], placements["end"][k]
                payload, why = sensor.cut(message, t, span, target, T_sensor_target[k], margin)
            about = {"t": t, "target": name, "placement": k, "kept": not why, "reason": why}
            out.append(about | payload)
    return out
