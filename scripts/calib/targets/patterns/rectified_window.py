"""The pixels around corners, in coordinates in which a lens bends no line."""

from dataclasses import dataclass

import numpy as np

MAX_REACH_SHARE = 0.7  # of the way to the next corners that is looked at
NEXT_EDGE_CLEARANCE_PX = 2.5  # from the next edges, which must not be seen
EDGE_BAND_PX = (
    4.0  # beside an edge that is looked at; farther in, light need not be as it is at the edge
)
MAX_REACH_PX = 16
MIN_RAY_COSINE = 0.2  # cosine to the corner's ray
POLYNOMIAL_NODES = np.stack(np.meshgrid(*[np.linspace(-1, 1, 5)] * 2), -1).reshape(-1, 2)
POLYNOMIAL_POWERS = [(i, j) for i in range(5) for j in range(5 - i)]
CONSTANT_TERM, X_TERM, Y_TERM = (POLYNOMIAL_POWERS.index(p) for p in ((0, 0), (1, 0), (0, 1)))


@dataclass(frozen=True)
class CornerWindow:
    """Per corner (n,) and pixel (k,): grey level and weight, 0 or 1, (n, k); place x, y (2, n, k)
    in the tangent plane at the corner's ray, in px at the corner; its slopes by the pixel's u and v
    (2, 2, n, k). origin (n, 3) and axes (n, 2, 3): the ray of x, y is origin + (x, y) · axes.
    ok (n,): whether the lens model holds all around the corner."""

    grey: np.ndarray
    weight: np.ndarray
    tangent_xy: np.ndarray
    tangent_jacobian: np.ndarray
    origin: np.ndarray
    axes: np.ndarray
    is_valid: np.ndarray

    def select_corners(self, rows):
        """The Window of those corners."""
        return CornerWindow(
            self.grey[rows],
            self.weight[rows],
            self.tangent_xy[:, rows],
            self.tangent_jacobian[:, :, rows],
            self.origin[rows],
            self.axes[rows],
            self.is_valid[rows],
        )

    def to_rays(self, place):
        """Rays (n, 3) of places (n, 2)."""
        return self.origin + np.einsum("na,nai->ni", place, self.axes)


def cut_corner_window(region, uv, along, across):
    """The Window about pixels uv (n, 2) of a Region; along and across (n, 2): the ways to the next
    corners, px. Used are the pixels near the two edges, up to where the next edges come near."""
    pixels, used = _select_pixels(region.grey.shape, uv, along, across)
    first = np.argsort(~used, axis=1, kind="stable")[:, : used.sum(1).max()]
    pixels = np.take_along_axis(pixels, first[..., None], 1)
    weight = np.take_along_axis(used, first, 1).astype(float)
    pixels = np.where(weight[..., None] > 0, pixels, np.rint(uv).astype(int)[:, None])
    h, w = region.grey.shape
    u, v = np.clip(np.moveaxis(pixels, -1, 0), 0, np.reshape([w - 1, h - 1], (2, 1, 1)))
    grey = region.grey[v, u].astype(float)
    return CornerWindow(grey, weight, *_rectify_pixels(region, uv, pixels - uv[:, None]))


def _select_pixels(shape, uv, along, across):
    """Pixels (n, k, 2) of a box around each corner, and which of them are used (n, k)."""
    reach = np.ceil(MAX_REACH_SHARE * (np.abs(along) + np.abs(across)).max(0)) + 1
    reach = np.minimum(reach, MAX_REACH_PX).astype(int)
    steps = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in reach)), -1).reshape(-1, 2)
    pixels = np.rint(uv).astype(int)[:, None] + steps
    basis = np.stack([along, across], -1)
    cells = np.abs((pixels - uv[:, None]) @ np.swapaxes(np.linalg.inv(basis), 1, 2))
    # From the corner's lines to those through the next corners, px.
    apart = np.abs(np.linalg.det(basis))[:, None] / np.linalg.norm(basis, axis=1)[:, ::-1]
    farthest = np.minimum(MAX_REACH_SHARE, 1 - NEXT_EDGE_CLEARANCE_PX / apart)[:, None]
    used = (cells < farthest).all(-1) & ((cells * apart[:, None]).min(-1) < EDGE_BAND_PX)
    return pixels, used & (pixels >= 0).all(-1) & (pixels < shape[::-1]).all(-1)


def _rectify_pixels(region, uv, away):
    """place, slope, origin, axes and ok of a Window for the pixels (n, k, 2) away from uv (n, 2).

    Exact at 25 nodes about each corner, by a polynomial of the fourth degree between them.
    """
    n, size = len(uv), np.abs(away).max()
    rays, ok = region.unproject((uv[:, None] + size * POLYNOMIAL_NODES).reshape(-1, 2))
    rays, ok = rays.reshape(n, -1, 3), ok.reshape(n, -1).all(1)
    origin = rays[:, len(POLYNOMIAL_NODES) // 2]
    least = np.eye(3)[np.abs(origin).argmin(1)]
    first = np.cross(origin, least)
    first /= np.linalg.norm(first, axis=1)[:, None]
    axes = np.stack([first, np.cross(origin, first)], 1)
    depth = np.einsum("nki,ni->nk", rays, origin)
    ok &= (depth > MIN_RAY_COSINE).all(1)
    flat = rays @ np.swapaxes(axes, 1, 2) / np.maximum(depth, MIN_RAY_COSINE)[..., None]
    terms = np.linalg.pinv(_monomials(POLYNOMIAL_NODES)) @ flat
    J = np.stack([terms[:, X_TERM], terms[:, Y_TERM]], -1) / size
    ok &= np.abs(np.linalg.det(J)) > 1e-12
    J = np.where(ok[:, None, None], J, np.eye(2))
    terms = terms @ np.swapaxes(np.linalg.inv(J), 1, 2)
    terms[:, CONSTANT_TERM] = 0
    powers, slopes = _monomials(away / size), _monomial_slopes(away / size)
    place = np.moveaxis(powers @ terms, -1, 0)
    slope = np.stack([np.moveaxis(p @ terms, -1, 0) for p in slopes], 1) / size
    return place, slope, origin, np.swapaxes(J, 1, 2) @ axes, ok


def _monomials(at):
    x, y = at[..., 0], at[..., 1]
    return np.stack([x**i * y**j for i, j in POLYNOMIAL_POWERS], -1)


def _monomial_slopes(at):
    x, y = at[..., 0], at[..., 1]
    by_x = np.stack([i * x ** max(i - 1, 0) * y**j for i, j in POLYNOMIAL_POWERS], -1)
    by_y = np.stack([j * x**i * y ** max(j - 1, 0) for i, j in POLYNOMIAL_POWERS], -1)
    return by_x, by_y
