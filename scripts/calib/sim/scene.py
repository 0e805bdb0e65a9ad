"""The room, the targets and their stands as surfaces that rays meet exactly.

A surface lives in its own frame. A ray is o + t d there; the functions of KINDS take o and d (3, n)
and return t (n,), infinite or NaN for a miss, and the face met (n,). Nothing is tessellated.
A label numbers one face of one surface: squares of a checkerboard are faces, and its grid lines
run on across the margin, so that within a board every border between two labels is a whole line.
"""

from typing import NamedTuple

import numpy as np

from calib.geometry import inverse, pose, transform

WHITE, BLACK, GREEN, METAL = (200, 200, 200), (40, 40, 40), (60, 160, 50), (90, 90, 90)
TARGETS = {
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
ROOM = (6.0, 6.0, 4.0, 1.6)  # half sizes along x and y, ceiling, height of the walls, m
SKY = 3  # face of the room above its walls: no return
BOXES = {  # centre and half sizes, m, BGR; 5.1 m or more from the origin, where no target comes
    "crate": ((5.4, 1.3, 0.4), (0.3, 0.4, 0.4), (50, 60, 140)),
    "shelf": ((5.5, -1.6, 0.6), (0.3, 0.5, 0.6), (130, 80, 60)),
    "case": ((2.2, 5.3, 0.3), (0.4, 0.3, 0.3), (60, 110, 150)),
    "trunk": ((1.5, -5.4, 0.5), (0.5, 0.3, 0.5), (120, 60, 110)),
}
POLE_M, ARM_M, ROD_M = 2.5, 0.8, 0.25  # lengths; a pole goes on below the floor, unseen
BEHIND_M = 0.06  # from a board's face to its stand


class Surface(NamedTuple):
    """A surface: what its kind's intersection takes, the colours (faces, 3) of its faces (BGR, grey
    levels), the radius about its origin that holds it, m, and its sharp corners (n, 3), m."""

    name: str
    kind: str
    size: tuple
    colors: np.ndarray
    radius: float
    corners: np.ndarray


class Scene(NamedTuple):
    """Surfaces, the first label of each, and colour (labels, 3) and surface of each label."""

    surfaces: tuple
    first: np.ndarray
    colors: np.ndarray
    surface: np.ndarray


def build(targets):
    """Scene of the room with the targets of TARGETS so named and their stands."""
    surfaces = [_room(), *(_box(name) for name in BOXES)]
    for name in targets:
        surfaces += _target(name)
    faces = [len(s.colors) for s in surfaces]
    return Scene(
        tuple(surfaces),
        np.concatenate([[0], np.cumsum(faces)[:-1]]),
        np.concatenate([s.colors for s in surfaces]).astype(float),
        np.repeat(np.arange(len(surfaces)), faces),
    )


def index(scene, name):
    """Position of the surface so named."""
    return next(i for i, s in enumerate(scene.surfaces) if s.name == name)


def _room():
    colors = np.array([(95, 100, 105), (135, 135, 130), (120, 125, 125), (75, 70, 65)])
    return Surface("room", "room", ROOM, colors, np.inf, np.zeros((0, 3)))


def _box(name):
    _, half, color = BOXES[name]
    colors = np.outer([0.8, 1.0, 1.15], color)
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    return Surface(name, "box", half, colors, np.linalg.norm(half), signs * half)


def _rod(name, length, radius):
    size = (length, radius)
    reach = np.hypot(length / 2, radius)
    return Surface(name, "cylinder", size, np.tile(METAL, (3, 1)), reach, np.zeros((0, 3)))


def _target(name):
    spec = TARGETS[name]
    if spec["shape"] == "board":
        outline = np.array(spec["outline_m"])
        flat = np.column_stack([outline, np.zeros(len(outline))])
        reach = np.linalg.norm(outline, axis=1).max()
        board = Surface(name, "board", _board_size(spec), _board_colors(spec), reach, flat)
        return [board, _rod("board_arm", ARM_M, 0.015), _rod("board_pole", POLE_M, 0.02)]
    size = (spec["length_m"], spec["radius_m"])
    reach = np.hypot(size[0] / 2, size[1])
    colors = np.tile(GREEN, (3, 1))
    body = Surface(name, "cylinder", size, colors, reach, np.zeros((0, 3)))
    return [body, _rod("cylinder_rod", ROD_M, 0.015), _rod("cylinder_pole", POLE_M, 0.02)]


def _board_size(spec):
    """Outline's half-planes n · (x, y) ≤ c, low corner of the squares, side, and their numbers."""
    outline, pattern = np.array(spec["outline_m"]), spec["pattern"]
    along = np.roll(outline, -1, axis=0) - outline
    normals = np.column_stack([along[:, 1], -along[:, 0]])
    square = pattern["square_m"]
    low = tuple(c - square for c in pattern["first_corner_m"])
    count = tuple(c + 1 for c in pattern["inner_corners"])
    return normals, np.sum(normals * outline, axis=1), low, square, count


def _board_colors(spec):
    """The back, then the squares with one row of margin around, x before y."""
    nx, ny = (c + 1 for c in spec["pattern"]["inner_corners"])
    first = 0 if spec["pattern"]["first_square"] == "black" else 1
    colors = np.tile(WHITE, (nx + 2, ny + 2, 1))
    i, j = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    colors[1:-1, 1:-1][(i + j) % 2 == first] = BLACK
    return np.concatenate([[METAL], colors.reshape(-1, 3)])


def poses(T_world_targets):
    """T_world_surface (..., 4, 4) by name, from those of the targets (..., 4, 4) by name."""
    T = {"room": np.eye(4), **{name: pose(t=box[0]) for name, box in BOXES.items()}}
    for name, T_world_target in T_world_targets.items():
        T[name] = T_world_target
        T.update(_board_stand(T_world_target) if name == "board" else _rod_stand(T_world_target))
    return T


def _board_stand(T):
    """A horizontal arm that starts 6 cm behind the centre, and a pole below it, behind the face.

    Where the face looks down a pole under the centre would pierce it: it stands further back, so
    that it is 3 cm behind the face's plane down to 0.85 m below the centre, lower than the board.
    """
    normal = T[..., :3, 2]
    start = T[..., :3, 3] - BEHIND_M * normal
    flat = normal * [1, 1, 0]
    horizontal = np.linalg.norm(flat, axis=-1, keepdims=True)
    back = -flat / horizontal
    offset = np.clip((0.85 * -normal[..., 2:] - 0.03) / horizontal, 0, ARM_M)
    return {
        "board_arm": _along(back, start + back * ARM_M / 2),
        "board_pole": _pole(start + back * offset),
    }


def _rod_stand(T):
    """A rod out of the cap at -x, along the axis, and a pole below the rod's end."""
    half = TARGETS["cylinder"]["length_m"] / 2
    rod = T.copy()
    rod[..., :3, 3] = transform(T, [-half - ROD_M / 2, 0, 0])
    return {"cylinder_rod": rod, "cylinder_pole": _pole(transform(T, [-half - ROD_M, 0, 0]))}


def _pole(top):
    """Frame of a vertical pole that ends at top (..., 3)."""
    up = np.broadcast_to([0.0, 0.0, 1.0], top.shape)
    return _along(up, top - [0, 0, POLE_M / 2])


def _along(x, centre):
    """Frame at centre (..., 3) whose x axis is the unit vector x (..., 3)."""
    helper = np.where(np.abs(x[..., 2:]) > 0.9, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    y = np.cross(helper, x)
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return pose(np.stack([x, y, np.cross(x, y)], -1), centre)


def cast(scene, T_world_surfaces, T_world_sensor, d, only=None):
    """Distance t (..., n) along rays d (..., n, 3) to the nearest surface, and its label.

    T_world_surfaces by name and T_world_sensor are (4, 4) or (..., 4, 4), for rays that leave at
    different times. t counts lengths of d. `only` limits the scene to some of its surfaces.
    """
    t = np.full(d[..., 0].size, np.inf)
    label = np.zeros(len(t), np.int32)
    for i in range(len(scene.surfaces)) if only is None else only:
        surface = scene.surfaces[i]
        o, rays = _local(inverse(T_world_surfaces[surface.name]) @ T_world_sensor, d)
        where = _candidates(surface.radius, o, rays) if only is None else slice(None)
        near, face = KINDS[surface.kind](surface.size, o[..., where], rays[:, where])
        closer = (near > 0) & (near < t[where])
        if only is None:
            where = where[closer]
            t[where], label[where] = near[closer], scene.first[i] + face[closer]
        else:
            np.copyto(t, near, where=closer)
            np.copyto(label, scene.first[i] + face, where=closer)
    return t.reshape(d.shape[:-1]), label.reshape(d.shape[:-1])


def _local(T_surface_sensor, d):
    """Origins (3, 1 or n) and directions (3, n) of rays in the surface's frame."""
    R, o = T_surface_sensor[..., :3, :3], T_surface_sensor[..., :3, 3]
    if R.ndim == 2:
        return o[:, None].repeat(d[..., 0].size, 1), R @ d.reshape(-1, 3).T
    rays = np.moveaxis(d @ np.swapaxes(R, -1, -2), -1, 0).reshape(3, -1)
    return np.repeat(np.moveaxis(o, -1, 0).reshape(3, -1), d.shape[-2], axis=1), rays


def _candidates(radius, o, d):
    """Indices of the rays that meet the sphere about the surface."""
    if not np.isfinite(radius):
        return np.arange(d.shape[1])
    along = _dot(o, d)
    return np.flatnonzero((along < 0) & (along * along > (_dot(o, o) - radius**2) * _dot(d, d)))


def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@np.errstate(divide="ignore", invalid="ignore")
def meet_board(size, o, d):
    """A convex polygon in z = 0; face 0 is the back, the squares follow."""
    normals, offsets, low, square, count = size
    t = -o[2] / d[2]
    x, y = o[0] + t * d[0], o[1] + t * d[1]
    inside = np.ones(t.shape, bool)
    for (nx, ny), offset in zip(normals, offsets, strict=True):
        inside &= nx * x + ny * y <= offset
    i = np.clip(np.floor((x - low[0]) / square), -1, count[0])
    j = np.clip(np.floor((y - low[1]) / square), -1, count[1])
    face = np.where(inside & (o[2] > 0), i * (count[1] + 2) + (j + count[1] + 4), 0)
    return np.where(inside, t, np.inf), face.astype(np.int32)


@np.errstate(divide="ignore", invalid="ignore")
def meet_cylinder(size, o, d):
    """A closed cylinder about x, centred; faces: side, cap at -x, cap at +x. o lies outside."""
    half, radius = size[0] / 2, size[1]
    a = d[1] * d[1] + d[2] * d[2]
    b = o[1] * d[1] + o[2] * d[2]
    c = o[1] * o[1] + o[2] * o[2] - radius**2
    side = (-b - np.sqrt(b * b - a * c)) / a
    on_side = np.abs(o[0] + side * d[0]) <= half
    sign = -np.sign(d[0])
    cap = (sign * half - o[0]) / d[0]
    on_cap = (o[1] + cap * d[1]) ** 2 + (o[2] + cap * d[2]) ** 2 <= radius**2
    t = np.where(on_side, side, np.where(on_cap, cap, np.inf))
    return t, np.where(on_side, 0, np.where(sign < 0, 1, 2))


@np.errstate(divide="ignore", invalid="ignore")
def meet_box(half, o, d):
    """A box about its origin, from outside; the face is the axis it is normal to."""
    reach = np.sign(d) * np.reshape(half, (3, 1))
    enter, leave = (-reach - o) / d, (reach - o) / d
    near = np.max(enter, axis=0)
    return np.where(near <= np.min(leave, axis=0), near, np.inf), np.argmax(enter, axis=0)


@np.errstate(divide="ignore", invalid="ignore")
def meet_room(size, o, d):
    """The room from inside; faces: floor, walls normal to x, to y, what is above them."""
    x, y, ceiling, wall = size
    high, low = (np.reshape(side, (3, 1)) for side in ((x, y, ceiling), (-x, -y, 0.0)))
    leave = np.where(d == 0, np.inf, (np.where(d > 0, high, low) - o) / d)
    t = np.min(leave, axis=0)
    above = o[2] + t * d[2] > wall
    return t, np.where(above, SKY, np.array([1, 2, 0])[np.argmin(leave, axis=0)])


KINDS = {"board": meet_board, "cylinder": meet_cylinder, "box": meet_box, "room": meet_room}
