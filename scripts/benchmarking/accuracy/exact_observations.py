"""Exact keypoints of a simulated session, without scans, images or extraction.

Rooms, rigs and placements are the simulator's. Measurements are thinned so that an estimate takes
a few hundredths of a second.
"""

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from numpy import float64, ndarray

from calib.geometry.se3 import invert_pose, transform_points
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel
from calib.sensors.sensor_models import camera_from_config
from calib.targets.board import Board
from calib.targets.cylinder import Cylinder
from simulation.session_recording import SessionTruth
from simulation.world.ray_casting import PosedScene, cast_rays
from simulation.world.room_scene import find_surface_index, place_surfaces

MIN_RETURNS, MAX_RETURNS = 30, 50  # returns of a scan
N_POINTS_PER_SIDE = 10  # contour points on each side of a cylinder
N_SAMPLES_PER_EDGE = 400  # of an edge, between which its crossing is interpolated
MIN_COS_INCIDENCE = 0.35  # cosine of incidence
KEYPOINT_SIGMA_PX = {"pattern_corner": 0.01, "cylinder_limb": 0.05}


class Observer(Protocol):
    """The exact measurements by one kind of sensor."""

    def __call__(
        self,
        session: SessionTruth,
        *,
        sensor_name: str,
        sensor_block: dict[str, Any],
        target_name: str,
        shape: Cylinder | Board,
        placement_index: int,
    ) -> Iterator[dict[str, ndarray]]:
        """Yield the keypoint columns of a sensor that sees a target in one placement.

        sensor_block: of the rig's config; placement_index: of the session, from 0.
        """


def observe_with_lidar(
    session: SessionTruth,
    *,
    sensor_name: str,
    sensor_block: dict[str, Any],
    target_name: str,
    shape: Cylinder | Board,
    placement_index: int,
) -> Iterator[dict[str, ndarray]]:
    """Yield the returns from the surface of a target, then the crossings of its outline.

    Yields nothing if fewer than MIN_RETURNS beams meet the target.
    """
    spec, model = session.rig.lidar_spec(sensor_name), LidarModel.from_config(sensor_block)
    T_world_lidar = (
        session.placement_poses["robot"][placement_index] @ session.rig.T_robot_sensor[sensor_name]
    )
    T = invert_pose(T_world_lidar) @ session.placement_poses[target_name][placement_index]
    beams = spec.scan_pattern.make_firing(np.deg2rad(spec.sector_deg), 0).beam_directions
    rings, beams = beams.shape[1], beams.reshape(-1, 3)
    rows, distance = select_target_beams(
        session, target_name, T_world_lidar, beams, placement_index
    )
    if len(rows) < MIN_RETURNS:
        return
    p = beams[rows] * distance[rows, None]
    rows = rows[
        shape.distance_along_beam(*_to_target_frame(T, p, beams[rows]))[1] > MIN_COS_INCIDENCE
    ]
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, MAX_RETURNS).astype(int))]
    xyz = beams[rows] * distance[rows, None]
    yield _keypoint_columns("target_surface", rows % rings, model.range_sigma, xyz=xyz)
    rays, ring = exact_outline_crossings(
        shape.outline_edges(), T, np.deg2rad(spec.scan_pattern.elevation_deg)
    )
    yield _keypoint_columns("board_outline", ring, model.azimuth_step / np.sqrt(12), xyz=rays)


def select_target_beams(
    session: SessionTruth, target: str, T_world_lidar: ndarray, beams: ndarray, placement_index: int
) -> tuple[ndarray, ndarray]:
    """Return the indices of the beams that meet a target, and the distances (n,) of all beams, m.

    beams: unit vectors (n, 3), lidar frame. Beams that meet the caps of a cylinder do not count.
    """
    number = find_surface_index(session.scene, target)
    surfaces = place_surfaces({target: session.placement_poses[target][placement_index]})
    distance, label = cast_rays(PosedScene(session.scene, surfaces, T_world_lidar), beams, [number])
    met = np.isfinite(distance)
    if target == "cylinder":
        met &= label == session.scene.first_labels[number]
    return np.flatnonzero(met), distance


def _to_target_frame(
    T_sensor_target: ndarray, points: ndarray, beams: ndarray
) -> tuple[ndarray, ndarray]:
    """Return points and beams (n, 3) of the sensor frame as (3, n) in the target frame."""
    T = invert_pose(T_sensor_target)
    return transform_points(T, points).T, (beams @ T[:3, :3].T).T


