"""What extraction knows of one sensor in one session, and the keypoints of one view."""

from dataclasses import dataclass, field

import numpy as np

from calib.geometry import se3


@dataclass(frozen=True)
class Job:
    """One sensor in one session: model, targets, placements by number, guess and options; those of
    crop say which views count."""

    name: str
    model: object
    targets: dict
    places: dict
    T_robot_sensor: np.ndarray
    sigma: np.ndarray
    margin: np.ndarray
    options: dict
    associate: dict
    crop: dict = field(default_factory=dict)

    def expected(self, placement, T_robot_sensor=None):
        """T_sensor_target (4, 4) in a placement, from the guess or another pose of the sensor."""
        T = self.T_robot_sensor if T_robot_sensor is None else T_robot_sensor
        place = self.places[placement]
        return se3.inverse(T) @ place.T_robot_body @ place.T_body_target


def columns_of(views, i, kind, index, xyz=None, uv=None, sigma=0.0, whiten=np.nan, dt=0):
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
        "whiten": np.broadcast_to(whiten, (n, 3)),
    }
