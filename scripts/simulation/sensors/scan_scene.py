"""A lidar in a scene: every beam meets the nearest surface, exactly, at its column's time."""

import numpy as np

from simulation.sensors.cloud_formats import Echoes
from simulation.world import ray_casting, room_scene
from simulation.world.ray_surfaces import SKY

RANGE_M = (0.4, 100.0)
PULSE_M = 1.0  # echoes farther behind the first one than this are apart from it
RIM = np.arange(6) * np.pi / 3
# Twelve points of equal area: their radius, as a share of the footprint's, and angle.
DISC = np.array([(0.41, a) for a in range(0, 360, 90)] + [(0.82, a) for a in range(15, 360, 45)])


def scan(
    scene, T_world_surfaces, T_world_lidar, firing, t=0, rng=None, noise=0.0, bias=0.0, spread=0.0
):
    """Echoes of a firing whose first column leaves at t, ns.

    T_world_surfaces by name and T_world_lidar are (4, 4) or (columns, 4, 4), at the columns' times.
    Along the beam, m: noise, a standard deviation, and bias, one or (beams,). spread is the angle,
    rad, across which a beam's energy leaves: with none, beams are lines.
    """
    poses = (T_world_surfaces, T_world_lidar)
    distance, label = ray_casting.cast(scene, *poses, firing.beams)
    returned = _returned(scene, distance, label)
    if spread:
        distance, returned = _mixed(scene, *poses, firing.beams, distance, label, spread / 2)
    if noise:
        distance = distance + noise * rng.standard_normal(distance.shape)
    distance = np.where(returned, distance + bias, 0.0)
    xyz = firing.beams * distance[..., None]
    return Echoes(xyz, distance, scene.colors[label].mean(-1), returned, firing.after[:, None], t)


def _returned(scene, distance, label):
    sky = scene.first[room_scene.index(scene, "room")] + SKY
    returned = (label != sky) | (distance == np.inf)
    return returned & (distance > RANGE_M[0]) & (distance < RANGE_M[1])


def _mixed(scene, T_world_surfaces, T_world_lidar, beams, distance, label, half):
    """Distance and whether there is a return (columns, beams) where a beam is a cone, half angle
    in rad. Where its rim meets other surfaces than its axis the return is the mean of what the
    cone meets no farther than PULSE_M behind the nearest: a mixed pixel."""
    returned = _returned(scene, distance, label)
    around = np.stack([np.ones(len(RIM)), RIM], -1)
    met = _met(scene, *_footprint(scene, T_world_surfaces, T_world_lidar, beams, half, around))
    edge = np.any(met != np.where(returned, scene.surface[label], -1)[..., None], axis=-1)
    columns = np.nonzero(edge)[0]
    poses = [_at(T, columns) for T in (T_world_surfaces, T_world_lidar)]
    disc = DISC * [1, np.pi / 180]
    far, what = _footprint(scene, *poses, beams[edge][:, None], half, disc)
    far = np.where(_returned(scene, far, what), far, np.inf)[:, 0]
    first = far.min(1, keepdims=True)
    within = np.isfinite(far) & (far < first + PULSE_M)
    distance, returned = distance.copy(), returned.copy()
    count = within.sum(1)
    distance[edge] = np.where(within, far, 0).sum(1) / np.maximum(count, 1)
    returned[edge] = count > 0
    return distance, returned


def _footprint(scene, T_world_surfaces, T_world_lidar, beams, half, disc):
    """Distance and label (columns, beams, n) along rays beside the beams; disc (n, 2): radius as a
    share of the half angle, and angle around the beam, rad."""
    right = np.cross(beams, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    aside = half * disc[:, 0] * np.stack([np.cos(disc[:, 1]), np.sin(disc[:, 1])])
    across = np.stack([right, np.cross(right, beams)], -2)
    rays = beams[..., None, :] + np.einsum("kn,...kc->...nc", aside, across)
    flat = rays.reshape(len(rays), -1, 3)
    found = ray_casting.cast(scene, T_world_surfaces, T_world_lidar, flat)
    return [values.reshape(rays.shape[:-1]) for values in found]


def _met(scene, distance, label):
    """Number of the surface met, -1 without a return."""
    return np.where(_returned(scene, distance, label), scene.surface[label], -1)


def _at(T, columns):
    """Poses at some of the columns; T is (4, 4), (columns, 4, 4) or a dict of such."""
    if isinstance(T, dict):
        return {name: _at(pose, columns) for name, pose in T.items()}
    return T[columns] if T.ndim == 3 else T
