"""Placements of robot and targets in which every target is seen as it should be."""

from typing import NamedTuple

import numpy as np

from calib.geometry.se3 import (
    invert_pose,
    make_pose,
    pose_from_rpy,
    rotation_angle,
    so3_exp,
    transform_points,
)
from simulation.sensors.scan_patterns import coarse_beam_directions
from simulation.world.ray_casting import cast_rays
from simulation.world.room_scene import find_surface_index, place_surfaces, visibility_points

ROBOT_HEIGHT_M = 0.35
MIN_CLEARANCE_M = 0.6  # between the spheres about two targets
IMAGE_BORDER_PX = 12  # that a camera keeps free around a target
CYLINDER_ELEVATIONS_DEG = (
    (75, 90),
    (0, 15),
    (30, 60),
)  # elevation of a cylinder's axis, deg: upright, flat, oblique
R_CAMERA_FORWARD = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # from forward, left, up


class SimulatedPlacements(NamedTuple):
    """T_world_body (n, 4, 4) of robot and targets by name, and the kind (n,) of each placement."""

    placement_poses: dict
    layout_index: np.ndarray

    @property
    def time_slots(self):
        """Slots (n,) of time: one is left out where the kind changes and the way is long."""
        return np.arange(len(self.layout_index)) + np.cumsum(
            np.diff(self.layout_index, prepend=self.layout_index[0]) != 0
        )


def draw_placements(rng, scene, rig, layouts, n_placements, is_upright=False):
    """Drawn placements: kind after kind, those of one in an order of small steps; is_upright: robot
    and targets turn about the vertical only."""
    drawn = [_draw_placement(rng, scene, rig, layouts, k, is_upright) for k in range(n_placements)]
    kind = np.arange(n_placements) % len(layouts)
    order = _order_placements(drawn, kind)
    return SimulatedPlacements(
        {name: np.stack([drawn[k][name] for k in order]) for name in drawn[0]}, kind[order]
    )


def _draw_placement(rng, scene, rig, layouts, placement_index, is_upright):
    spots, lean = (
        layouts[placement_index % len(layouts)],
        CYLINDER_ELEVATIONS_DEG[placement_index // len(layouts) % len(CYLINDER_ELEVATIONS_DEG)],
    )
    for _ in range(2000):
        T = {"robot": _draw_robot_pose(rng)}
        for name, spot in spots.items():
            T[name] = _draw_target_pose(
                rng, T["robot"] @ _T_robot_forward(rig, spot.sensor), name, spot, lean
            )
        T = {name: _turn_upright(name, pose) for name, pose in T.items()} if is_upright else T
        if _has_clearance(scene, T, list(spots)) and _is_in_view(scene, rig, T, spots):
            return T
    raise ValueError(
        f"no placement {placement_index} of {', '.join(spots)} as wanted in 2000 draws"
    )


def _draw_robot_pose(rng):
    xyz = rng.uniform([-0.1, -0.1, -0.01], [0.1, 0.1, 0.01]) + [0, 0, ROBOT_HEIGHT_M]
    return pose_from_rpy(xyz, np.deg2rad(rng.uniform([-1, -1, -5], [1, 1, 5])))


def _turn_upright(name, T):
    """The pose turned the shortest way to where the body's vertical axis is that of the room: z of
    the robot, y of a board, x of a cylinder."""
    axis = {"robot": 2, "board": 1, "cylinder": 0}[name]
    up = T[:3, axis]
    turn = np.cross(up, [0, 0, 1.0])
    size = np.linalg.norm(turn)
    R = so3_exp(turn / max(size, 1e-12) * np.arctan2(size, up[2]))
    return make_pose(R @ T[:3, :3], T[:3, 3])


def _T_robot_forward(rig, sensor):
    """T_robot_sensor (4, 4) with axes forward, left, up."""
    T = rig.T_robot_sensor[sensor]
    return T @ make_pose(R_CAMERA_FORWARD) if sensor in rig.camera_models else T


def _draw_target_pose(rng, T_world_forward, name, spot, elevation_deg):
    """T_world_target at a spot; a board faces the sensor, a cylinder's axis rises by lean, deg."""
    azimuth, distance = rng.uniform(*spot.azimuth_deg), rng.uniform(*spot.distance_m)
    azimuth, elevation = np.deg2rad([azimuth, rng.uniform(*spot.elevation_deg)])
    flat = np.cos(elevation)
    ray = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    sight = T_world_forward[:3, :3] @ ray
    R = (
        _draw_board_rotation(rng, sight)
        if name == "board"
        else _draw_cylinder_rotation(rng, sight, elevation_deg)
    )
    return make_pose(R, transform_points(T_world_forward, distance * ray))


def _draw_board_rotation(rng, view_direction):
    """Rotation of a board whose normal is within 35° of -sight, rolled by up to 30° about it."""
    around, tilt = rng.uniform(0, 2 * np.pi), np.deg2rad(35) * np.sqrt(rng.uniform())
    right = np.cross(view_direction, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    axis = np.cos(around) * right + np.sin(around) * np.cross(right, view_direction)
    normal = so3_exp(tilt * axis) @ -view_direction
    x = np.cross([0, 0, 1.0], normal)
    x /= np.linalg.norm(x)
    upright = np.stack([x, np.cross(normal, x), normal], -1)
    return upright @ so3_exp([0, 0, np.deg2rad(rng.uniform(-30, 30))])


def _draw_cylinder_rotation(rng, view_direction, elevation_deg):
    """Rotation of a cylinder whose axis rises by elevation_deg (2,), deg, 40° or more off the sight."""
    while True:
        rise, azimuth = np.deg2rad(rng.uniform(*elevation_deg)), rng.uniform(-np.pi, np.pi)
        x = np.array([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)])
        if abs(x @ view_direction) < np.cos(np.deg2rad(40)):
            break
    y = np.cross(view_direction, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], -1) @ so3_exp([np.deg2rad(rng.uniform(-30, 30)), 0, 0])


