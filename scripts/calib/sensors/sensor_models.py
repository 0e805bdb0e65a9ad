"""Cameras and lidars from the sensor blocks of a rig's config."""

from collections.abc import Callable
from typing import Any

from calib.io.status import InputError
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel

SensorModel = CameraModel | LidarModel


def camera_from_config(config: dict[str, Any]) -> CameraModel:
    """Make the camera of a sensor block; raises InputError for a wrong number of params."""
    try:
        return CameraModel(config["model"], tuple(config["params"]), tuple(config["size_px"]))
    except ValueError as error:
        raise InputError(str(error)) from None


def with_log_metadata(config: dict[str, Any], log_metadata: dict[str, Any]) -> dict[str, Any]:
    """Return a sensor block completed from its log: the lens and the layout of clouds.

    log_metadata: the sensor's part of the audit, or its guess.json for the lens alone.
    """
    layout = {"layout": log_metadata["layout"]} if "layout" in log_metadata else {}
    return config | (log_metadata.get("camera") or {}) | layout


MODEL_BUILDERS: dict[str, Callable[[dict[str, Any]], SensorModel]] = {
    "camera": camera_from_config,
    "lidar": LidarModel.from_config,
}


def sensor_model_from_config(config: dict[str, Any]) -> SensorModel:
    """Make the camera or lidar of a sensor block."""
    return MODEL_BUILDERS[config["kind"]](config)
