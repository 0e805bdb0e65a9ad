"""What extraction knows of one sensor in one session, and the keypoints of one view."""

from dataclasses import dataclass, field

import numpy as np

from calib.geometry.se3 import invert_pose


@dataclass(frozen=True)
class ExtractionContext:
    """One sensor in one session: model, targets, placements by number, guess and options; those of
    crop say which views count."""

    name: str
    model: object
    targets: dict
    placements: dict
    T_robot_sensor: np.ndarray
    guess_sigma: np.ndarray
    pose_margin: np.ndarray
    extract_options: dict
    associate_options: dict
    crop_options: dict = field(default_factory=dict)

    def predict_target_pose(self, placement, T_robot_sensor=None):
        """T_sensor_target (4, 4) in a placement, from the guess or another pose of the sensor."""
        T = self.T_robot_sensor if T_robot_sensor is None else T_robot_sensor
        place = self.placements[placement]
        return invert_pose(T) @ place.T_robot_body @ place.T_body_target


def make_keypoint_columns(
    views, i, kind, index, xyz=None, uv=None, sigma=0.0, whitening=np.nan, dt=0
):
    """Keypoint columns of one view: what is not measured is NaN."""
    n = len(index)
    nan = np.full((n, 3), np.nan)
    return {
        "view": np.full(n, views["view"][i]),
        "stamp_ns": views["stamp_ns"][i] + np.broadcast_to(dt, n),
        "target": np.full(n, views["target"][i]),
        "placement": np.full(n, views["placement"][i]),
        "kind": np.full(n, kind),
        "feature_index": np.asarray(index, int),
        "xyz": nan if xyz is None else xyz,
        "uv": nan[:, :2] if uv is None else uv,
        "sigma": np.broadcast_to(sigma, n),
        "whitening": np.broadcast_to(whitening, (n, 3)),
    }
