"""Placements of robot and targets in which every target is seen as it should be."""

from typing import NamedTuple

import numpy as np

from calib.geometry.se3 import angle, from_rpy, inverse, pose, so3_exp, transform
from simulation.sensors import scan_patterns
from simulation.world import ray_casting, room_scene

ROBOT_HEIGHT_M = 0.35
CLEAR_M = 0.6  # between the spheres about two targets
BORDER_PX = 12  # that a camera keeps free around a target
LEANS = ((75, 90), (0, 15), (30, 60))  # elevation of a cylinder's axis, deg: upright, flat, oblique
CAMERA_FORWARD = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # from forward, left, up


class Drawn(NamedTuple):
    """T_world_body (n, 4, 4) of robot and targets by name, and the kind (n,) of each placement."""

    knots: dict
    kind: np.ndarray

    @property
    def slots(self):
        """Slots (n,) of time: one is left out where the kind changes and the way is long."""
        return np.arange(len(self.kind)) + np.cumsum(np.diff(self.kind, prepend=self.kind[0]) != 0)


def draw(rng, scene, built, kinds, count, upright=False):
    """Drawn placements: kind after kind, those of one in an order of small steps; upright: robot
    and targets turn about the vertical only."""
    drawn = [_draw_one(rng, scene, built, kinds, k, upright) for k in range(count)]
    kind = np.arange(count) % len(kinds)
    order = _order(drawn, kind)
    return Drawn(
        {name: np.stack([drawn[k][name] for k in order]) for name in drawn[0]}, kind[order]
    )


def _draw_one(rng, scene, built, kinds, k, upright):
    spots, lean = kinds[k % len(kinds)], LEANS[k // len(kinds) % len(LEANS)]
    for _ in range(2000):
        T = {"robot": _draw_robot(rng)}
        for name, spot in spots.items():
            T[name] = _draw_target(rng, T["robot"] @ _forward(built, spot.sensor), name, spot, lean)
        T = {name: _upright(name, pose) for name, pose in T.items()} if upright else T
        if _apart(scene, T, list(spots)) and _in_view(scene, built, T, spots):
            return T
    raise ValueError(f"no placement {k} of {', '.join(spots)} as wanted in 2000 draws")


def _draw_robot(rng):
    xyz = rng.uniform([-0.1, -0.1, -0.01], [0.1, 0.1, 0.01]) + [0, 0, ROBOT_HEIGHT_M]
    return from_rpy(xyz, np.deg2rad(rng.uniform([-1, -1, -5], [1, 1, 5])))


def _upright(name, T):
    """The pose turned the shortest way to where the body's vertical axis is that of the room: z of
    the robot, y of a board, x of a cylinder."""
    axis = {"robot": 2, "board": 1, "cylinder": 0}[name]
    up = T[:3, axis]
    turn = np.cross(up, [0, 0, 1.0])
    size = np.linalg.norm(turn)
    R = so3_exp(turn / max(size, 1e-12) * np.arctan2(size, up[2]))
    return pose(R @ T[:3, :3], T[:3, 3])


def _forward(built, sensor):
    """T_robot_sensor (4, 4) with axes forward, left, up."""
    T = built.sensors[sensor]
    return T @ pose(CAMERA_FORWARD) if sensor in built.cameras else T


def _draw_target(rng, T_world_forward, name, spot, lean):
    """T_world_target at a spot; a board faces the sensor, a cylinder's axis rises by lean, deg."""
    azimuth, distance = rng.uniform(*spot.azimuth_deg), rng.uniform(*spot.distance_m)
    azimuth, elevation = np.deg2rad([azimuth, rng.uniform(*spot.elevation_deg)])
    flat = np.cos(elevation)
    ray = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    sight = T_world_forward[:3, :3] @ ray
    R = _facing(rng, sight) if name == "board" else _leaning(rng, sight, lean)
    return pose(R, transform(T_world_forward, distance * ray))


def _facing(rng, sight):
    """Rotation of a board whose normal is within 35° of -sight, rolled by up to 30° about it."""
    around, tilt = rng.uniform(0, 2 * np.pi), np.deg2rad(35) * np.sqrt(rng.uniform())
    right = np.cross(sight, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    axis = np.cos(around) * right + np.sin(around) * np.cross(right, sight)
    normal = so3_exp(tilt * axis) @ -sight
    x = np.cross([0, 0, 1.0], normal)
    x /= np.linalg.norm(x)
    upright = np.stack([x, np.cross(normal, x), normal], -1)
    return upright @ so3_exp([0, 0, np.deg2rad(rng.uniform(-30, 30))])


def _leaning(rng, sight, lean):
    """Rotation of a cylinder whose axis rises by lean (2,), deg, 40° or more off the sight."""
    while True:
        rise, azimuth = np.deg2rad(rng.uniform(*lean)), rng.uniform(-np.pi, np.pi)
        x = np.array([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)])
        if abs(x @ sight) < np.cos(np.deg2rad(40)):
            break
    y = np.cross(sight, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], -1) @ so3_exp([np.deg2rad(rng.uniform(-30, 30)), 0, 0])


