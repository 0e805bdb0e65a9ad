"""A rig as it is built: mounts drawn about the nominal ones, and guesses of them."""

from typing import NamedTuple

import numpy as np

from calib.geometry.se3 import from_rpy, pose, so3_exp
from calib.sensors.camera.camera_model import Camera
from simulation import simulated_rigs

MOUNT_M, MOUNT_DEG = 0.02, 3.0  # largest deviation per axis of a true mount from the nominal one


class Built(NamedTuple):
    """By sensor: its description (rigs.Lidar or rigs.Camera) and T_robot_sensor (4, 4); by camera:
    the model; by lidar: the bias (beams,) of its beams, m."""

    specs: dict
    sensors: dict
    cameras: dict
    beam_bias: dict

    def lidars(self):
        """Names of the lidars, in order."""
        return [name for name in self.specs if name not in self.cameras]


def build(rig, rng, rng_bias, beam_bias_m=0.0):
    """The rig with its mounts and the biases of its beams drawn."""
    sensors = {name: _mounted(rng, spec) for name, spec in rig.sensors.items()}
    cameras = {
        name: Camera(spec.model, spec.params, spec.size_px)
        for name, spec in rig.sensors.items()
        if isinstance(spec, simulated_rigs.Camera)
    }
    bias = {
        name: beam_bias_m * rng_bias.standard_normal(spec.scans.beams)
        for name, spec in rig.sensors.items()
        if name not in cameras
    }
    return Built(rig.sensors, sensors, cameras, bias)


def _mounted(rng, spec):
    nominal = from_rpy(spec.xyz_m, np.deg2rad(spec.rpy_deg))
    return perturb(rng, nominal, MOUNT_M, MOUNT_DEG)


def perturb(rng, T, error_m, error_deg):
    """T_a_b with a shift uniform within ±error_m along each axis of a, and a rotation vector
    uniform within ±error_deg along each axis of b."""
    shift, turn = rng.uniform(-1, 1, (2, 3))
    return pose(t=error_m * shift) @ T @ pose(so3_exp(np.deg2rad(error_deg) * turn))


def bumped(built, knock):
    """The rig with its last sensor moved by a pose (4, 4) along its own axes."""
    name = list(built.sensors)[-1]
    return built._replace(sensors=built.sensors | {name: built.sensors[name] @ knock})


def displacement(rng, length_m, angle_deg):
    """A pose (4, 4) of that length and angle, in random directions."""
    shift, axis = rng.standard_normal((2, 3))
    shift, axis = shift / np.linalg.norm(shift), axis / np.linalg.norm(axis)
    return pose(so3_exp(np.deg2rad(angle_deg) * axis), length_m * shift)
