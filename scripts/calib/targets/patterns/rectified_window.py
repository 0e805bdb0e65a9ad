"""The pixels around corners, in coordinates in which a lens bends no line."""

from dataclasses import dataclass

import numpy as np

REACH = 0.7  # of the way to the next corners that is looked at
CLEAR_PX = 2.5  # from the next edges, which must not be seen
BAND_PX = (
    4.0  # beside an edge that is looked at; farther in, light need not be as it is at the edge
)
FARTHEST_PX = 16
SMALLEST_DEPTH = 0.2  # cosine to the corner's ray
NODES = np.stack(np.meshgrid(*[np.linspace(-1, 1, 5)] * 2), -1).reshape(-1, 2)
POWERS = [(i, j) for i in range(5) for j in range(5 - i)]
ONE, BY_X, BY_Y = (POWERS.index(p) for p in ((0, 0), (1, 0), (0, 1)))


@dataclass(frozen=True)
class Window:
    """Per corner (n,) and pixel (k,): grey level and weight, 0 or 1, (n, k); place x, y (2, n, k)
    in the tangent plane at the corner's ray, in px at the corner; its slopes by the pixel's u and v
    (2, 2, n, k). origin (n, 3) and axes (n, 2, 3): the ray of x, y is origin + (x, y) · axes.
    ok (n,): whether the lens model holds all around the corner."""

    grey: np.ndarray
    weight: np.ndarray
    place: np.ndarray
    slope: np.ndarray
    origin: np.ndarray
    axes: np.ndarray
    ok: np.ndarray

    def part(self, rows):
        """The Window of those corners."""
        return Window(
            self.grey[rows],
            self.weight[rows],
            self.place[:, rows],
            self.slope[:, :, rows],
            self.origin[rows],
            self.axes[rows],
            self.ok[rows],
        )

    def rays(self, place):
        """Rays (n, 3) of places (n, 2)."""
        return self.origin + np.einsum("na,nai->ni", place, self.axes)


def around(region, uv, along, across):
    """The Window about pixels uv (n, 2) of a Region; along and across (n, 2): the ways to the next
    corners, px. Used are the pixels near the two edges, up to where the next edges come near."""
    pixels, used = _pixels(region.grey.shape, uv, along, across)
    first = np.argsort(~used, axis=1, kind="stable")[:, : used.sum(1).max()]
    pixels = np.take_along_axis(pixels, first[..., None], 1)
    weight = np.take_along_axis(used, first, 1).astype(float)
    pixels = np.where(weight[..., None] > 0, pixels, np.rint(uv).astype(int)[:, None])
    h, w = region.grey.shape
    u, v = np.clip(np.moveaxis(pixels, -1, 0), 0, np.reshape([w - 1, h - 1], (2, 1, 1)))
    grey = region.grey[v, u].astype(float)
    return Window(grey, weight, *_rectified(region, uv, pixels - uv[:, None]))


def _pixels(shape, uv, along, across):
    """Pixels (n, k, 2) of a box around each corner, and which of them are used (n, k)."""
    reach = np.ceil(REACH * (np.abs(along) + np.abs(across)).max(0)) + 1
    reach = np.minimum(reach, FARTHEST_PX).astype(int)
    steps = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in reach)), -1).reshape(-1, 2)
    pixels = np.rint(uv).astype(int)[:, None] + steps
    basis = np.stack([along, across], -1)
    cells = np.abs((pixels - uv[:, None]) @ np.swapaxes(np.linalg.inv(basis), 1, 2))
    # From the corner's lines to those through the next corners, px.
    apart = np.abs(np.linalg.det(basis))[:, None] / np.linalg.norm(basis, axis=1)[:, ::-1]
    farthest = np.minimum(REACH, 1 - CLEAR_PX / apart)[:, None]
    used = (cells < farthest).all(-1) & ((cells * apart[:, None]).min(-1) < BAND_PX)
    return pixels, used & (pixels >= 0).all(-1) & (pixels < shape[::-1]).all(-1)


def _rectified(region, uv, away):
    """place, slope, origin, axes and ok of a Window for the pixels (n, k, 2) away from uv (n, 2).

    Exact at 25 nodes about each corner, by a polynomial of the fourth degree between them.
    """
    n, size = len(uv), np.abs(away).max()
    rays, ok = region.unproject((uv[:, None] + size * NODES).reshape(-1, 2))
    rays, ok = rays.reshape(n, -1, 3), ok.reshape(n, -1).all(1)
    origin = rays[:, len(NODES) // 2]
    least = np.eye(3)[np.abs(origin).argmin(1)]
    first = np.cross(origin, least)
    first /= np.linalg.norm(first, axis=1)[:, None]
    axes = np.stack([first, np.cross(origin, first)], 1)
    depth = np.einsum("nki,ni->nk", rays, origin)
    ok &= (depth > SMALLEST_DEPTH).all(1)
    flat = rays @ np.swapaxes(axes, 1, 2) / np.maximum(depth, SMALLEST_DEPTH)[..., None]
    terms = np.linalg.pinv(_powers(NODES)) @ flat
    J = np.stack([terms[:, BY_X], terms[:, BY_Y]], -1) / size
    ok &= np.abs(np.linalg.det(J)) > 1e-12
    J = np.where(ok[:, None, None], J, np.eye(2))
    terms = terms @ np.swapaxes(np.linalg.inv(J), 1, 2)
    terms[:, ONE] = 0
    powers, slopes = _powers(away / size), _slopes(away / size)
    place = np.moveaxis(powers @ terms, -1, 0)
    slope = np.stack([np.moveaxis(p @ terms, -1, 0) for p in slopes], 1) / size
    return place, slope, origin, np.swapaxes(J, 1, 2) @ axes, ok


def _powers(at):
    x, y = at[..., 0], at[..., 1]
    return np.stack([x**i * y**j for i, j in POWERS], -1)


def _slopes(at):
    x, y = at[..., 0], at[..., 1]
    by_x = np.stack([i * x ** max(i - 1, 0) * y**j for i, j in POWERS], -1)
    by_y = np.stack([j * x**i * y ** max(j - 1, 0) for i, j in POWERS], -1)
    return by_x, by_y