def exact_outline_crossings(
    edges: ndarray, T_sensor_target: ndarray, elevation_rad: ndarray
) -> tuple[ndarray, ndarray]:
    """Return the rays (n, 3), lidar frame, at which rings cross edges, and the ring of each (n,).

    edges: (e, 2, 3), target frame, m; elevation_rad: of the rings, (r,).
    """
    share = np.linspace(0, 1, N_SAMPLES_PER_EDGE)[:, None]
    rays, rings = [np.zeros((0, 3))], [np.zeros(0, int)]
    for a, b in edges:
        p = transform_points(T_sensor_target, a + share * (b - a))
        height = np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1]))
        above = height[:, None] > elevation_rad
        at, ring = np.nonzero(above[1:] != above[:-1])
        way = (elevation_rad[ring] - height[at]) / (height[at + 1] - height[at])
        met = p[at] + way[:, None] * (p[at + 1] - p[at])
        rays.append(met / np.linalg.norm(met, axis=1)[:, None])
        rings.append(ring)
    return np.concatenate(rays), np.concatenate(rings)


def observe_with_camera(
    session: SessionTruth,
    *,
    sensor_name: str,
    sensor_block: dict[str, Any],
    target_name: str,
    shape: Cylinder | Board,
    placement_index: int,
) -> Iterator[dict[str, ndarray]]:
    """Yield the corners of a pattern or the contour points of a cylinder.

    Yields nothing if the target is not wholly in the image.
    """
    model = camera_from_config(sensor_block)
    T_world_camera = (
        session.placement_poses["robot"][placement_index] @ session.rig.T_robot_sensor[sensor_name]
    )
    T = invert_pose(T_world_camera) @ session.placement_poses[target_name][placement_index]
    if isinstance(shape, Board) and shape.pattern:
        points = shape.pattern.corners()
        uv = _project_into_image(model, transform_points(T, points))
        if uv is not None and shape.check_facing(invert_pose(T)[:3, 3])[1] > MIN_COS_INCIDENCE:
            index = np.arange(len(points))
            yield _keypoint_columns(
                "pattern_corner",
                index,
                KEYPOINT_SIGMA_PX["pattern_corner"],
                uv=uv,
                whitening=[1.0, 0.0, 1.0],
            )
        return
    if not isinstance(shape, Cylinder):
        return
    points, side = exact_cylinder_limb(shape, T)
    uv = _project_into_image(model, points)
    if uv is not None:
        yield _keypoint_columns("cylinder_limb", side, KEYPOINT_SIGMA_PX["cylinder_limb"], uv=uv)


def _project_into_image(model: CameraModel, points: ndarray) -> ndarray | None:
    uv, valid = model.project(points)
    return uv if valid.all() and model.is_in_image(uv, 10.0).all() else None


def exact_cylinder_limb(shape: Cylinder, T_camera_target: ndarray) -> tuple[ndarray, ndarray]:
    """Return points (n, 3) where rays touch a cylinder, camera frame, m, and their sides (n,).

    The points lie along the two lines of contact; a side is +1 or -1, as seen from the axis.
    """
    eye = invert_pose(T_camera_target)[:3, 3]
    half = np.arccos(shape.radius / np.hypot(eye[1], eye[2]))
    angles = np.arctan2(eye[2], eye[1]) + np.array([-half, half])
    along, angle = np.meshgrid(np.linspace(-0.42, 0.42, N_POINTS_PER_SIDE) * shape.length, angles)
    across = shape.radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    q = np.concatenate([along[..., None], across], -1).reshape(-1, 3)
    points = transform_points(T_camera_target, q)
    axis, centre = T_camera_target[:3, 0], T_camera_target[:3, 3]
    return points, np.sign(np.cross(axis, points) @ centre).astype(int)


def _keypoint_columns(
    kind: str,
    index: ndarray,
    sigma: float | float64,
    *,
    xyz: ndarray | None = None,
    uv: ndarray | None = None,
    whitening: float | list[float] = np.nan,
) -> dict[str, ndarray]:
    """Return the keypoint columns that do not depend on the sensor, target or view."""
    n = len(index)
    return {
        "kind": np.full(n, kind, dtype="U32"),
        "feature_index": np.asarray(index, int),
        "xyz": np.full((n, 3), np.nan) if xyz is None else xyz,
        "uv": np.full((n, 2), np.nan) if uv is None else uv,
        "sigma": np.full(n, sigma),
        "whitening": np.broadcast_to(whitening, (n, 3)),
        "intensity": np.full(n, np.nan),
    }


OBSERVERS: dict[str, Observer] = {"lidar": observe_with_lidar, "camera": observe_with_camera}
