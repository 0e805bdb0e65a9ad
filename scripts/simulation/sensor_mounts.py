"""Build a rig: mounts drawn around the nominal ones, and first guesses of them."""

from typing import NamedTuple

import numpy as np

from calib.geometry.se3 import make_pose, pose_from_rpy, so3_exp
from calib.sensors.camera.camera_model import CameraModel
from simulation.simulated_rigs import SimulatedCamera, SimulatedLidar, SimulatedRig

# Largest deviation per axis of a true mount from the nominal one.
MAX_SENSOR_DEVIATION_M, MAX_SENSOR_DEVIATION_DEG = 0.02, 3.0


class BuiltRig(NamedTuple):
    """A rig with its true mounts.

    By sensor: its description and T_robot_sensor (4, 4). By camera: the model. By lidar: the bias
    (beams,) of its beams, m.
    """

    sensor_specs: dict[str, SimulatedLidar | SimulatedCamera]
    T_robot_sensor: dict[str, np.ndarray]
    camera_models: dict[str, CameraModel]
    beam_bias_m: dict[str, np.ndarray]

    def lidar_names(self) -> list[str]:
        """Return the names of the lidars, in order."""
        return [name for name in self.sensor_specs if name not in self.camera_models]

    def lidar_spec(self, name: str) -> SimulatedLidar:
        """Return the description of a lidar."""
        spec = self.sensor_specs[name]
        assert isinstance(spec, SimulatedLidar), f"{name} is no lidar"
        return spec

    def camera_spec(self, name: str) -> SimulatedCamera:
        """Return the description of a camera."""
        spec = self.sensor_specs[name]
        assert isinstance(spec, SimulatedCamera), f"{name} is no camera"
        return spec


def build_rig(
    rig: SimulatedRig,
    rng: np.random.Generator,
    rng_bias: np.random.Generator,
    beam_bias_m: float = 0.0,
) -> BuiltRig:
    """Draw the mounts of a rig and the biases of its beams, of standard deviation beam_bias_m."""
    poses = {name: _draw_sensor_pose(rng, spec) for name, spec in rig.sensors.items()}
    cameras = {
        name: CameraModel(spec.model, spec.params, spec.size_px)
        for name, spec in rig.sensors.items()
        if isinstance(spec, SimulatedCamera)
    }
    bias = {
        name: beam_bias_m * rng_bias.standard_normal(spec.scan_pattern.n_beams)
        for name, spec in rig.sensors.items()
        if isinstance(spec, SimulatedLidar)
    }
    return BuiltRig(rig.sensors, poses, cameras, bias)


def _draw_sensor_pose(
    rng: np.random.Generator, spec: SimulatedLidar | SimulatedCamera
) -> np.ndarray:
    nominal = pose_from_rpy(spec.xyz_m, np.deg2rad(spec.rpy_deg))
    return perturb_pose(rng, nominal, MAX_SENSOR_DEVIATION_M, MAX_SENSOR_DEVIATION_DEG)


def perturb_pose(
    rng: np.random.Generator, T: np.ndarray, error_m: float, error_deg: float
) -> np.ndarray:
    """Draw a pose near T_a_b (4, 4).

    The shift is uniform within ±error_m along each axis of a, the rotation vector within
    ±error_deg along each axis of b.
    """
    shift, turn = rng.uniform(-1, 1, (2, 3))
    return make_pose(t=error_m * shift) @ T @ make_pose(so3_exp(np.deg2rad(error_deg) * turn))


def bump_last_sensor(rig: BuiltRig, T_bump: np.ndarray) -> BuiltRig:
    """Return the rig with its last sensor moved by a pose (4, 4) along its own axes."""
    name = list(rig.T_robot_sensor)[-1]
    bumped = {name: rig.T_robot_sensor[name] @ T_bump}
    return rig._replace(T_robot_sensor=rig.T_robot_sensor | bumped)


def draw_displacement(rng: np.random.Generator, length_m: float, angle_deg: float) -> np.ndarray:
    """Draw a pose (4, 4) with that length and angle, in random directions."""
    shift, axis = rng.standard_normal((2, 3))
    shift, axis = shift / np.linalg.norm(shift), axis / np.linalg.norm(axis)
    return make_pose(so3_exp(np.deg2rad(angle_deg) * axis), length_m * shift)
