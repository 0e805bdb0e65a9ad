"""Reads the frames of one sensor and cuts the part around a target."""

from calib.io.status import MessageError
from calib.io.table_schemas import CAMERA_VIEWS_SCHEMA, LIDAR_VIEWS_SCHEMA
from calib.sensors.camera.images.image_messages import encode_png, read_bgr
from calib.sensors.lidar.clouds import cloud_messages
from calib.sensors.lidar.clouds.cloud_layout import CloudLayout
from calib.sensors.lidar.lidar_model import LidarModel
from calib.sensors.sensor_models import camera_from_config
from calib.views.field_of_view import check_camera_visibility, check_lidar_visibility
from calib.views.windows import find_image_region, is_in_view_cone


class LidarCropper:
    """What crop does with a lidar's messages."""

    schema = LIDAR_VIEWS_SCHEMA
    check_visibility = staticmethod(check_lidar_visibility)

    def __init__(self, config):
        self.model = LidarModel.from_config(config)
        self.layout = CloudLayout.from_dict(config["layout"])
        self.has_measurement_time = self.layout.point_time is not None

    def empty_payload(self):
        return {"xyz": [], "ring": [], "point_time_ns": []}

    def read_message(self, message):
        """xyz (n, 3), m, ring (n,) and dt (n,), ns (clouds.points)."""
        return cloud_messages.read_points(message, self.layout)

    def cut_window(self, points, t, span, target, T_sensor_target, margin):
        """(payload, reason why there is none) of the angular window around a target."""
        xyz, ring, dt = points
        if not len(xyz):
            return self.empty_payload(), "no return at all"
        # All of the scan, for the window's part of it would depend on the guess.
        first, last = self.layout.time_span_ns(dt)
        if t + first < span[0] or t + last > span[1]:
            return self.empty_payload(), "scan reaches into a move"
        inside = is_in_view_cone(xyz.astype(float), target, T_sensor_target, margin)
        if not inside.any():
            return self.empty_payload(), "no return in the window"
        return {
            "xyz": xyz[inside].reshape(-1),
            "ring": ring[inside],
            "point_time_ns": dt[inside],
        }, ""


class CameraCropper:
    """What crop does with a camera's messages."""

    schema = CAMERA_VIEWS_SCHEMA
    has_measurement_time = True
    check_visibility = staticmethod(check_camera_visibility)

    def __init__(self, config):
        self.model = camera_from_config(config)

    def empty_payload(self):
        return {"u0": 0, "v0": 0, "png": b""}

    def read_message(self, message):
        """The image (h, w, 3) uint8 (images.bgr)."""
        return read_bgr(message)

    def cut_window(self, image, t, span, target, T_sensor_target, margin):
        """(payload, reason why there is none) of the image region around a target."""
        if image.shape[1::-1] != self.model.size_px:
            size = f"{image.shape[1]} x {image.shape[0]}"
            return self.empty_payload(), f"image of {size} px, size_px says otherwise"
        u0, u1, v0, v1 = find_image_region(self.model, target, T_sensor_target, margin)
        return {"u0": u0, "v0": v0, "png": encode_png(image[v0:v1, u0:u1])}, ""


CROPPERS = {"lidar": LidarCropper, "camera": CameraCropper}


def make_frame_reader(log, config, frames):
    """content_of(i): what a sensor measured in its frame i (columns of frames.parquet): points or
    an image. It raises MessageError where that message cannot be read.

    config: the sensor's block, completed by what the log tells (rig.heard).
    """
    sensor = CROPPERS[config["kind"]](config)

    def content_of(i):
        place = (int(frames[k][i]) for k in ("file_index", "log_time_ns", "index_at_log_time"))
        return sensor.read_message(log.read_message_content(config["topic"], *place))

    return content_of


def read_and_cut_frame(sensor, read_frame, i, *cut_arguments):
    """(payload, reason why there is none) of frame i around a target (cut of a sensor)."""
    try:
        return sensor.cut_window(read_frame(i), *cut_arguments)
    except MessageError as error:
        return sensor.empty_payload(), f"cannot be read: {error}"
