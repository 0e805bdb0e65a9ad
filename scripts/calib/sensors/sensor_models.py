"""Cameras and lidars from the sensor blocks of a rig's config."""

from calib.io.status import InputError
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel


def camera_from_config(config):
    """The Camera of a sensor block; raises InputError for a wrong number of params."""
    try:
        return CameraModel(config["model"], tuple(config["params"]), tuple(config["size_px"]))
    except ValueError as error:
        raise InputError(str(error)) from None


def with_log_metadata(config, log_metadata):
    """A sensor block completed by what its log tells: lens (`camera`) and `layout` of clouds of
    found, which is its part of the audit or, for the lens alone, its guess.json."""
    layout = {"layout": log_metadata["layout"]} if "layout" in log_metadata else {}
    return config | (log_metadata.get("camera") or {}) | layout


MODEL_BUILDERS = {"camera": camera_from_config, "lidar": LidarModel.from_config}


def sensor_model_from_config(config):
    """The Camera or Lidar of a sensor block."""
    return MODEL_BUILDERS[config["kind"]](config)
