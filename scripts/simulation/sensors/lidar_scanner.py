"""A lidar in a scene: every beam meets the nearest surface, exactly, at its column's time."""

import numpy as np

from simulation.sensors.cloud_formats import Echoes
from simulation.world.ray_casting import cast_rays
from simulation.world.ray_surfaces import SKY_FACE
from simulation.world.room_scene import find_surface_index

RANGE_LIMITS_M = (0.4, 100.0)
PULSE_LENGTH_M = 1.0  # echoes farther behind the first one than this are apart from it
RIM_ANGLES_RAD = np.arange(6) * np.pi / 3
# Twelve points of equal area: their radius, as a share of the footprint's, and angle.
FOOTPRINT_POINTS = np.array(
    [(0.41, a) for a in range(0, 360, 90)] + [(0.82, a) for a in range(15, 360, 45)]
)


def scan_scene(
    scene,
    T_world_surfaces,
    T_world_lidar,
    firing,
    stamp_ns=0,
    rng=None,
    range_sigma_m=0.0,
    range_bias_m=0.0,
    beam_divergence_rad=0.0,
):
    """Echoes of a firing whose first column leaves at t, ns.

    T_world_surfaces by name and T_world_lidar are (4, 4) or (columns, 4, 4), at the columns' times.
    Along the beam, m: noise, a standard deviation, and bias, one or (beams,). spread is the angle,
    rad, across which a beam's energy leaves: with none, beams are lines.
    """
    poses = (T_world_surfaces, T_world_lidar)
    distance, label = cast_rays(scene, *poses, firing.beam_directions)
    returned = _has_return(scene, distance, label)
    if beam_divergence_rad:
        distance, returned = _apply_beam_divergence(
            scene, *poses, firing.beam_directions, distance, label, beam_divergence_rad / 2
        )
    if range_sigma_m:
        distance = distance + range_sigma_m * rng.standard_normal(distance.shape)
    distance = np.where(returned, distance + range_bias_m, 0.0)
    xyz = firing.beam_directions * distance[..., None]
    return Echoes(
        xyz,
        distance,
        scene.label_colors[label].mean(-1),
        returned,
        firing.column_time_ns[:, None],
        stamp_ns,
    )


def _has_return(scene, distance, label):
    sky = scene.first_labels[find_surface_index(scene, "room")] + SKY_FACE
    returned = (label != sky) | (distance == np.inf)
    return returned & (distance > RANGE_LIMITS_M[0]) & (distance < RANGE_LIMITS_M[1])


def _apply_beam_divergence(
    scene, T_world_surfaces, T_world_lidar, beams, distance, label, half_angle_rad
):
    """Distance and whether there is a return (columns, beams) where a beam is a cone, half angle
    in rad. Where its rim meets other surfaces than its axis the return is the mean of what the
    cone meets no farther than PULSE_M behind the nearest: a mixed pixel."""
    returned = _has_return(scene, distance, label)
    around = np.stack([np.ones(len(RIM_ANGLES_RAD)), RIM_ANGLES_RAD], -1)
    met = _hit_surface(
        scene,
        *_cast_footprint(scene, T_world_surfaces, T_world_lidar, beams, half_angle_rad, around),
    )
    edge = np.any(met != np.where(returned, scene.label_surfaces[label], -1)[..., None], axis=-1)
    columns = np.nonzero(edge)[0]
    poses = [_select_columns(T, columns) for T in (T_world_surfaces, T_world_lidar)]
    disc = FOOTPRINT_POINTS * [1, np.pi / 180]
    far, what = _cast_footprint(scene, *poses, beams[edge][:, None], half_angle_rad, disc)
    far = np.where(_has_return(scene, far, what), far, np.inf)[:, 0]
    first = far.min(1, keepdims=True)
    within = np.isfinite(far) & (far < first + PULSE_LENGTH_M)
    distance, returned = distance.copy(), returned.copy()
    count = within.sum(1)
    distance[edge] = np.where(within, far, 0).sum(1) / np.maximum(count, 1)
    returned[edge] = count > 0
    return distance, returned


def _cast_footprint(
    scene, T_world_surfaces, T_world_lidar, beams, half_angle_rad, footprint_points
):
    """Distance and label (columns, beams, n) along rays beside the beams; footprint_points (n, 2): radius as a
    share of the half angle, and angle around the beam, rad."""
    right = np.cross(beams, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    aside = (
        half_angle_rad
        * footprint_points[:, 0]
        * np.stack([np.cos(footprint_points[:, 1]), np.sin(footprint_points[:, 1])])
    )
    across = np.stack([right, np.cross(right, beams)], -2)
    rays = beams[..., None, :] + np.einsum("kn,...kc->...nc", aside, across)
    flat = rays.reshape(len(rays), -1, 3)
    found = cast_rays(scene, T_world_surfaces, T_world_lidar, flat)
    return [values.reshape(rays.shape[:-1]) for values in found]


def _hit_surface(scene, distance, label):
    """Number of the surface met, -1 without a return."""
    return np.where(_has_return(scene, distance, label), scene.label_surfaces[label], -1)


def _select_columns(T, columns):
    """Poses at some of the columns; T is (4, 4), (columns, 4, 4) or a dict of such."""
    if isinstance(T, dict):
        return {name: _select_columns(pose, columns) for name, pose in T.items()}
    return T[columns] if T.ndim == 3 else T
