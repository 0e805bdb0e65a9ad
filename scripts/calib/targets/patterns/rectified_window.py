"""The pixels around corners, in coordinates in which a lens bends no line."""

from dataclasses import dataclass

import numpy as np

from calib.targets.patterns.image_region import ImageRegion

MAX_REACH_SHARE = 0.7  # of the way to the next corners that is used
NEXT_EDGE_CLEARANCE_PX = 2.5  # from the next edges, which must not be in the window
EDGE_BAND_PX = 4.0  # beside an edge that is used; farther in, the light may differ from the edge's
MAX_REACH_PX = 16
MIN_RAY_COSINE = 0.2  # cosine to the corner's ray
POLYNOMIAL_NODES = np.stack(np.meshgrid(*[np.linspace(-1, 1, 5)] * 2), -1).reshape(-1, 2)
POLYNOMIAL_POWERS = [(i, j) for i in range(5) for j in range(5 - i)]
CONSTANT_TERM, X_TERM, Y_TERM = (POLYNOMIAL_POWERS.index(p) for p in ((0, 0), (1, 0), (0, 1)))


@dataclass(frozen=True)
class CornerWindow:
    """The k pixels around each of n corners, in the tangent plane at the corner's ray.

    grey, weight: (n, k) grey level and 0 or 1; tangent_xy: (2, n, k) position in the tangent plane,
    px at the corner; tangent_jacobian: (2, 2, n, k) its slopes by the pixel's u and v; origin:
    (n, 3) and axes: (n, 2, 3), the ray of x, y is origin + (x, y) · axes; is_valid: (n,) whether
    the lens model holds all around the corner.
    """

    grey: np.ndarray
    weight: np.ndarray
    tangent_xy: np.ndarray
    tangent_jacobian: np.ndarray
    origin: np.ndarray
    axes: np.ndarray
    is_valid: np.ndarray

    def select_corners(self, rows: np.ndarray) -> "CornerWindow":
        """Return the window of those corners."""
        return CornerWindow(
            grey=self.grey[rows],
            weight=self.weight[rows],
            tangent_xy=self.tangent_xy[:, rows],
            tangent_jacobian=self.tangent_jacobian[:, :, rows],
            origin=self.origin[rows],
            axes=self.axes[rows],
            is_valid=self.is_valid[rows],
        )

    def to_rays(self, tangent_xy: np.ndarray) -> np.ndarray:
        """Return the rays (n, 3) of one position (n, 2) per corner."""
        return self.origin + np.einsum("na,nai->ni", tangent_xy, self.axes)


def cut_corner_window(
    region: ImageRegion, uv: np.ndarray, along: np.ndarray, across: np.ndarray
) -> CornerWindow:
    """Return the window about pixels uv (n, 2) of a region.

    along, across (n, 2): vectors to the next corners, px. Used are the pixels near the two edges,
    up to where the next edges come near.
    """
    pixels, is_used = _select_pixels(region.grey.shape, uv, along, across)
    used_first = np.argsort(~is_used, axis=1, kind="stable")[:, : is_used.sum(1).max()]
    pixels = np.take_along_axis(pixels, used_first[..., None], 1)
    weight = np.take_along_axis(is_used, used_first, 1).astype(float)
    pixels = np.where(weight[..., None] > 0, pixels, np.rint(uv).astype(int)[:, None])
    h, w = region.grey.shape
    u, v = np.clip(np.moveaxis(pixels, -1, 0), 0, np.reshape([w - 1, h - 1], (2, 1, 1)))
    grey = region.grey[v, u].astype(float)
    return _rectify_window(region, uv, pixels - uv[:, None], grey=grey, weight=weight)


