"""Images of a scene: the exact integral of flat colours over square pixels, nearly.

A cylinder's side is shaded besides, by a factor taken at the middle of each pixel.

Every ray comes from Camera.unproject. Rays through the corners of pixels tell which pixels hold
a border between two labels; all others have one colour, exactly. Those near a target are then
integrated with many scrambled Sobol points each, whose error falls for edges of every direction;
the points between the corners of pixels come by quadratic interpolation of the rays (1e-10 rad).
A thing must be 5 px wide to be seen.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.stats import qmc

from calib.geometry.se3 import invert_pose, transform_points
from simulation.world.ray_casting import cast_rays
from simulation.world.ray_surfaces import cylinder_side_normals
from simulation.world.room_scene import SIMULATED_TARGETS

BLOCK_PX = 4  # px between the rays that look for borders first
N_POINTS_PER_SET = (
    64  # a set of 1024 points comes in 16 versions, and neighbouring pixels take different ones
)
COARSE_POINTS_PER_PIXEL, FINE_POINTS_PER_PIXEL = (
    16,
    1024,
)  # points in a pixel away from targets or in motion, and on targets
SHADED_TARGETS = ("cylinder",)
LIGHT_DIRECTION = np.array([0.30, 0.20, 0.93])  # towards the lamps, world


class RayGrid(NamedTuple):
    """A camera and its rays (rows, columns, 3): node (i, j) is at pixel (j - 0.5, i - 0.5)."""

    camera: object
    rays: np.ndarray


def compute_ray_grid(camera):
    """View of a camera; nodes cover whole blocks and one more for the interpolation."""
    width, height = (-(-n // BLOCK_PX) * BLOCK_PX + 2 for n in camera.size_px)
    uv = np.stack(np.meshgrid(np.arange(width) - 0.5, np.arange(height) - 0.5), -1)
    rays = [camera.unproject(rows)[0] for rows in np.array_split(uv, height // 8)]  # fits the cache
    return RayGrid(camera, np.concatenate(rays).reshape(height, width, 3))


def render_image(
    ray_grid,
    scene,
    T_world_surfaces,
    T_world_camera,
    n_fine_points=FINE_POINTS_PER_PIXEL,
    n_coarse_points=COARSE_POINTS_PER_PIXEL,
):
    """Image (height, width, 3), BGR, grey levels, unrounded. fine and coarse are powers of two."""
    width, height = ray_grid.camera.size_px
    poses = (T_world_surfaces, T_world_camera)
    label = _label_nodes(ray_grid, scene, *poses)
    corner = [label[i : i + height, j : j + width] for i in (0, 1) for j in (0, 1)]
    border = np.any([c != corner[0] for c in corner[1:]], axis=0)
    _mark_corner_pixels(border, ray_grid.camera, scene, *poses)
    image = scene.label_colors[corner[0]]
    shares = [(corner[0] == first).astype(float) for _, first in _cylinder_sides(scene)]
    v, u = np.nonzero(border)
    varied, near = _classify_border_pixels(scene, label, v, u)
    v, u, near = v[varied], u[varied], near[varied]
    targets = [i for i, s in enumerate(scene.surfaces) if s.name in SIMULATED_TARGETS]
    is_fine = (near & sum(1 << i for i in targets)) > 0
    for points, mask in ((n_fine_points, is_fine), (n_coarse_points, ~is_fine)):
        part = (v[mask], u[mask])
        image[part], parts = _integrate_pixels(ray_grid, scene, *poses, *part, near[mask], points)
        for share, values in zip(shares, parts, strict=True):
            share[part] = values
    for (surface, first), share in zip(_cylinder_sides(scene), shares, strict=True):
        seen = share > 0
        shade = _side_brightness(ray_grid, surface, *poses, seen)
        image[seen] += (share[seen] * (shade - 1))[:, None] * scene.label_colors[first]
    return image


def _cylinder_sides(scene):
    """Surface and label of the side of every cylinder that is a target."""
    return [
        (s, f)
        for s, f in zip(scene.surfaces, scene.first_labels, strict=True)
        if s.name in SHADED_TARGETS
    ]


def _side_brightness(ray_grid, surface, T_world_surfaces, T_world_camera, is_side_pixel):
    """Brightness (n,) of a cylinder's side in the pixels is_side_pixel (height, width): between 0.7 and 1,
    by the angle between its normal and the light, without the harsh edge of a lamp's shadow."""
    v, u = np.nonzero(is_side_pixel)
    corners = [ray_grid.rays[v + i, u + j] for i in (0, 1) for j in (0, 1)]
    T = invert_pose(T_world_surfaces[surface.name]) @ T_world_camera
    o, d = T[:3, 3], np.mean(corners, axis=0) @ T[:3, :3].T
    normal = cylinder_side_normals(surface.shape_params, o, d)
    light = T_world_surfaces[surface.name][:3, :3].T @ LIGHT_DIRECTION
    return 0.85 + 0.15 * normal @ light


