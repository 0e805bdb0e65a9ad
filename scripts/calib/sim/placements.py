"""The rig, and placements of robot and targets in which every target is seen as it should be."""

from typing import NamedTuple

import numpy as np

from calib.cameras import Camera
from calib.geometry import angle, from_rpy, inverse, pose, so3_exp, transform
from calib.sim import lidar as lidars
from calib.sim import scene as scenes

NOMINAL = {  # T_robot_sensor: xyz, m, and roll, pitch, yaw, deg; the true one is drawn about it
    "velodyne": ((0.15, 0.0, 0.60), (0.0, 0.0, 2.0)),
    "camera": ((0.25, -0.10, 0.45), (-90.0, 0.0, -90.0)),
}
MOUNT_M, MOUNT_DEG = 0.02, 3.0  # largest deviation per axis of a true mount from the nominal one
IMAGE_SIZE, INTRINSICS = (900, 700), (802.3, 801.1, 452.6, 347.9)
ROBOT_HEIGHT_M = 0.35
CLEAR_M = 0.6  # between the spheres about two targets
COLUMNS_STEP = np.deg2rad(1.0)  # of the coarse scan that tells whether a target is in view
LEANS = ((75, 90), (0, 15), (30, 60))  # elevation of a cylinder's axis, deg: upright, flat, oblique


class Rig(NamedTuple):
    """T_robot_sensor (4, 4) by sensor, and the camera."""

    sensors: dict
    camera: Camera


def draw_rig(rng, distortion):
    """Rig with its mounts drawn and a radtan camera of that distortion (k1, k2, p1, p2)."""
    sensors = {}
    for name, (xyz, rpy) in NOMINAL.items():
        nominal = from_rpy(xyz, np.deg2rad(rpy))
        shift, turn = rng.uniform(-1, 1, (2, 3))
        sensors[name] = (
            pose(t=MOUNT_M * shift) @ nominal @ pose(so3_exp(np.deg2rad(MOUNT_DEG) * turn))
        )
    return Rig(sensors, Camera("radtan", (*INTRINSICS, *distortion), IMAGE_SIZE))


def perturb(rng, T, error_m, error_deg):
    """T_a_b with a shift uniform within ±error_m along each axis of a, and a rotation vector
    uniform within ±error_deg along each axis of b."""
    shift, turn = rng.uniform(-1, 1, (2, 3))
    return pose(t=error_m * shift) @ T @ pose(so3_exp(np.deg2rad(error_deg) * turn))


def draw(rng, scene, rig, targets, count):
    """T_world_body (count, 4, 4) of robot and targets, by name, in an order of small steps."""
    drawn = [_draw_one(rng, scene, rig, targets, k) for k in range(count)]
    order = _order(drawn)
    return {name: np.stack([drawn[k][name] for k in order]) for name in ("robot", *targets)}


def _draw_one(rng, scene, rig, targets, k):
    for _ in range(2000):
        T = {"robot": _draw_robot(rng)}
        for name in targets:
            T[name] = _draw_target(rng, T["robot"] @ rig.sensors["velodyne"], name, targets, k)
        if _apart(scene, T, targets) and _in_view(scene, rig, T, targets):
            return T
    raise ValueError(
        f"no placement {k} of {', '.join(targets)} in view of all sensors in 2000 draws"
    )


def _draw_robot(rng):
    xyz = rng.uniform([-0.1, -0.1, -0.01], [0.1, 0.1, 0.01]) + [0, 0, ROBOT_HEIGHT_M]
    return from_rpy(xyz, np.deg2rad(rng.uniform([-1, -1, -5], [1, 1, 5])))


def _draw_target(rng, T_world_lidar, name, targets, k):
    """T_world_target: the board ahead, the cylinder to the left of it or, alone, ahead."""
    if name == "board":
        azimuth, distance = rng.uniform(-12, 12), rng.uniform(1.4, 3.2)
    else:
        azimuth = rng.uniform(*((25, 70) if "board" in targets else (-18, 18)))
        distance = rng.uniform(1.4, 2.4)
    azimuth, elevation = np.deg2rad([azimuth, rng.uniform(-4, 4)])
    flat = np.cos(elevation)
    ray = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    sight = T_world_lidar[:3, :3] @ ray
    R = _facing(rng, sight) if name == "board" else _leaning(rng, sight, LEANS[k % len(LEANS)])
    return pose(R, transform(T_world_lidar, distance * ray))


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
    reach = [scene.surfaces[scenes.index(scene, name)].radius for name in targets]
    return all(
        np.linalg.norm(T[a][:3, 3] - T[b][:3, 3]) > reach[i] + reach[j] + CLEAR_M
        for i, a in enumerate(targets)
        for j, b in enumerate(targets[:i])
    )


def _in_view(scene, rig, T, targets):
    T_world_surfaces = scenes.poses({name: T[name] for name in targets})
    T_world_lidar, T_world_camera = (T["robot"] @ rig.sensors[s] for s in ("velodyne", "camera"))
    return all(
        _lidar_sees(scene, T_world_surfaces, T_world_lidar, name) for name in targets
    ) and _camera_sees(scene, rig.camera, T_world_surfaces, T_world_camera, targets[0])


def _lidar_sees(scene, T_world_surfaces, T_world_lidar, name):
    """Whether 8 rings meet the board, 3 the cylinder, and nothing stands before it."""
    beams = lidars.pattern(np.deg2rad(100), COLUMNS_STEP).beams.reshape(-1, 16, 3)
    target = scenes.index(scene, name)
    pose_pair = (T_world_surfaces, T_world_lidar)
    alone = np.isfinite(scenes.cast(scene, *pose_pair, beams, [target])[0])
    seen = scene.surface[scenes.cast(scene, *pose_pair, beams)[1]] == target
    rings = np.sum(np.sum(seen, axis=0) >= 2)
    return rings >= (8 if name == "board" else 3) and np.array_equal(alone, seen)


def _camera_sees(scene, camera, T_world_surfaces, T_world_camera, name):
    """Whether the whole pattern, or axis, is in the image, unhidden, 12 px from its border."""
    T_camera_world = inverse(T_world_camera)
    p_camera = transform(T_camera_world @ T_world_surfaces[name], _marks(name))
    uv, ok = camera.project(p_camera)
    if not np.all(ok & camera.in_image(uv, 12)):
        return False
    label = scenes.cast(scene, T_world_surfaces, T_world_camera, p_camera)[1]
    return np.all(scene.surface[label] == scenes.index(scene, name))


def _marks(name):
    """Points (n, 3) of the target that the camera must see: corners of squares, or the axis."""
    spec = scenes.TARGETS[name]
    if name != "board":
        return np.linspace(-0.5, 0.5, 9)[:, None] * [spec["length_m"], 0, 0]
    pattern = spec["pattern"]
    x, y = (
        low + pattern["square_m"] * np.arange(-1, n + 1)
        for low, n in zip(pattern["first_corner_m"], pattern["inner_corners"], strict=True)
    )
    x, y = np.meshgrid(x, y)
    return np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)


def _order(drawn):
    """Order that goes from each placement to the nearest of those left: motions are slow."""
    left, order = list(range(1, len(drawn))), [0]
    while left:
        last = drawn[order[-1]]
        order.append(min(left, key=lambda k: _effort(last, drawn[k])))
        left.remove(order[-1])
    return order


def _effort(A, B):
    """Sum over bodies of metres and radians between two placements."""
    steps = [inverse(A[name]) @ B[name] for name in A]
    return sum(np.linalg.norm(S[:3, 3]) + angle(S) for S in steps)
