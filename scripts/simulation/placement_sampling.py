"""Draw placements of robot and targets in which the right sensors see every target well."""

from collections.abc import Mapping, Sequence
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
from calib.sensors.camera.camera_model import CameraModel
from simulation.sensor_mounts import BuiltRig
from simulation.sensors.scan_patterns import coarse_beam_directions
from simulation.simulated_rigs import PlacementLayout, SimulatedLidar, TargetSpot
from simulation.world.ray_casting import PosedScene, cast_rays
from simulation.world.room_scene import (
    SimulatedScene,
    find_surface_index,
    place_surfaces,
    visibility_points,
)

ROBOT_HEIGHT_M = 0.35
MIN_CLEARANCE_M = 0.6  # between the spheres around two targets
N_TRIES = 2000  # draws of one placement
IMAGE_BORDER_PX = 12  # free around a target
# Of a cylinder's axis: upright, flat, oblique.
CYLINDER_ELEVATIONS_DEG = ((75, 90), (0, 15), (30, 60))
R_CAMERA_FORWARD = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # from forward, left, up


BodyPoses = Mapping[str, np.ndarray]  # T_world_body (4, 4) of robot and targets by name


class SimulatedPlacements(NamedTuple):
    """T_world_body (n, 4, 4) of robot and targets by name, and the layout (n,) of placements."""

    placement_poses: dict[str, np.ndarray]
    layout_index: np.ndarray

    @property
    def time_slots(self) -> np.ndarray:
        """Slots of time (n,); one stays free where the layout changes and the way is long."""
        return np.arange(len(self.layout_index)) + np.cumsum(
            np.diff(self.layout_index, prepend=self.layout_index[0]) != 0
        )


class PlacementSettings(NamedTuple):
    """What placements are drawn for; is_upright: robot and targets turn about the vertical only."""

    scene: SimulatedScene
    rig: BuiltRig
    layouts: Sequence[PlacementLayout]
    is_upright: bool = False


def draw_placements(
    rng: np.random.Generator, settings: PlacementSettings, n_placements: int
) -> SimulatedPlacements:
    """Draw placements, layout after layout, those of a layout in an order of small steps."""
    drawn = [_draw_placement(rng, settings, k) for k in range(n_placements)]
    layout_index = np.arange(n_placements) % len(settings.layouts)
    order = _order_placements(drawn, layout_index)
    return SimulatedPlacements(
        {name: np.stack([drawn[k][name] for k in order]) for name in drawn[0]},
        layout_index[order],
    )


def _draw_placement(
    rng: np.random.Generator, settings: PlacementSettings, placement_index: int
) -> dict[str, np.ndarray]:
    """Draw T_world_body (4, 4) by body until all targets are seen as the layout wants."""
    n_layouts = len(settings.layouts)
    spots = settings.layouts[placement_index % n_layouts]
    elevation_deg = CYLINDER_ELEVATIONS_DEG[
        placement_index // n_layouts % len(CYLINDER_ELEVATIONS_DEG)
    ]
    for _ in range(N_TRIES):
        T = {"robot": _draw_robot_pose(rng)}
        for name, spot in spots.items():
            T_world_forward = T["robot"] @ _T_robot_forward(settings.rig, spot.sensor)
            T[name] = _draw_target_pose(rng, T_world_forward, name, spot, elevation_deg)
        if settings.is_upright:
            T = {name: _turn_upright(name, pose) for name, pose in T.items()}
        if _has_clearance(settings.scene, T, list(spots)) and _is_in_view(settings, T, spots):
            return T
    raise ValueError(
        f"no placement of {', '.join(spots)} in {N_TRIES} draws is seen by the sensors of layout "
        f"{placement_index % n_layouts}: widen its spots"
    )


