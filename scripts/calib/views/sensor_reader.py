"""Reads the frames of one sensor and cuts the part around a target."""

from calib.io import table_schemas
from calib.io.status import MessageError
from calib.sensors import sensor_models
from calib.sensors.camera.images import image_messages
from calib.sensors.lidar import lidar_model
from calib.sensors.lidar.clouds import cloud_layout, cloud_messages
from calib.views import field_of_view, windows


class Lidar:
    """What crop does with a lidar's messages."""

    schema = table_schemas.VIEWS_LIDAR
    hidden = staticmethod(field_of_view.hidden_from_lidar)

    def __init__(self, config):
        self.model = lidar_model.Lidar.from_config(config)
        self.layout = cloud_layout.Layout.from_dict(config["layout"])
        self.timed = self.layout.time is not None

    def nothing(self):
        return {"xyz": [], "ring": [], "dt": []}

    def read(self, message):
        """xyz (n, 3), m, ring (n,) and dt (n,), ns (clouds.points)."""
        return cloud_messages.points(message, self.layout)

    def cut(self, points, t, span, target, T_sensor_target, margin):
        """(payload, reason why there is none) of the angular window around a target."""
        xyz, ring, dt = points
        if not len(xyz):
            return self.nothing(), "no return at all"
        # All of the scan, for the window's part of it would depend on the guess.
        first, last = self.layout.reach(dt)
        if t + first < span[0] or t + last > span[1]:
            return self.nothing(), "scan reaches into a move"
        inside = windows.cone(xyz.astype(float), target, T_sensor_target, margin)
        if not inside.any():
            return self.nothing(), "no return in the window"
        return {"xyz": xyz[inside].reshape(-1), "ring": ring[inside], "dt": dt[inside]}, ""


class Camera:
    """What crop does with a camera's messages."""

    schema = table_schemas.VIEWS_CAMERA
    timed = True
    hidden = staticmethod(field_of_view.hidden_from_camera)

    def __init__(self, config):
        self.model = sensor_models.camera(config)

    def nothing(self):
        return {"u0": 0, "v0": 0, "png": b""}

    def read(self, message):
        """The image (h, w, 3) uint8 (images.bgr)."""
        return image_messages.bgr(message)

    def cut(self, image, t, span, target, T_sensor_target, margin):
        """(payload, reason why there is none) of the image region around a target."""
        if image.shape[1::-1] != self.model.size:
            size = f"{image.shape[1]} x {image.shape[0]}"
            return self.nothing(), f"image of {size} px, size_px says otherwise"
        u0, u1, v0, v1 = windows.region(self.model, target, T_sensor_target, margin)
        return {"u0": u0, "v0": v0, "png": image_messages.to_png(image[v0:v1, u0:u1])}, ""


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
