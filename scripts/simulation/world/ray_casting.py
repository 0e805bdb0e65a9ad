"""Cast rays into the scene."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.geometry.se3 import invert_pose
from simulation.world.ray_surfaces import SHAPE_INTERSECTIONS
from simulation.world.room_scene import SimulatedScene


@dataclass(frozen=True)
class PosedScene:
    """A scene with the poses of its surfaces, by name, and of the sensor in it.

    Poses are (4, 4), or (columns, 4, 4) for rays that leave at different times.
    """

    scene: SimulatedScene
    T_world_surfaces: dict[str, np.ndarray]
    T_world_sensor: np.ndarray


def cast_rays(
    posed: PosedScene, directions: np.ndarray, surface_indices: Sequence[int] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance (..., n) to the nearest surface and its label along rays (..., n, 3).

    Distances count lengths of the directions, infinite for a miss. surface_indices limits the
    scene to some of its surfaces.
    """
    scene = posed.scene
    t = np.full(directions[..., 0].size, np.inf)
    label = np.zeros(len(t), np.int32)
    for i in range(len(scene.surfaces)) if surface_indices is None else surface_indices:
        surface = scene.surfaces[i]
        origins, rays = _rays_in_surface(
            invert_pose(posed.T_world_surfaces[surface.name]) @ posed.T_world_sensor, directions
        )
        intersect = SHAPE_INTERSECTIONS[surface.shape]
        if surface_indices is None:
            near = _rays_near_surface(surface.bounding_radius_m, origins, rays)
            t_hit, face = intersect(surface.shape_params, origins[..., near], rays[:, near])
            is_closer = (t_hit > 0) & (t_hit < t[near])
            near = near[is_closer]
            t[near], label[near] = t_hit[is_closer], scene.first_labels[i] + face[is_closer]
        else:
            t_hit, face = intersect(surface.shape_params, origins, rays)
            is_closer = (t_hit > 0) & (t_hit < t)
            np.copyto(t, t_hit, where=is_closer)
            np.copyto(label, scene.first_labels[i] + face, where=is_closer)
    return t.reshape(directions.shape[:-1]), label.reshape(directions.shape[:-1])


def _rays_in_surface(
    T_surface_sensor: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return origins (3, n) and directions (3, n) of rays in the surface's frame."""
    R, o = T_surface_sensor[..., :3, :3], T_surface_sensor[..., :3, 3]
    if R.ndim == 2:
        origins = np.broadcast_to(o[:, None], (3, directions[..., 0].size))
        return origins, R @ directions.reshape(-1, 3).T
    rays = np.moveaxis(directions @ np.swapaxes(R, -1, -2), -1, 0).reshape(3, -1)
    return np.repeat(np.moveaxis(o, -1, 0).reshape(3, -1), directions.shape[-2], axis=1), rays


def _rays_near_surface(radius: float, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return the indices of the rays that meet the sphere around a surface."""
    if not np.isfinite(radius):
        return np.arange(directions.shape[1])
    along = _dot(origins, directions)
    return np.flatnonzero(
        (along < 0)
        & (along * along > (_dot(origins, origins) - radius**2) * _dot(directions, directions))
    )


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