def _draw_robot_pose(rng: np.random.Generator) -> np.ndarray:
    xyz = rng.uniform([-0.1, -0.1, -0.01], [0.1, 0.1, 0.01]) + [0, 0, ROBOT_HEIGHT_M]
    return pose_from_rpy(xyz, np.deg2rad(rng.uniform([-1, -1, -5], [1, 1, 5])))


def _turn_upright(name: str, T: np.ndarray) -> np.ndarray:
    """Turn a pose the shortest way to where the body's vertical axis is that of the room.

    The vertical axis is z of the robot, y of a board, x of a cylinder.
    """
    axis = {"robot": 2, "board": 1, "cylinder": 0}[name]
    up = T[:3, axis]
    turn = np.cross(up, [0, 0, 1.0])
    size = np.linalg.norm(turn)
    R = so3_exp(turn / max(size, 1e-12) * np.arctan2(size, up[2]))
    return make_pose(R @ T[:3, :3], T[:3, 3])


def _T_robot_forward(rig: BuiltRig, sensor: str) -> np.ndarray:
    """Return T_robot_sensor (4, 4) with axes forward, left, up."""
    T = rig.T_robot_sensor[sensor]
    return T @ make_pose(R_CAMERA_FORWARD) if sensor in rig.camera_models else T


def _draw_target_pose(
    rng: np.random.Generator,
    T_world_forward: np.ndarray,
    name: str,
    spot: TargetSpot,
    axis_elevation_deg: tuple[float, float],
) -> np.ndarray:
    """Draw T_world_target (4, 4) at a spot.

    A board faces the sensor; the axis of a cylinder rises within axis_elevation_deg.
    """
    azimuth_deg, distance = rng.uniform(*spot.azimuth_deg), rng.uniform(*spot.distance_m)
    azimuth, elevation = np.deg2rad([azimuth_deg, rng.uniform(*spot.elevation_deg)])
    flat = np.cos(elevation)
    ray = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    sight = T_world_forward[:3, :3] @ ray
    R = (
        _draw_board_rotation(rng, sight)
        if name == "board"
        else _draw_cylinder_rotation(rng, sight, axis_elevation_deg)
    )
    return make_pose(R, transform_points(T_world_forward, distance * ray))


def _draw_board_rotation(rng: np.random.Generator, view_direction: np.ndarray) -> np.ndarray:
    """Draw a rotation (3, 3) whose normal is within 35° of -view_direction, rolled by up to 30°."""
    around, tilt = rng.uniform(0, 2 * np.pi), np.deg2rad(35) * np.sqrt(rng.uniform())
    right = np.cross(view_direction, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    axis = np.cos(around) * right + np.sin(around) * np.cross(right, view_direction)
    normal = so3_exp(tilt * axis) @ -view_direction
    x = np.cross([0, 0, 1.0], normal)
    x /= np.linalg.norm(x)
    upright = np.stack([x, np.cross(normal, x), normal], -1)
    return upright @ so3_exp([0, 0, np.deg2rad(rng.uniform(-30, 30))])


def _draw_cylinder_rotation(
    rng: np.random.Generator, view_direction: np.ndarray, elevation_deg: tuple[float, float]
) -> np.ndarray:
    """Draw a rotation (3, 3) whose axis rises within elevation_deg, 40° or more off the view."""
    while True:
        rise, azimuth = np.deg2rad(rng.uniform(*elevation_deg)), rng.uniform(-np.pi, np.pi)
        x = np.array([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)])
        if abs(x @ view_direction) < np.cos(np.deg2rad(40)):
            break
    y = np.cross(view_direction, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], -1) @ so3_exp([np.deg2rad(rng.uniform(-30, 30)), 0, 0])


def _has_clearance(scene: SimulatedScene, T: BodyPoses, targets: Sequence[str]) -> bool:
    """Return whether the spheres around the targets leave MIN_CLEARANCE_M between them."""
    radius = [scene.surfaces[find_surface_index(scene, name)].bounding_radius_m for name in targets]
    return all(
        np.linalg.norm(T[a][:3, 3] - T[b][:3, 3]) > radius[i] + radius[j] + MIN_CLEARANCE_M
        for i, a in enumerate(targets)
        for j, b in enumerate(targets[:i])
    )