def _label_nodes(ray_grid, scene, T_world_surfaces, T_world_camera):
    """Label at every node; rays are cast only in and beside the blocks whose corners differ."""
    rays = ray_grid.rays[:-1, :-1]
    few = rays[::BLOCK_PX, ::BLOCK_PX]
    coarse = cast_rays(scene, T_world_surfaces, T_world_camera, few.reshape(-1, 3))[1]
    coarse = coarse.reshape(few.shape[:2])
    first, *rest = (coarse[i : i - 1 or None, j : j - 1 or None] for i in (0, 1) for j in (0, 1))
    busy = np.any([r != first for r in rest], axis=0)
    busy = np.pad(binary_dilation(busy, np.ones((3, 3))), ((0, 1), (0, 1)), mode="edge")
    block = np.ix_(*(np.arange(n) // BLOCK_PX for n in rays.shape[:2]))
    label, todo = coarse[block], busy[block]
    label[todo] = cast_rays(scene, T_world_surfaces, T_world_camera, rays[todo])[1]
    return label


def _mark_corner_pixels(border, camera, scene, T_world_surfaces, T_world_camera):
    """Add the pixels around sharp corners, which may reach into a pixel between its nodes."""
    for surface in scene.surfaces:
        T = invert_pose(T_world_camera) @ T_world_surfaces[surface.name]
        uv, ok = camera.project(transform_points(T, surface.corners_m))
        for u, v in np.rint(uv[ok & camera.is_in_image(uv)]).astype(int):
            border[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2] = True


def _classify_border_pixels(scene, label, v, u):
    """Whether the nodes of pixels (n,) and of their neighbours see more than one colour, and the
    bits (n,) of the surfaces that they see."""
    color = np.unique(scene.label_colors, axis=0, return_inverse=True)[1].reshape(-1)
    surface_bits, color_bits = 1 << scene.label_surfaces, 1 << color
    surfaces, colors = np.zeros((2, len(v)), np.int64)
    for i in range(-1, 3):
        for j in range(-1, 3):
            row = np.clip(v + i, 0, label.shape[0] - 1)
            seen = label[row, np.clip(u + j, 0, label.shape[1] - 1)]
            surfaces |= surface_bits[seen]
            colors |= color_bits[seen]
    return (colors & (colors - 1)) > 0, surfaces


def _integrate_pixels(
    ray_grid, scene, T_world_surfaces, T_world_camera, v, u, surface_bits, n_points
):
    """Mean colours (n, 3) over the pixels (v, u) (n,), with so many points in each, and the shares
    (sides, n) of the points that meet the side of each shaded cylinder."""
    sides = [first for _, first in _cylinder_sides(scene)]
    out, shares = np.empty((len(v), 3)), np.zeros((len(sides), len(v)))
    weights = _interpolation_weights(n_points)
    sets = len(weights)
    group = surface_bits * sets + (u + 5 * v) % sets
    for g in np.unique(group):
        where = np.flatnonzero(group == g)
        nodes = [ray_grid.rays[v[where] + i, u[where] + j] for i in range(3) for j in range(3)]
        rays = weights[g % sets] @ np.reshape(nodes, (9, -1))
        only = [i for i in range(len(scene.surfaces)) if (g // sets) >> i & 1]
        label = cast_rays(scene, T_world_surfaces, T_world_camera, rays.reshape(-1, 3), only)[1]
        out[where] = scene.label_colors[label].reshape(n_points, -1, 3).mean(0)
        for share, side in zip(shares, sides, strict=True):
            share[where] = (label == side).reshape(n_points, -1).mean(0)
    return out, shares


@cache
def _interpolation_weights(n_points):
    """Weights (sets, points, 9) that interpolate 3 by 3 nodes at points of the pixel between the
    first two of each direction."""
    sets = max(1, n_points // N_POINTS_PER_SET)
    s = np.array([qmc.Sobol(2, scramble=True, rng=k).random(n_points) for k in range(sets)])
    along = np.stack([(1 - s) * (2 - s) / 2, s * (2 - s), s * (s - 1) / 2], -1)
    return (along[:, :, 1, :, None] * along[:, :, 0, None, :]).reshape(sets, n_points, 9)
