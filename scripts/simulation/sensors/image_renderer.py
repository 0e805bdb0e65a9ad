"""Render images of a scene: very nearly the integral of flat colours over square pixels.

Every ray comes from CameraModel.unproject. Rays through the corners of pixels show which pixels
hold a border between two labels; all others have one colour, exactly. Pixels near a target are
integrated with many scrambled Sobol points each, whose error falls for edges of every direction.
Rays between the corners of pixels are interpolated quadratically (error 1e-10 rad). The side of a
cylinder is shaded with the light at the middle of each pixel. An object must be 5 px wide to show.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.stats import qmc

from calib.geometry.se3 import invert_pose, transform_points
from calib.sensors.camera.camera_model import CameraModel
from simulation.world.ray_casting import PosedScene, cast_rays
from simulation.world.ray_surfaces import cylinder_side_normals
from simulation.world.room_scene import SIMULATED_TARGETS, SceneSurface, SimulatedScene

BLOCK_PX = 4  # px between the rays that look for borders first
# 1024 points come in 16 versions (1024 / 64), and neighbouring pixels take different ones.
N_POINTS_PER_SET = 64
COARSE_POINTS_PER_PIXEL = 16  # away from targets
FINE_POINTS_PER_PIXEL = 1024  # at targets
SHADED_TARGETS = ("cylinder",)
LIGHT_DIRECTION = np.array([0.30, 0.20, 0.93])  # towards the lamps, world


class RayGrid(NamedTuple):
    """A camera and its rays (rows, columns, 3): node (i, j) is at pixel (j - 0.5, i - 0.5)."""

    camera: CameraModel
    rays: np.ndarray


class BorderPixels(NamedTuple):
    """Pixels (n,) at rows v and columns u, with the bits of the surfaces that they see."""

    v: np.ndarray
    u: np.ndarray
    surface_bits: np.ndarray


def compute_ray_grid(camera: CameraModel) -> RayGrid:
    """Compute the rays of a camera; nodes cover whole blocks, and one more to interpolate."""
    width, height = (-(-n // BLOCK_PX) * BLOCK_PX + 2 for n in camera.size_px)
    uv = np.stack(np.meshgrid(np.arange(width) - 0.5, np.arange(height) - 0.5), -1)
    rays = [camera.unproject(rows)[0] for rows in np.array_split(uv, height // 8)]  # fits the cache
    return RayGrid(camera, np.concatenate(rays).reshape(height, width, 3))


def render_image(
    ray_grid: RayGrid,
    posed: PosedScene,
    n_fine_points: int = FINE_POINTS_PER_PIXEL,
    n_coarse_points: int = COARSE_POINTS_PER_PIXEL,
) -> np.ndarray:
    """Render an unrounded image (height, width, 3), BGR, grey levels.

    n_fine_points at targets and n_coarse_points elsewhere are points per pixel, powers of two.
    """
    scene, (width, height) = posed.scene, ray_grid.camera.size_px
    label = _label_nodes(ray_grid, posed)
    corners = [label[i : i + height, j : j + width] for i in (0, 1) for j in (0, 1)]
    is_border = np.any([c != corners[0] for c in corners[1:]], axis=0)
    _mark_corner_pixels(is_border, ray_grid.camera, posed)
    image = scene.label_colors[corners[0]]
    sides = _cylinder_sides(scene)
    side_shares = [(corners[0] == side_label).astype(float) for _, side_label in sides]
    v, u = np.nonzero(is_border)
    is_varied, surface_bits = _classify_border_pixels(scene, label, v, u)
    v, u, surface_bits = v[is_varied], u[is_varied], surface_bits[is_varied]
    targets = [i for i, s in enumerate(scene.surfaces) if s.name in SIMULATED_TARGETS]
    is_fine = (surface_bits & sum(1 << i for i in targets)) > 0
    for n_points, mask in ((n_fine_points, is_fine), (n_coarse_points, ~is_fine)):
        pixels = BorderPixels(v[mask], u[mask], surface_bits[mask])
        at = (pixels.v, pixels.u)
        image[at], shares = _integrate_pixels(ray_grid, posed, pixels, n_points)
        for side_share, share in zip(side_shares, shares, strict=True):
            side_share[at] = share
    for (surface, side_label), side_share in zip(sides, side_shares, strict=True):
        is_side = side_share > 0
        brightness = _side_brightness(ray_grid, surface, posed, is_side)
        shade = (side_share[is_side] * (brightness - 1))[:, None]
        image[is_side] += shade * scene.label_colors[side_label]
    return image


def _cylinder_sides(scene: SimulatedScene) -> list[tuple[SceneSurface, int]]:
    """Return the surface and the side's label of every cylinder that is a target."""
    return [
        (surface, int(label))
        for surface, label in zip(scene.surfaces, scene.first_labels, strict=True)
        if surface.name in SHADED_TARGETS
    ]


