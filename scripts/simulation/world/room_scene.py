"""The room, the targets and their stands as exact surfaces; nothing is tessellated.

A label is the number of one face of one surface. The squares of a checkerboard are faces, and its
grid lines continue across the margin, so every border between two labels of a board is a whole
line.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from calib.geometry.se3 import make_pose, transform_points
from simulation.world.ray_surfaces import BoardParams

WHITE, BLACK, GREEN, METAL = (200, 200, 200), (40, 40, 40), (60, 160, 50), (90, 90, 90)
SIMULATED_TARGETS: dict[str, dict[str, Any]] = {
    "board": {
        "body": "mocap/board",
        "shape": "board",
        "outline_m": [[0.7071, 0.0], [0.0, 0.7071], [-0.7071, 0.0], [0.0, -0.7071]],
        "pattern": {
            "kind": "checkerboard",
            "inner_corners": [6, 5],
            "square_m": 0.08,
            "first_corner_m": [-0.20, -0.16],
            "first_square": "black",
        },
    },
    "cylinder": {
        "body": "mocap/cylinder",
        "shape": "cylinder",
        "length_m": 0.8,
        "radius_m": 0.1,
        "color": {"hue_deg": [90, 150], "saturation": [0.3, 1], "value": [0.15, 1]},
    },
}
ROOM_SIZE_M = (6.0, 6.0, 4.0, 1.6)  # half sizes along x and y, ceiling, height of the walls, m
BOXES: dict[
    str, tuple[tuple[float, ...], tuple[float, ...], tuple[int, ...]]
] = {  # centre and half sizes, m, BGR; 5.1 m or more from the origin, where no target comes
    "crate": ((5.4, 1.3, 0.4), (0.3, 0.4, 0.4), (50, 60, 140)),
    "shelf": ((5.5, -1.6, 0.6), (0.3, 0.5, 0.6), (130, 80, 60)),
    "case": ((2.2, 5.3, 0.3), (0.4, 0.3, 0.3), (60, 110, 150)),
    "trunk": ((1.5, -5.4, 0.5), (0.5, 0.3, 0.5), (120, 60, 110)),
}
POLE_M, ARM_M, ROD_M = 2.5, 0.8, 0.25  # lengths; a pole goes on below the floor, unseen
STAND_OFFSET_M = 0.06  # from a board's face to its stand


class SceneSurface(NamedTuple):
    """A surface with the parameters that SHAPE_INTERSECTIONS[shape] takes.

    colors (faces, 3): BGR, grey levels; bounding_radius_m: of the sphere about its origin that
    holds it; corners_m (n, 3): its sharp corners.
    """

    name: str
    shape: str
    shape_params: tuple[Any, ...]
    colors: np.ndarray
    bounding_radius_m: float
    corners_m: np.ndarray


class SimulatedScene(NamedTuple):
    """Surfaces with the first label of each; colour (labels, 3) and surface index of each label."""

    surfaces: tuple[SceneSurface, ...]
    first_labels: np.ndarray
    label_colors: np.ndarray
    label_surfaces: np.ndarray


def build_scene(
    targets: Iterable[str],
    size_factor: float = 1.0,
    board_warp: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> SimulatedScene:
    """Build the room with targets of SIMULATED_TARGETS and their stands.

    size_factor: built size of the targets over the size that SIMULATED_TARGETS states. board_warp:
    bow along x and along y and twist of boards, m, as BoardParams has them.
    """
    surfaces = [_make_room(), *(_make_box(name) for name in BOXES)]
    for name in targets:
        surfaces += _make_target_surfaces(name, size_factor, board_warp)
    faces = [len(s.colors) for s in surfaces]
    return SimulatedScene(
        tuple(surfaces),
        np.concatenate([[0], np.cumsum(faces)[:-1]]),
        np.concatenate([s.colors for s in surfaces]).astype(float),
        np.repeat(np.arange(len(surfaces)), faces),
    )


def find_surface_index(scene: SimulatedScene, surface_name: str) -> int:
    """Return the index of a surface."""
    return next(i for i, s in enumerate(scene.surfaces) if s.name == surface_name)


def _make_room() -> SceneSurface:
    colors = np.array([(95, 100, 105), (135, 135, 130), (120, 125, 125), (75, 70, 65)])
    return SceneSurface("room", "room", ROOM_SIZE_M, colors, np.inf, np.zeros((0, 3)))


def _make_box(name: str) -> SceneSurface:
    _, half, color = BOXES[name]
    colors = np.outer([0.8, 1.0, 1.15], color)
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    return SceneSurface(name, "box", half, colors, float(np.linalg.norm(half)), signs * half)


def _make_rod(name: str, length: float, radius: float) -> SceneSurface:
    size = (length, radius)
    reach = np.hypot(length / 2, radius)
    return SceneSurface(name, "cylinder", size, np.tile(METAL, (3, 1)), reach, np.zeros((0, 3)))


def _make_target_surfaces(
    name: str, size_factor: float, board_warp: tuple[float, ...]
) -> list[SceneSurface]:
    """Make a target and the rods of its stand."""
    spec = SIMULATED_TARGETS[name]
    if spec["shape"] == "board":
        board = _make_board(name, spec, size_factor, board_warp)
        return [board, _make_rod("board_arm", ARM_M, 0.015), _make_rod("board_pole", POLE_M, 0.02)]
    size = (size_factor * spec["length_m"], size_factor * spec["radius_m"])
    reach = np.hypot(size[0] / 2, size[1])
    colors = np.tile(GREEN, (3, 1))
    body = SceneSurface(name, "cylinder", size, colors, reach, np.zeros((0, 3)))
    return [body, _make_rod("cylinder_rod", ROD_M, 0.015), _make_rod("cylinder_pole", POLE_M, 0.02)]


def _make_board(
    name: str, spec: dict[str, Any], size_factor: float, warp: tuple[float, ...]
) -> SceneSurface:
    params = _board_shape_params(spec, size_factor, warp)
    outline = size_factor * np.array(spec["outline_m"])
    u, v = (outline / params.half_size).T
    z = warp[0] * (1 - u * u) + warp[1] * (1 - v * v) + warp[2] * u * v
    reach = np.linalg.norm(outline, axis=1).max() + np.abs(warp).sum()
    corners = np.column_stack([outline, z])
    return SceneSurface(name, "board", params, _board_colors(spec), reach, corners)


def _board_shape_params(
    spec: dict[str, Any], size_factor: float, warp: tuple[float, ...]
) -> BoardParams:
    outline, pattern = size_factor * np.array(spec["outline_m"]), spec["pattern"]
    along = np.roll(outline, -1, axis=0) - outline
    normals = np.column_stack([along[:, 1], -along[:, 0]])
    square = size_factor * pattern["square_m"]
    return BoardParams(
        normals=normals,
        offsets=np.sum(normals * outline, axis=1),
        low=tuple(size_factor * c - square for c in pattern["first_corner_m"]),
        side=square,
        n_squares=tuple(c + 1 for c in pattern["inner_corners"]),
        half_size=np.ptp(outline, axis=0) / 2,
        warp=warp,
    )


def _board_colors(spec: dict[str, Any]) -> np.ndarray:
    """Return the colour of the back, then of the squares with one row of margin, x before y."""
    nx, ny = (c + 1 for c in spec["pattern"]["inner_corners"])
    first = 0 if spec["pattern"]["first_square"] == "black" else 1
    colors = np.tile(WHITE, (nx + 2, ny + 2, 1))
    i, j = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    colors[1:-1, 1:-1][(i + j) % 2 == first] = BLACK
    return np.concatenate([[METAL], colors.reshape(-1, 3)])


def visibility_points(target_name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3), m, target frame, that a camera must see, and the normals there (n, 3).

    They are the corners of a board's squares, or on a cylinder's side up to its ends.
    """
    spec = SIMULATED_TARGETS[target_name]
    if target_name != "board":
        along = np.linspace(-0.49, 0.49, 9) * spec["length_m"]
        x, a = (g.ravel() for g in np.meshgrid(along, np.deg2rad(np.arange(0, 360, 30))))
        normal = np.stack([np.zeros_like(a), np.cos(a), np.sin(a)], -1)
        return np.stack([x, *(spec["radius_m"] * normal[:, 1:].T)], -1), normal
    pattern = spec["pattern"]
    x, y = (
        low + pattern["square_m"] * np.arange(-1, n + 1)
        for low, n in zip(pattern["first_corner_m"], pattern["inner_corners"], strict=True)
    )
    x, y = (g.ravel() for g in np.meshgrid(x, y))
    return np.stack([x, y, np.zeros_like(x)], -1), np.tile([0.0, 0.0, 1.0], (len(x), 1))


