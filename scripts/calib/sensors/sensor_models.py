"""Cameras and lidars from the sensor blocks of a rig's config."""

from calib.io.status import InputError
from calib.sensors.camera.camera_model import Camera
from calib.sensors.lidar.lidar_model import Lidar


def camera(config):
    """The Camera of a sensor block; raises InputError for a wrong number of params."""
    try:
        return Camera(config["model"], tuple(config["params"]), tuple(config["size_px"]))
    except ValueError as error:
        raise InputError(str(error)) from None


def heard(config, found):
    """A sensor block completed by what its log tells: lens (`camera`) and `layout` of clouds of
    found, which is its part of the audit or, for the lens alone, its guess.json."""
    layout = {"layout": found["layout"]} if "layout" in found else {}
    return config | (found.get("camera") or {}) | layout


SENSORS = {"camera": camera, "lidar": Lidar.from_config}


def model(config):
    """The Camera or Lidar of a sensor block."""
    return SENSORS[config["kind"]](config)
