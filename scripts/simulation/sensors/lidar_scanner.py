"""Scan the scene with a lidar: beams meet the nearest surface exactly, at their column's time."""

from dataclasses import replace

import numpy as np

from simulation.sensors.cloud_formats import Echoes
from simulation.sensors.scan_patterns import Firing
from simulation.world.ray_casting import PosedScene, cast_rays
from simulation.world.ray_surfaces import SKY_FACE
from simulation.world.room_scene import SimulatedScene, find_surface_index

MIN_RANGE_M, MAX_RANGE_M = 0.4, 100.0
DARK_GREY_LEVEL = 64  # a surface darker than this is a dark one
PULSE_LENGTH_M = 1.0  # an echo farther than this behind the first one is separate from it
RIM_ANGLES_RAD = np.arange(6) * np.pi / 3
# Twelve points of equal area in a beam's footprint: share of its radius, and angle in degrees.
FOOTPRINT_POINTS = np.array(
    [(0.41, a) for a in range(0, 360, 90)] + [(0.82, a) for a in range(15, 360, 45)]
)


def scan_scene(
    posed: PosedScene,
    firing: Firing,
    stamp_ns: int = 0,
    *,
    rng: np.random.Generator | None = None,
    range_sigma_m: float = 0.0,
    range_bias_m: float | np.ndarray = 0.0,
    beam_divergence_rad: float = 0.0,
    dark_range_m: float = 0.0,
) -> Echoes:
    """Scan a scene with a firing whose first column leaves at stamp_ns.

    The poses are (4, 4), or (columns, 4, 4) at the columns' times. range_bias_m is one or
    (beams,). beam_divergence_rad is the full angle of a beam; a beam of 0 is a line. dark_range_m:
    by how much ranges to dark surfaces are longer. rng draws the range noise and may be None
    without noise.
    """
    scene = posed.scene
    distance, label = cast_rays(posed, firing.beam_directions)
    has_return = _has_return(scene, distance, label)
    if beam_divergence_rad:
        distance, has_return = _apply_beam_divergence(
            posed, firing.beam_directions, distance, label, half_angle_rad=beam_divergence_rad / 2
        )
    if range_sigma_m:
        assert rng is not None, "range noise needs random numbers"
        distance = distance + range_sigma_m * rng.standard_normal(distance.shape)
    grey_level = scene.label_colors[label].mean(-1)
    excess = range_bias_m + dark_range_m * (grey_level < DARK_GREY_LEVEL)
    distance = np.where(has_return, distance + excess, 0.0)
    return Echoes(
        xyz=firing.beam_directions * distance[..., None],
        distance_m=distance,
        grey_level=grey_level,
        has_return=has_return,
        column_time_ns=firing.column_time_ns[:, None],
        stamp_ns=stamp_ns,
    )


def _has_return(scene: SimulatedScene, distance: np.ndarray, label: np.ndarray) -> np.ndarray:
    sky = scene.first_labels[find_surface_index(scene, "room")] + SKY_FACE
    is_surface = (label != sky) | (distance == np.inf)
    return is_surface & (distance > MIN_RANGE_M) & (distance < MAX_RANGE_M)


def _apply_beam_divergence(
    posed: PosedScene,
    beams: np.ndarray,
    distance: np.ndarray,
    label: np.ndarray,
    *,
    half_angle_rad: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return distance and whether there is a return (columns, beams) if a beam is a cone.

    If the rim of a cone meets other surfaces than its axis, the range is the mean of what the cone
    meets up to PULSE_LENGTH_M behind the nearest: a mixed pixel.
    """
    scene = posed.scene
    has_return = _has_return(scene, distance, label)
    rim = np.stack([np.ones(len(RIM_ANGLES_RAD)), RIM_ANGLES_RAD], -1)
    rim_surface = _hit_surface(scene, *_cast_footprint(posed, beams, half_angle_rad, rim))
    axis_surface = np.where(has_return, scene.label_surfaces[label], -1)
    is_mixed = np.any(rim_surface != axis_surface[..., None], axis=-1)
    at_columns = _select_columns(posed, np.nonzero(is_mixed)[0])
    disc = FOOTPRINT_POINTS * [1, np.pi / 180]
    disc_range, disc_label = _cast_footprint(
        at_columns, beams[is_mixed][:, None], half_angle_rad, disc
    )
    disc_range = np.where(_has_return(scene, disc_range, disc_label), disc_range, np.inf)[:, 0]
    nearest = disc_range.min(1, keepdims=True)
    is_in_pulse = np.isfinite(disc_range) & (disc_range < nearest + PULSE_LENGTH_M)
    distance, has_return = distance.copy(), has_return.copy()
    count = is_in_pulse.sum(1)
    distance[is_mixed] = np.where(is_in_pulse, disc_range, 0).sum(1) / np.maximum(count, 1)
    has_return[is_mixed] = count > 0
    return distance, has_return


def _cast_footprint(
    posed: PosedScene, beams: np.ndarray, half_angle_rad: float, footprint_points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return distance and label (columns, beams, n) along rays beside the beams.

    footprint_points (n, 2): share of the half angle, and angle around the beam, rad.
    """
    right = np.cross(beams, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    aside = (
        half_angle_rad
        * footprint_points[:, 0]
        * np.stack([np.cos(footprint_points[:, 1]), np.sin(footprint_points[:, 1])])
    )
    across = np.stack([right, np.cross(right, beams)], -2)
    rays = beams[..., None, :] + np.einsum("kn,...kc->...nc", aside, across)
    distance, label = cast_rays(posed, rays.reshape(len(rays), -1, 3))
    return distance.reshape(rays.shape[:-1]), label.reshape(rays.shape[:-1])


def _hit_surface(scene: SimulatedScene, distance: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Return the index of the surface that is met, -1 without a return."""
    return np.where(_has_return(scene, distance, label), scene.label_surfaces[label], -1)


def _select_columns(posed: PosedScene, columns: np.ndarray) -> PosedScene:
    """Return the poses at some of the columns; poses that hold for all columns stay."""

    def select(T: np.ndarray) -> np.ndarray:
        return T[columns] if T.ndim == 3 else T

    return replace(
        posed,
        T_world_surfaces={name: select(T) for name, T in posed.T_world_surfaces.items()},
        T_world_sensor=select(posed.T_world_sensor),
    )