def _has_clearance(scene, T, targets):
    """Whether the spheres about the targets leave CLEAR_M between them."""
    reach = [scene.surfaces[find_surface_index(scene, name)].bounding_radius_m for name in targets]
    return all(
        np.linalg.norm(T[a][:3, 3] - T[b][:3, 3]) > reach[i] + reach[j] + MIN_CLEARANCE_M
        for i, a in enumerate(targets)
        for j, b in enumerate(targets[:i])
    )


def _is_in_view(scene, rig, T, spots):
    surfaces = place_surfaces({name: T[name] for name in spots})
    return all(
        is_target_visible(scene, rig, surfaces, T["robot"], sensor, name)
        for name, spot in spots.items()
        for sensor in spot.visible_to
    )


def is_target_visible(scene, rig, T_world_surfaces, T_world_robot, sensor, target_name):
    """Whether a sensor sees a target well."""
    T_world_sensor = T_world_robot @ rig.T_robot_sensor[sensor]
    if sensor in rig.camera_models:
        model = rig.camera_models[sensor]
        return _is_visible_to_camera(scene, model, T_world_surfaces, T_world_sensor, target_name)
    return _is_visible_to_lidar(
        scene, rig.sensor_specs[sensor], T_world_surfaces, T_world_sensor, target_name
    )


def _is_visible_to_lidar(scene, spec, T_world_surfaces, T_world_lidar, name):
    """Whether 8 rings 2° apart meet the board, 3 the cylinder, or the only one that there is, and
    nothing stands before it."""
    beams = coarse_beam_directions(spec.scan_pattern, np.deg2rad(spec.sector_deg))
    target = find_surface_index(scene, name)
    pose_pair = (T_world_surfaces, T_world_lidar)
    alone = np.isfinite(cast_rays(scene, *pose_pair, beams, [target])[0])
    seen = scene.label_surfaces[cast_rays(scene, *pose_pair, beams)[1]] == target
    rings = np.sum(np.sum(seen, axis=0) >= 2)
    least = min(8 if name == "board" else 3, beams.shape[1])
    return rings >= least and np.array_equal(alone, seen)


def _is_visible_to_camera(scene, camera, T_world_surfaces, T_world_camera, name):
    """Whether the whole pattern, or cylinder, is in the image and what faces it is not hidden."""
    p, normal = visibility_points(name)
    T_camera_target = invert_pose(T_world_camera) @ T_world_surfaces[name]
    p_camera = transform_points(T_camera_target, p)
    uv, ok = camera.project(p_camera)
    if not np.all(ok & camera.is_in_image(uv, IMAGE_BORDER_PX)):
        return False
    facing = np.sum(normal @ T_camera_target[:3, :3].T * p_camera, axis=1)
    rays = p_camera[facing < -0.2 * np.linalg.norm(p_camera, axis=1)]
    label = cast_rays(scene, T_world_surfaces, T_world_camera, rays)[1]
    return np.all(scene.label_surfaces[label] == find_surface_index(scene, name))


def _order_placements(placements, layout_index):
    """Order kind by kind, each time to the nearest placement of those left: motions are slow."""
    left, order = set(range(1, len(placements))), [0]
    while left:
        last = order[-1]
        near = [k for k in left if layout_index[k] == layout_index[last]]
        near = near or [k for k in left if layout_index[k] == min(layout_index[i] for i in left)]
        order.append(min(near, key=lambda k: (_motion_length(placements[last], placements[k]), k)))
        left.remove(order[-1])
    return order


def _motion_length(A, B):
    """Sum over bodies of metres and radians between two placements."""
    steps = [invert_pose(A[name]) @ B[name] for name in A]
    return sum(np.linalg.norm(S[:3, 3]) + rotation_angle(S) for S in steps)
