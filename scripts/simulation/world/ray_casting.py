"""Casts rays into the scene."""

import numpy as np

from calib.geometry.se3 import invert_pose
from simulation.world.ray_surfaces import SHAPE_INTERSECTIONS


def cast_rays(scene, T_world_surfaces, T_world_sensor, directions, surface_indices=None):
    """Distance t (..., n) along rays directions (..., n, 3) to the nearest surface, and its label.

    T_world_surfaces by name and T_world_sensor are (4, 4) or (..., 4, 4), for rays that leave at
    different times. t counts lengths of d. `only` limits the scene to some of its surfaces.
    """
    t = np.full(directions[..., 0].size, np.inf)
    label = np.zeros(len(t), np.int32)
    for i in range(len(scene.surfaces)) if surface_indices is None else surface_indices:
        surface = scene.surfaces[i]
        o, rays = _rays_in_surface(
            invert_pose(T_world_surfaces[surface.name]) @ T_world_sensor, directions
        )
        where = (
            _rays_near_surface(surface.bounding_radius_m, o, rays)
            if surface_indices is None
            else slice(None)
        )
        near, face = SHAPE_INTERSECTIONS[surface.shape](
            surface.shape_params, o[..., where], rays[:, where]
        )
        closer = (near > 0) & (near < t[where])
        if surface_indices is None:
            where = where[closer]
            t[where], label[where] = near[closer], scene.first_labels[i] + face[closer]
        else:
            np.copyto(t, near, where=closer)
            np.copyto(label, scene.first_labels[i] + face, where=closer)
    return t.reshape(directions.shape[:-1]), label.reshape(directions.shape[:-1])


def _rays_in_surface(T_surface_sensor, directions):
    """Origins (3, 1 or n) and directions (3, n) of rays in the surface's frame."""
    R, o = T_surface_sensor[..., :3, :3], T_surface_sensor[..., :3, 3]
    if R.ndim == 2:
        return np.broadcast_to(o[:, None], (3, directions[..., 0].size)), R @ directions.reshape(
            -1, 3
        ).T
    rays = np.moveaxis(directions @ np.swapaxes(R, -1, -2), -1, 0).reshape(3, -1)
    return np.repeat(np.moveaxis(o, -1, 0).reshape(3, -1), directions.shape[-2], axis=1), rays


def _rays_near_surface(radius, origins, directions):
    """Indices of the rays that meet the sphere about the surface."""
    if not np.isfinite(radius):
        return np.arange(directions.shape[1])
    along = _dot(origins, directions)
    return np.flatnonzero(
        (along < 0)
        & (along * along > (_dot(origins, origins) - radius**2) * _dot(directions, directions))
    )


def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