def _apart(scene, T, targets):
    """Whether the spheres about the targets leave CLEAR_M between them."""
    reach = [scene.surfaces[room_scene.index(scene, name)].radius for name in targets]
    return all(
        np.linalg.norm(T[a][:3, 3] - T[b][:3, 3]) > reach[i] + reach[j] + CLEAR_M
        for i, a in enumerate(targets)
        for j, b in enumerate(targets[:i])
    )


def _in_view(scene, built, T, spots):
    surfaces = room_scene.poses({name: T[name] for name in spots})
    return all(
        sees(scene, built, surfaces, T["robot"], sensor, name)
        for name, spot in spots.items()
        for sensor in spot.seen_by
    )


def sees(scene, built, T_world_surfaces, T_world_robot, sensor, name):
    """Whether a sensor sees a target well."""
    T_world_sensor = T_world_robot @ built.sensors[sensor]
    if sensor in built.cameras:
        model = built.cameras[sensor]
        return _camera_sees(scene, model, T_world_surfaces, T_world_sensor, name)
    return _lidar_sees(scene, built.specs[sensor], T_world_surfaces, T_world_sensor, name)


def _lidar_sees(scene, spec, T_world_surfaces, T_world_lidar, name):
    """Whether 8 rings 2° apart meet the board, 3 the cylinder, or the only one that there is, and
    nothing stands before it."""
    beams = scan_patterns.coarse(spec.scans, np.deg2rad(spec.sector_deg))
    target = room_scene.index(scene, name)
    pose_pair = (T_world_surfaces, T_world_lidar)
    alone = np.isfinite(ray_casting.cast(scene, *pose_pair, beams, [target])[0])
    seen = scene.surface[ray_casting.cast(scene, *pose_pair, beams)[1]] == target
    rings = np.sum(np.sum(seen, axis=0) >= 2)
    least = min(8 if name == "board" else 3, beams.shape[1])
    return rings >= least and np.array_equal(alone, seen)


def _camera_sees(scene, camera, T_world_surfaces, T_world_camera, name):
    """Whether the whole pattern, or cylinder, is in the image and what faces it is not hidden."""
    p, normal = room_scene.marks(name)
    T_camera_target = inverse(T_world_camera) @ T_world_surfaces[name]
    p_camera = transform(T_camera_target, p)
    uv, ok = camera.project(p_camera)
    if not np.all(ok & camera.in_image(uv, BORDER_PX)):
        return False
    facing = np.sum(normal @ T_camera_target[:3, :3].T * p_camera, axis=1)
    rays = p_camera[facing < -0.2 * np.linalg.norm(p_camera, axis=1)]
    label = ray_casting.cast(scene, T_world_surfaces, T_world_camera, rays)[1]
    return np.all(scene.surface[label] == room_scene.index(scene, name))


def _order(drawn, kind):
    """Order kind by kind, each time to the nearest placement of those left: motions are slow."""
    left, order = set(range(1, len(drawn))), [0]
    while left:
        last = order[-1]
        near = [k for k in left if kind[k] == kind[last]]
        near = near or [k for k in left if kind[k] == min(kind[i] for i in left)]
        order.append(min(near, key=lambda k: (_effort(drawn[last], drawn[k]), k)))
        left.remove(order[-1])
    return order


def _effort(A, B):
    """Sum over bodies of metres and radians between two placements."""
    steps = [inverse(A[name]) @ B[name] for name in A]
    return sum(np.linalg.norm(S[:3, 3]) + angle(S) for S in steps)
