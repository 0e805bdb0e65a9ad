"""What extraction knows of one sensor in one session, and the pose that its views agree on."""

from dataclasses import dataclass

import numpy as np

from calib import estimation, geometry, placements, tables

LOOSE = {"gate_sigma": 6.0, "edge_margin_m": -1.0, "min_cosine": -1.0}
WORKING_ROUNDS, WORKING_POINTS = 6, 5000


@dataclass(frozen=True)
class Job:
    """One sensor in one session: model, targets, placements by number, guess and options."""

    name: str
    model: object
    targets: dict
    places: dict
    T_robot_sensor: np.ndarray
    sigma: np.ndarray
    margin: np.ndarray
    options: dict
    associate: dict

    def expected(self, placement, T_robot_sensor=None):
        """T_sensor_target (4, 4) in a placement, from the guess or another pose of the sensor."""
        T = self.T_robot_sensor if T_robot_sensor is None else T_robot_sensor
        place = self.places[placement]
        return geometry.inverse(T) @ place.T_robot_body @ place.T_body_target


def columns_of(views, i, kind, index, xyz=None, uv=None, sigma=0.0, dt=0):
    """Keypoint columns of one view: what is not measured is NaN."""
    n = len(index)
    nan = np.full((n, 3), np.nan)
    return {
        "view": np.full(n, views["view"][i]),
        "t": views["t"][i] + np.broadcast_to(dt, n),
        "target": np.full(n, views["target"][i]),
        "placement": np.full(n, views["placement"][i]),
        "kind": np.full(n, kind),
        "index": np.asarray(index, int),
        "xyz": nan if xyz is None else xyz,
        "uv": nan[:, :2] if uv is None else uv,
        "sigma": np.broadcast_to(sigma, n),
    }


def working_pose(job, keypoints, T_robot_sensor, associate, noise):
    """T_robot_sensor (4, 4) that the keypoints agree on, held by the guess where they say nothing.

    noise: the factor on the keypoints' σ to start from, large where the start may be far off.
    Evenly thinned to WORKING_POINTS: it only says where to look.
    """
    n = len(keypoints["view"])
    keypoints = tables.select(keypoints, np.arange(0, n, -(-n // WORKING_POINTS)))
    used = sorted(set(keypoints["placement"].tolist()))
    index = {number: i for i, number in enumerate(used)}
    setup = estimation.Setup(
        models={job.name: job.model},
        targets=job.targets,
        placements=[job.places[number] for number in used],
        groups=placements.groups(keypoints, job.name, index),
        associate=associate,
        prior={job.name: (job.T_robot_sensor, job.sigma)},
    )
    start = {job.name: T_robot_sensor}
    result = estimation.estimate(setup, start, WORKING_ROUNDS, 1e-4, 1e-4, noise)
    return result.state.T_robot_sensor[job.name]
