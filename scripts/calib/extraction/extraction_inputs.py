"""Inputs of the extraction for one sensor in one session, and keypoint columns of one view."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calib.estimation.estimation_problem import Placement
from calib.estimation.measurement_groups import make_still_placements
from calib.geometry.se3 import invert_pose
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.target_shapes import TargetShape, target_from_config
from calib.views.target_placements import Columns, mounts_from_guess


@dataclass(frozen=True)
class ExtractionContext:
    """One sensor in one session.

    targets: by name. placements: by number. T_robot_sensor: initial guess (4, 4). guess_sigma: its
    σ (6,), m and rad. pose_margin: (6,) by which it may be wrong. The options are the blocks
    `extract`, `associate` and `crop` of the config.
    """

    name: str
    model: Any
    targets: dict[str, TargetShape]
    placements: dict[int, Placement]
    T_robot_sensor: np.ndarray
    guess_sigma: np.ndarray
    pose_margin: np.ndarray
    extract_options: dict[str, Any]
    associate_options: dict[str, Any]
    crop_options: dict[str, Any] = field(default_factory=dict)

    def predict_target_pose(
        self, placement: int, T_robot_sensor: np.ndarray | None = None
    ) -> np.ndarray:
        """Return T_sensor_target (4, 4) in a placement, at the initial guess or another pose."""
        T = self.T_robot_sensor if T_robot_sensor is None else T_robot_sensor
        place = self.placements[placement]
        return invert_pose(T) @ place.T_robot_body @ place.T_body_target


def make_extraction_context(
    options: Mapping[str, Any],
    model: CameraModel | LidarModel,
    placement_columns: Columns,
    guess_json: Mapping[str, Any],
) -> ExtractionContext:
    """Make the context from the options of extract, placements.parquet and guess.json."""
    sigma = np.array(guess_json["sigma"])
    placements = make_still_placements(
        placement_columns,
        session="",
        targets=options["targets"],
        mocap_noise=options["mocap"],
        mounts=mounts_from_guess(options["targets"], guess_json),
    )
    return ExtractionContext(
        name=options["name"],
        model=model,
        targets={name: target_from_config(block) for name, block in options["targets"].items()},
        placements=placements,
        T_robot_sensor=np.array(guess_json["T_robot_sensor"]["matrix"]),
        guess_sigma=sigma,
        pose_margin=options["crop"]["margin_sigma"] * sigma,
        extract_options=options["extract"],
        associate_options=options["associate"],
        crop_options=options["crop"],
    )


def kept_rows(views: Columns) -> list[int]:
    """Return the rows of the kept views."""
    return np.flatnonzero(views["kept"]).tolist()


def make_keypoint_columns(
    views: Columns,
    i: int,
    kind: str,
    index: Sequence[int] | np.ndarray,
    *,
    xyz: np.ndarray | None = None,
    uv: np.ndarray | None = None,
    sigma: float | np.ndarray = 0.0,
    whitening: float | np.ndarray = np.nan,
    point_time_ns: int | np.ndarray = 0,
    intensity: float | np.ndarray = np.nan,
) -> Columns:
    """Return the columns of n keypoints of the view in row i; what is not measured is NaN.

    index: (n,) feature. xyz: (n, 3), m. uv: (n, 2), px. sigma: (n,) px, m or rad. whitening:
    (n, 3). point_time_ns: (n,) after the stamp of the view. intensity: (n,).
    """
    n = len(index)
    nan = np.full((n, 3), np.nan)
    return {
        "view": np.full(n, views["view"][i]),
        "stamp_ns": views["stamp_ns"][i] + np.broadcast_to(point_time_ns, n),
        "target": np.full(n, views["target"][i]),
        "placement": np.full(n, views["placement"][i]),
        "kind": np.full(n, kind),
        "feature_index": np.asarray(index, int),
        "xyz": nan if xyz is None else xyz,
        "uv": nan[:, :2] if uv is None else uv,
        "sigma": np.broadcast_to(sigma, n),
        "whitening": np.broadcast_to(whitening, (n, 3)),
        "intensity": np.broadcast_to(np.asarray(intensity, float), n),
    }