def _side_brightness(
    ray_grid: RayGrid, surface: SceneSurface, posed: PosedScene, is_side_pixel: np.ndarray
) -> np.ndarray:
    """Return the brightness (n,), 0.7 to 1, of a cylinder's side in the pixels (height, width).

    It follows the angle between normal and light, without the hard edge of a lamp's shadow.
    """
    v, u = np.nonzero(is_side_pixel)
    corners = [ray_grid.rays[v + i, u + j] for i in (0, 1) for j in (0, 1)]
    T_world_surface = posed.T_world_surfaces[surface.name]
    T = invert_pose(T_world_surface) @ posed.T_world_sensor
    o, d = T[:3, 3], np.mean(corners, axis=0) @ T[:3, :3].T
    normal = cylinder_side_normals(surface.shape_params, o, d)
    light = T_world_surface[:3, :3].T @ LIGHT_DIRECTION
    return 0.85 + 0.15 * normal @ light


def _label_nodes(ray_grid: RayGrid, posed: PosedScene) -> np.ndarray:
    """Return the label at every node; casts rays only in and beside blocks whose corners differ."""
    rays = ray_grid.rays[:-1, :-1]
    block_rays = rays[::BLOCK_PX, ::BLOCK_PX]
    coarse = cast_rays(posed, block_rays.reshape(-1, 3))[1].reshape(block_rays.shape[:2])
    first, *rest = (coarse[i : i - 1 or None, j : j - 1 or None] for i in (0, 1) for j in (0, 1))
    is_busy = np.any([r != first for r in rest], axis=0)
    is_busy = np.pad(binary_dilation(is_busy, np.ones((3, 3))), ((0, 1), (0, 1)), mode="edge")
    block = np.ix_(*(np.arange(n) // BLOCK_PX for n in rays.shape[:2]))
    label, is_open = coarse[block], is_busy[block]
    label[is_open] = cast_rays(posed, rays[is_open])[1]
    return label


def _mark_corner_pixels(is_border: np.ndarray, camera: CameraModel, posed: PosedScene) -> None:
    """Add, in place, the pixels around sharp corners, which may lie between a pixel's nodes."""
    for surface in posed.scene.surfaces:
        T = invert_pose(posed.T_world_sensor) @ posed.T_world_surfaces[surface.name]
        uv, is_valid = camera.project(transform_points(T, surface.corners_m))
        for u, v in np.rint(uv[is_valid & camera.is_in_image(uv)]).astype(int):
            is_border[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2] = True


def _classify_border_pixels(
    scene: SimulatedScene, label: np.ndarray, v: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return whether pixels (n,) and their neighbours see more than one colour, and the bits (n,)
    of the surfaces that they see."""
    color = np.unique(scene.label_colors, axis=0, return_inverse=True)[1].reshape(-1)
    surface_bits, color_bits = 1 << scene.label_surfaces, 1 << color
    surfaces, colors = np.zeros((2, len(v)), np.int64)
    for i in range(-1, 3):
        for j in range(-1, 3):
            row = np.clip(v + i, 0, label.shape[0] - 1)
            node_label = label[row, np.clip(u + j, 0, label.shape[1] - 1)]
            surfaces |= surface_bits[node_label]
            colors |= color_bits[node_label]
    return (colors & (colors - 1)) > 0, surfaces


def _integrate_pixels(
    ray_grid: RayGrid, posed: PosedScene, pixels: BorderPixels, n_points: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean colours (n, 3) of pixels with so many points in each, and the shares (sides, n)
    of the points on the side of each shaded cylinder."""
    scene, (v, u, surface_bits) = posed.scene, pixels
    sides = [side_label for _, side_label in _cylinder_sides(scene)]
    colors, shares = np.empty((len(v), 3)), np.zeros((len(sides), len(v)))
    weights = _interpolation_weights(n_points)
    n_sets = len(weights)
    group = surface_bits * n_sets + (u + 5 * v) % n_sets
    for g in np.unique(group):
        members = np.flatnonzero(group == g)
        nodes = [ray_grid.rays[v[members] + i, u[members] + j] for i in range(3) for j in range(3)]
        rays = weights[g % n_sets] @ np.reshape(nodes, (9, -1))
        surfaces = [i for i in range(len(scene.surfaces)) if (g // n_sets) >> i & 1]
        label = cast_rays(posed, rays.reshape(-1, 3), surfaces)[1]
        colors[members] = scene.label_colors[label].reshape(n_points, -1, 3).mean(0)
        for share, side in zip(shares, sides, strict=True):
            share[members] = (label == side).reshape(n_points, -1).mean(0)
    return colors, shares


@cache
def _interpolation_weights(n_points: int) -> np.ndarray:
    """Return weights (sets, points, 9) that interpolate 3 by 3 nodes at points of the pixel between
    the first two of each direction."""
    n_sets = max(1, n_points // N_POINTS_PER_SET)
    s = np.array([qmc.Sobol(2, scramble=True, rng=k).random(n_points) for k in range(n_sets)])
    along = np.stack([(1 - s) * (2 - s) / 2, s * (2 - s), s * (s - 1) / 2], -1)
    return (along[:, :, 1, :, None] * along[:, :, 0, None, :]).reshape(n_sets, n_points, 9)