def place_surfaces(T_world_targets: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return T_world_surface (..., 4, 4) by name from T_world_target (..., 4, 4) by name."""
    T = {"room": np.eye(4), **{name: make_pose(t=box[0]) for name, box in BOXES.items()}}
    for name, T_world_target in T_world_targets.items():
        T[name] = T_world_target
        T.update(
            _board_stand_poses(T_world_target)
            if name == "board"
            else _cylinder_stand_poses(T_world_target)
        )
    return T


def _board_stand_poses(T: np.ndarray) -> dict[str, np.ndarray]:
    """Place a horizontal arm that starts 6 cm behind the centre, and a pole below it.

    If the face looks down, a pole under the centre would pierce it. Then the pole is further back:
    3 cm behind the face's plane down to 0.85 m below the centre, lower than the board.
    """
    normal = T[..., :3, 2]
    start = T[..., :3, 3] - STAND_OFFSET_M * normal
    flat = normal * [1, 1, 0]
    horizontal = np.linalg.norm(flat, axis=-1, keepdims=True)
    back = -flat / horizontal
    offset = np.clip((0.85 * -normal[..., 2:] - 0.03) / horizontal, 0, ARM_M)
    return {
        "board_arm": _frame_along_axis(back, start + back * ARM_M / 2),
        "board_pole": _pole_pose(start + back * offset),
    }


def _cylinder_stand_poses(T: np.ndarray) -> dict[str, np.ndarray]:
    """Place a rod out of the cap at -x, along the axis, and a pole below the rod's end."""
    half = SIMULATED_TARGETS["cylinder"]["length_m"] / 2
    rod = T.copy()
    rod[..., :3, 3] = transform_points(T, [-half - ROD_M / 2, 0, 0])
    return {
        "cylinder_rod": rod,
        "cylinder_pole": _pole_pose(transform_points(T, [-half - ROD_M, 0, 0])),
    }


def _pole_pose(top: np.ndarray) -> np.ndarray:
    """Return the pose (..., 4, 4) of a vertical pole that ends at top (..., 3)."""
    up = np.broadcast_to([0.0, 0.0, 1.0], top.shape)
    return _frame_along_axis(up, top - [0, 0, POLE_M / 2])


def _frame_along_axis(x: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return a pose (..., 4, 4) at centre (..., 3) whose x axis is the unit vector x (..., 3)."""
    helper = np.where(np.abs(x[..., 2:]) > 0.9, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    y = np.cross(helper, x)
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return make_pose(np.stack([x, y, np.cross(x, y)], -1), centre)