def _select_pixels(
    shape: tuple[int, ...], uv: np.ndarray, along: np.ndarray, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels (n, k, 2) of a box around each corner, and which are used (n, k)."""
    reach = np.ceil(MAX_REACH_SHARE * (np.abs(along) + np.abs(across)).max(0)) + 1
    reach = np.minimum(reach, MAX_REACH_PX).astype(int)
    steps = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in reach)), -1).reshape(-1, 2)
    pixels = np.rint(uv).astype(int)[:, None] + steps
    basis = np.stack([along, across], -1)
    cells = np.abs((pixels - uv[:, None]) @ np.swapaxes(np.linalg.inv(basis), 1, 2))
    # From the corner's lines to those through the next corners, px.
    line_gap = np.abs(np.linalg.det(basis))[:, None] / np.linalg.norm(basis, axis=1)[:, ::-1]
    farthest = np.minimum(MAX_REACH_SHARE, 1 - NEXT_EDGE_CLEARANCE_PX / line_gap)[:, None]
    is_used = (cells < farthest).all(-1) & ((cells * line_gap[:, None]).min(-1) < EDGE_BAND_PX)
    return pixels, is_used & (pixels >= 0).all(-1) & (pixels < shape[::-1]).all(-1)


def _rectify_window(
    region: ImageRegion,
    uv: np.ndarray,
    offsets: np.ndarray,
    *,
    grey: np.ndarray,
    weight: np.ndarray,
) -> CornerWindow:
    """Return the window of the pixels at offsets (n, k, 2) from uv (n, 2).

    Exact at 25 nodes about each corner, by a polynomial of the fourth degree between them.
    """
    n, size = len(uv), np.abs(offsets).max()
    rays, is_valid = region.unproject((uv[:, None] + size * POLYNOMIAL_NODES).reshape(-1, 2))
    rays, is_valid = rays.reshape(n, -1, 3), np.all(is_valid.reshape(n, -1), axis=1)
    origin = rays[:, len(POLYNOMIAL_NODES) // 2]
    axes = _tangent_axes(origin)
    depth = np.einsum("nki,ni->nk", rays, origin)
    is_valid &= (depth > MIN_RAY_COSINE).all(1)
    flat = rays @ np.swapaxes(axes, 1, 2) / np.maximum(depth, MIN_RAY_COSINE)[..., None]
    terms = np.linalg.pinv(_monomials(POLYNOMIAL_NODES)) @ flat
    J = np.stack([terms[:, X_TERM], terms[:, Y_TERM]], -1) / size
    is_valid &= np.abs(np.linalg.det(J)) > 1e-12
    J = np.where(is_valid[:, None, None], J, np.eye(2))
    terms = terms @ np.swapaxes(np.linalg.inv(J), 1, 2)
    terms[:, CONSTANT_TERM] = 0
    slopes = [np.moveaxis(p @ terms, -1, 0) for p in _monomial_slopes(offsets / size)]
    return CornerWindow(
        grey=grey,
        weight=weight,
        tangent_xy=np.moveaxis(_monomials(offsets / size) @ terms, -1, 0),
        tangent_jacobian=np.stack(slopes, 1) / size,
        origin=origin,
        axes=np.swapaxes(J, 1, 2) @ axes,
        is_valid=is_valid,
    )


def _tangent_axes(rays: np.ndarray) -> np.ndarray:
    """Return two unit axes (n, 2, 3) perpendicular to unit rays (n, 3)."""
    least_parallel = np.eye(3)[np.abs(rays).argmin(1)]
    first = np.cross(rays, least_parallel)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(rays, first)], 1)


def _monomials(xy: np.ndarray) -> np.ndarray:
    """Return the terms (..., 15) of the polynomial at xy (..., 2)."""
    x, y = xy[..., 0], xy[..., 1]
    return np.stack([x**i * y**j for i, j in POLYNOMIAL_POWERS], -1)


def _monomial_slopes(xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the slopes (..., 15) of the terms by x and by y at xy (..., 2)."""
    x, y = xy[..., 0], xy[..., 1]
    by_x = np.stack([i * x ** max(i - 1, 0) * y**j for i, j in POLYNOMIAL_POWERS], -1)
    by_y = np.stack([j * x**i * y ** max(j - 1, 0) for i, j in POLYNOMIAL_POWERS], -1)
    return by_x, by_y
