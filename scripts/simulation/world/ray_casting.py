"""Casts rays into the scene."""

import numpy as np

from calib.geometry.se3 import inverse
from simulation.world.ray_surfaces import KINDS


def cast(scene, T_world_surfaces, T_world_sensor, d, only=None):
    """Distance t (..., n) along rays d (..., n, 3) to the nearest surface, and its label.

    T_world_surfaces by name and T_world_sensor are (4, 4) or (..., 4, 4), for rays that leave at
    different times. t counts lengths of d. `only` limits the scene to some of its surfaces.
    """
    t = np.full(d[..., 0].size, np.inf)
    label = np.zeros(len(t), np.int32)
    for i in range(len(scene.surfaces)) if only is None else only:
        surface = scene.surfaces[i]
        o, rays = _local(inverse(T_world_surfaces[surface.name]) @ T_world_sensor, d)
        where = _candidates(surface.radius, o, rays) if only is None else slice(None)
        near, face = KINDS[surface.kind](surface.size, o[..., where], rays[:, where])
        closer = (near > 0) & (near < t[where])
        if only is None:
            where = where[closer]
            t[where], label[where] = near[closer], scene.first[i] + face[closer]
        else:
            np.copyto(t, near, where=closer)
            np.copyto(label, scene.first[i] + face, where=closer)
    return t.reshape(d.shape[:-1]), label.reshape(d.shape[:-1])


def _local(T_surface_sensor, d):
    """Origins (3, 1 or n) and directions (3, n) of rays in the surface's frame."""
    R, o = T_surface_sensor[..., :3, :3], T_surface_sensor[..., :3, 3]
    if R.ndim == 2:
        return np.broadcast_to(o[:, None], (3, d[..., 0].size)), R @ d.reshape(-1, 3).T
    rays = np.moveaxis(d @ np.swapaxes(R, -1, -2), -1, 0).reshape(3, -1)
    return np.repeat(np.moveaxis(o, -1, 0).reshape(3, -1), d.shape[-2], axis=1), rays


def _candidates(radius, o, d):
    """Indices of the rays that meet the sphere about the surface."""
    if not np.isfinite(radius):
        return np.arange(d.shape[1])
    along = _dot(o, d)
    return np.flatnonzero((along < 0) & (along * along > (_dot(o, o) - radius**2) * _dot(d, d)))


def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
