"""A rig as it is built: mounts drawn about the nominal ones, and guesses of them."""

from typing import NamedTuple

import numpy as np

from calib.geometry.se3 import make_pose, pose_from_rpy, so3_exp
from calib.sensors.camera.camera_model import CameraModel
from simulation.simulated_rigs import SimulatedCamera

MAX_SENSOR_DEVIATION_M, MAX_SENSOR_DEVIATION_DEG = (
    0.02,
    3.0,
)  # largest deviation per axis of a true mount from the nominal one


class BuiltRig(NamedTuple):
    """By sensor: its description (rigs.Lidar or rigs.Camera) and T_robot_sensor (4, 4); by camera:
    the model; by lidar: the bias (beams,) of its beams, m."""

    sensor_specs: dict
    T_robot_sensor: dict
    camera_models: dict
    beam_bias_m: dict

    def lidar_names(self):
        """Names of the lidars, in order."""
        return [name for name in self.sensor_specs if name not in self.camera_models]


def build_rig(rig, rng, rng_bias, beam_bias_m=0.0):
    """The rig with its mounts and the biases of its beams drawn."""
    sensors = {name: _draw_sensor_pose(rng, spec) for name, spec in rig.sensors.items()}
    cameras = {
        name: CameraModel(spec.model, spec.params, spec.size_px)
        for name, spec in rig.sensors.items()
        if isinstance(spec, SimulatedCamera)
    }
    bias = {
        name: beam_bias_m * rng_bias.standard_normal(spec.scan_pattern.n_beams)
        for name, spec in rig.sensors.items()
        if name not in cameras
    }
    return BuiltRig(rig.sensors, sensors, cameras, bias)


def _draw_sensor_pose(rng, spec):
    nominal = pose_from_rpy(spec.xyz_m, np.deg2rad(spec.rpy_deg))
    return perturb_pose(rng, nominal, MAX_SENSOR_DEVIATION_M, MAX_SENSOR_DEVIATION_DEG)


def perturb_pose(rng, T, error_m, error_deg):
    """T_a_b with a shift uniform within ±error_m along each axis of a, and a rotation vector
    uniform within ±error_deg along each axis of b."""
    shift, turn = rng.uniform(-1, 1, (2, 3))
    return make_pose(t=error_m * shift) @ T @ make_pose(so3_exp(np.deg2rad(error_deg) * turn))


def bump_last_sensor(rig, T_bump):
    """The rig with its last sensor moved by a pose (4, 4) along its own axes."""
    name = list(rig.sensors)[-1]
    return rig._replace(sensors=rig.sensors | {name: rig.sensors[name] @ T_bump})


def draw_displacement(rng, length_m, angle_deg):
    """A pose (4, 4) of that length and angle, in random directions."""
    shift, axis = rng.standard_normal((2, 3))
    shift, axis = shift / np.linalg.norm(shift), axis / np.linalg.norm(axis)
    return make_pose(so3_exp(np.deg2rad(angle_deg) * axis), length_m * shift)
