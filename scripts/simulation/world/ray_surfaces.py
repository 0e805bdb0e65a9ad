"""Compute exactly where rays meet the shapes of a scene.

A ray is o + t d in the frame of the shape, o and d (3, n). Every function of SHAPE_INTERSECTIONS
returns t (n,), infinite or NaN for a miss, and the face that is met (n,).
"""

from typing import Any, NamedTuple, Protocol

import numpy as np

SKY_FACE = 3  # face of the room above its walls: no return


class ShapeIntersection(Protocol):
    """A function that meets rays with one kind of shape."""

    def __call__(
        self, shape_params: Any, o: np.ndarray, d: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return t (n,) and face (n,) of rays o + t d, o and d (3, n)."""
        ...


class BoardParams(NamedTuple):
    """Shape of a board.

    normals (n, 2) and offsets (n,): half-planes normal · (x, y) ≤ offset of the outline; low, side
    and n_squares: low corner, side and numbers of the squares; half_size (2,) and warp (3,), m: the
    face is z = warp₀ (1 - u²) + warp₁ (1 - v²) + warp₂ u v, with (u, v) = (x, y) / half_size.
    """

    normals: np.ndarray
    offsets: np.ndarray
    low: tuple[float, ...]
    side: float
    n_squares: tuple[int, ...]
    half_size: np.ndarray
    warp: tuple[float, ...]


@np.errstate(divide="ignore", invalid="ignore")
def intersect_board(
    shape_params: BoardParams, o: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Meet a board with a convex outline; face 0 is the back, the squares follow."""
    low, side, count = shape_params.low, shape_params.side, shape_params.n_squares
    t, is_in_front = _meet_face(shape_params, o, d)
    x, y = o[0] + t * d[0], o[1] + t * d[1]
    inside = np.ones(t.shape, bool)
    for (nx, ny), offset in zip(shape_params.normals, shape_params.offsets, strict=True):
        inside &= nx * x + ny * y <= offset
    i = np.clip(np.floor((x - low[0]) / side), -1, count[0])
    j = np.clip(np.floor((y - low[1]) / side), -1, count[1])
    face = np.where(inside & is_in_front, i * (count[1] + 2) + (j + count[1] + 4), 0)
    return np.where(inside, t, np.inf), face.astype(np.int32)


def _meet_face(
    shape_params: BoardParams, o: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return t (n,) where rays meet the face, extended, and whether they come from before it (n,).

    Of the two places that a ray has in common with a curved face, the one that is nearest to where
    it would meet a flat one.
    """
    if not any(shape_params.warp):
        return -o[2] / d[2], o[2] > 0
    bow_x, bow_y, twist = shape_params.warp
    (u, v), (du, dv) = (p[:2] / shape_params.half_size[:, None] for p in (o, d))
    square = bow_x * du * du + bow_y * dv * dv - twist * du * dv
    linear = d[2] + 2 * bow_x * u * du + 2 * bow_y * v * dv - twist * (u * dv + v * du)
    height = o[2] - bow_x * (1 - u * u) - bow_y * (1 - v * v) - twist * u * v
    root = np.sqrt(linear * linear - 4 * square * height)
    t = -2 * height / (linear + np.copysign(root, linear))
    at_u, at_v = u + t * du, v + t * dv
    approach = (
        d[2] + 2 * bow_x * at_u * du + 2 * bow_y * at_v * dv - twist * (at_u * dv + at_v * du)
    )
    return t, approach < 0


@np.errstate(divide="ignore", invalid="ignore")
def intersect_cylinder(
    shape_params: tuple[float, float], o: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Meet a closed, centred cylinder about x from outside; faces: side, cap at -x, cap at +x.

    shape_params: length and radius, m.
    """
    half, radius = shape_params[0] / 2, shape_params[1]
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


def cylinder_side_normals(
    shape_params: tuple[float, float], o: np.ndarray, d: np.ndarray
) -> np.ndarray:
    """Return the outward normals (n, 3) where rays d (n, 3) from o (3,) meet a cylinder's side.

    Rays that miss it get the normal where they pass nearest.
    """
    radial = d[:, 1:]
    a, b = np.sum(radial**2, axis=1), radial @ o[1:]
    root = np.sqrt(np.maximum(b * b - a * (o[1:] @ o[1:] - shape_params[1] ** 2), 0))
    p = o[1:] + ((-b - root) / a)[:, None] * radial
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    return np.column_stack([np.zeros(len(d)), p])


@np.errstate(divide="ignore", invalid="ignore")
def intersect_box(
    shape_params: tuple[float, float, float], o: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Meet a box about its origin from outside; the face is the axis it is normal to.

    shape_params: half sizes, m.
    """
    reach = np.sign(d) * np.reshape(shape_params, (3, 1))
    enter, leave = (-reach - o) / d, (reach - o) / d
    near = np.max(enter, axis=0)
    return np.where(near <= np.min(leave, axis=0), near, np.inf), np.argmax(enter, axis=0)


@np.errstate(divide="ignore", invalid="ignore")
def intersect_room(
    shape_params: tuple[float, float, float, float], o: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Meet the room from inside; faces: floor, walls normal to x, walls normal to y, sky.

    shape_params: half sizes along x and y, heights of the ceiling and of the walls, m.
    """
    x, y, ceiling, wall = shape_params
    high, low = (np.reshape(side, (3, 1)) for side in ((x, y, ceiling), (-x, -y, 0.0)))
    leave = np.where(d == 0, np.inf, (np.where(d > 0, high, low) - o) / d)
    t = np.min(leave, axis=0)
    above = o[2] + t * d[2] > wall
    return t, np.where(above, SKY_FACE, np.array([1, 2, 0])[np.argmin(leave, axis=0)])


SHAPE_INTERSECTIONS: dict[str, ShapeIntersection] = {
    "board": intersect_board,
    "cylinder": intersect_cylinder,
    "box": intersect_box,
    "room": intersect_room,
}