def _is_in_view(settings: PlacementSettings, T: BodyPoses, spots: PlacementLayout) -> bool:
    """Return whether all sensors that should see the targets do."""
    T_world_surfaces = place_surfaces({name: T[name] for name in spots})
    for name, spot in spots.items():
        for sensor in spot.visible_to:
            T_world_sensor = T["robot"] @ settings.rig.T_robot_sensor[sensor]
            posed = PosedScene(settings.scene, T_world_surfaces, T_world_sensor)
            if not is_target_visible(posed, settings.rig, sensor, name):
                return False
    return True


def is_target_visible(posed: PosedScene, rig: BuiltRig, sensor: str, target_name: str) -> bool:
    """Return whether the sensor of a posed scene sees a target well."""
    if sensor in rig.camera_models:
        return _is_visible_to_camera(posed, rig.camera_models[sensor], target_name)
    return _is_visible_to_lidar(posed, rig.lidar_spec(sensor), target_name)


def _is_visible_to_lidar(posed: PosedScene, spec: SimulatedLidar, name: str) -> bool:
    """Return whether enough rings, 2° apart, meet a target and nothing is before it.

    Enough are 8 for a board, 3 for a cylinder, or all if the lidar has fewer.
    """
    beams = coarse_beam_directions(spec.scan_pattern, np.deg2rad(spec.sector_deg))
    target = find_surface_index(posed.scene, name)
    hits_if_alone = np.isfinite(cast_rays(posed, beams, [target])[0])
    hits = posed.scene.label_surfaces[cast_rays(posed, beams)[1]] == target
    n_rings = np.sum(np.sum(hits, axis=0) >= 2)
    n_enough = min(8 if name == "board" else 3, beams.shape[1])
    return bool(n_rings >= n_enough and np.array_equal(hits_if_alone, hits))


def _is_visible_to_camera(posed: PosedScene, camera: CameraModel, name: str) -> bool:
    """Return whether the whole pattern, or cylinder, is in the image and not hidden."""
    p, normal = visibility_points(name)
    T_camera_target = invert_pose(posed.T_world_sensor) @ posed.T_world_surfaces[name]
    p_camera = transform_points(T_camera_target, p)
    uv, is_valid = camera.project(p_camera)
    if not np.all(is_valid & camera.is_in_image(uv, IMAGE_BORDER_PX)):
        return False
    toward = np.sum(normal @ T_camera_target[:3, :3].T * p_camera, axis=1)
    rays = p_camera[toward < -0.2 * np.linalg.norm(p_camera, axis=1)]
    surface = posed.scene.label_surfaces[cast_rays(posed, rays)[1]]
    return bool(np.all(surface == find_surface_index(posed.scene, name)))


def _order_placements(placements: Sequence[BodyPoses], layout_index: np.ndarray) -> list[int]:
    """Order layout by layout, each time to the nearest open placement: motions are slow."""
    open_ones, order = set(range(1, len(placements))), [0]
    while open_ones:
        same_layout = [k for k in open_ones if layout_index[k] == layout_index[order[-1]]]
        first_layout = min(layout_index[k] for k in open_ones)
        candidates = same_layout or [k for k in open_ones if layout_index[k] == first_layout]
        order.append(
            min(candidates, key=lambda k: (_motion_length(placements[order[-1]], placements[k]), k))
        )
        open_ones.remove(order[-1])
    return order


def _motion_length(A: BodyPoses, B: BodyPoses) -> float:
    """Return the sum over bodies of metres and radians between two placements."""
    steps = [invert_pose(A[name]) @ B[name] for name in A]
    return sum(np.linalg.norm(S[:3, 3]) + rotation_angle(S) for S in steps)
