"""The edge between two colours to a fraction of a pixel, along the normals of an outline.

Pixels are (u, v) with (0, 0) at the centre of the top-left pixel; colours are BGR, grey levels.
"""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates

from calib.geometry.units import MAD_TO_SIGMA

PROFILE_REACH_PX = 11.0  # of a profile across the edge, to either side
PROFILE_STEP_PX = 0.5
# σ of Gaussians: over the image, and along the outline for its points and its normals.
IMAGE_SMOOTHING_PX, OUTLINE_SMOOTHING_PX, NORMAL_SMOOTHING_PX = 0.7, 2.0, 4.0
# Half the window whose area is compared, and the bands beside it that give the levels. The window
# moves until the edge is in its middle, so that blur wider than the window cancels.
EDGE_WINDOW_PX, LEVEL_BAND_PX = 2.0, (2.5, 8.5)
N_EDGE_ROUNDS = 5
MAX_EDGE_OFFSET_PX = 2.5  # from the outline to the edge; the bands must then be within reach
MAX_SHADING_SHARE = 0.2  # of its brightness by which a surface may darken towards its limb
MIN_NOISE_LEVELS = 0.3  # grey levels: rounding to whole ones
# The effect of noise of one grey level, measured on white noise: on the misfit of a line, and on
# the edge at a contrast of one. Neighbours share noise: a point alone scatters 0.6 times as much,
# but the mean of many scatters as stated here.
MISFIT_PER_NOISE, EDGE_SIGMA_PER_NOISE = 0.18, 2.7
MIN_CONTRAST_TO_NOISE = 4  # at this contrast noise moves an edge by 0.7 px
MAX_MISFIT_TO_CONTRAST = 0.005  # beside twice the misfit by noise
MIN_EDGE_SIGMA_PX = 0.03  # of a background that is not straight, or shading that is not grey
UNMEASURED_SIGMA_PX = 1.0
MAX_WIDTH_SIGMAS, MAX_WIDTH_MARGIN_PX = 4, 0.02  # off the usual width of an edge


class SubpixelEdges(NamedTuple):
    """Points of an edge.

    uv: (n, 2), px; normal: (n, 2), outward; sigma: (n,), px; is_measured: (n,). Points that were
    not measured lie at the usual distance from the outline, with UNMEASURED_SIGMA_PX.
    """

    uv: np.ndarray
    normal: np.ndarray
    sigma: np.ndarray
    is_measured: np.ndarray


def outline_normals(outline: np.ndarray) -> np.ndarray:
    """Return the outward unit normals (n, 2) of a closed chain of pixels (n, 2), smoothed."""
    u, v = outline.T
    orientation = np.sign(np.sum(u * np.roll(v, -1) - v * np.roll(u, -1)))
    along = gaussian_filter1d(outline, NORMAL_SMOOTHING_PX, axis=0, order=1, mode="wrap")
    normal = orientation * np.column_stack([along[:, 1], -along[:, 0]])
    return normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-9)[:, None]


def refine_outline(
    image: np.ndarray, outline: np.ndarray, normal: np.ndarray | None = None
) -> SubpixelEdges:
    """Return the edges of an image (h, w, 3) near an outline (n, 2), along its normals (n, 2).

    In a profile across the edge the levels inside and outside continue as straight lines to where
    their areas add up to the profile's own: blur and the pixels' size do not move that point.
    """
    normal = outline_normals(outline) if normal is None else normal
    # A base on whole pixels would always meet the pixel grid in the same phase, 0.3 px inside an
    # edge, and the error of the interpolation there would not average out: 0.03 px at 30°.
    base = gaussian_filter1d(outline, OUTLINE_SMOOTHING_PX, axis=0, mode="wrap")
    s = np.arange(-PROFILE_REACH_PX, PROFILE_REACH_PX + PROFILE_STEP_PX / 2, PROFILE_STEP_PX)
    colors = _sample_colors(image, base[:, None] + s[:, None] * normal[:, None])
    edges = _locate_edges(_project_colors(colors, s), s)
    noise = max(np.nanmedian(edges.misfit) / MISFIT_PER_NOISE, MIN_NOISE_LEVELS)
    is_measured = _is_single_edge(edges, noise)
    contrast = np.where(is_measured, edges.contrast, np.inf)
    sigma = np.hypot(noise * EDGE_SIGMA_PER_NOISE / contrast, MIN_EDGE_SIGMA_PX)
    usual = np.median(edges.offset_px[is_measured]) if is_measured.any() else 0.0
    uv = base + np.where(is_measured, edges.offset_px, usual)[:, None] * normal
    return SubpixelEdges(uv, normal, np.where(is_measured, sigma, UNMEASURED_SIGMA_PX), is_measured)


def _sample_colors(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Return the colours (n, k, 3) of an image (h, w, 3), a little smoothed, at uv (n, k, 2)."""
    low = np.maximum(np.floor(uv.min((0, 1))).astype(int) - 4, 0)
    high = np.maximum(np.ceil(uv.max((0, 1))).astype(int) + 5, 0)
    part = image[low[1] : high[1], low[0] : high[0]].astype(float)
    soft = np.moveaxis(cv2.GaussianBlur(part, (0, 0), IMAGE_SMOOTHING_PX), -1, 0)
    u, v = np.moveaxis(uv - low, -1, 0)
    return np.stack([map_coordinates(c, [v, u], order=1, cval=np.nan) for c in soft], -1)


def _project_colors(colors: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return the profiles (n, k) of colours (n, k, 3) on the direction that separates both sides.

    s: (k,) position across the edge, px. Shading, which changes brightness but not hue, counts as
    noise: against a background of another hue it hardly affects the profile. The direction is the
    optimum of Fisher's linear discriminant.
    """
    inside, outside = (
        colors[:, band].mean(1) for band in (s <= -LEVEL_BAND_PX[0], s >= LEVEL_BAND_PX[0])
    )
    change = outside - inside
    share = np.sum(inside * change, 1) / (
        np.sum(inside**2, 1) + (MIN_NOISE_LEVELS / MAX_SHADING_SHARE) ** 2
    )
    direction = change - share[:, None] * inside
    direction /= np.maximum(np.linalg.norm(direction, axis=1), 1e-9)[:, None]
    return np.einsum("nkc,nc->nk", colors, direction)


class _ProfileEdges(NamedTuple):
    """The edges of n profiles.

    offset_px: (n,) along the profile; contrast: (n,) there; misfit: (n, 2) rms of the lines through
    the levels inside and outside; width: (n,), px.
    """

    offset_px: np.ndarray
    contrast: np.ndarray
    misfit: np.ndarray
    width: np.ndarray


@np.errstate(divide="ignore", invalid="ignore")
def _locate_edges(profile: np.ndarray, s: np.ndarray) -> _ProfileEdges:
    """Find the edge of each profile (n, k).

    With o - i = c₀ + c₁ (s - m) in the window m ± W, the edge is where ∫ (o - p) = ∫ (o - i) up to
    it; m moves there. _project_colors makes the contrast positive.
    """
    m = np.zeros(len(profile))
    for _ in range(N_EDGE_ROUNDS):
        x = s - m[:, None]
        (i0, i1, i_rms), (o0, o1, o_rms) = _fit_level_line(profile, -x), _fit_level_line(profile, x)
        outside = o0[:, None] + o1[:, None] * x
        inside = i0[:, None] - i1[:, None] * x
        window = (
            np.clip((EDGE_WINDOW_PX - np.abs(x)) / PROFILE_STEP_PX + 0.5, 0, 1) * PROFILE_STEP_PX
        )
        c0, c1 = o0 - i0, o1 + i1
        step = (
            np.sum(window * (outside - profile), 1) + c1 * EDGE_WINDOW_PX**2 / 2
        ) / c0 - EDGE_WINDOW_PX
        m = np.clip(m + step, -MAX_EDGE_OFFSET_PX, MAX_EDGE_OFFSET_PX)
    width = np.sum(window * (outside - profile) * (profile - inside), 1) / c0**2
    return _ProfileEdges(m, c0, np.column_stack([i_rms, o_rms]), width)


def _fit_level_line(
    profile: np.ndarray, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit lines to profiles (n, k) in the band of x (n, k).

    Returns the level at x = 0, the slope and the rms misfit, each (n,).
    """
    w = np.clip((x - LEVEL_BAND_PX[0]) / PROFILE_STEP_PX + 0.5, 0, 1)
    w *= np.clip((LEVEL_BAND_PX[1] - x) / PROFILE_STEP_PX + 0.5, 0, 1)
    w /= np.sum(w, 1, keepdims=True)
    mean_x, mean_p = np.sum(w * x, 1), np.sum(w * profile, 1)
    dx, dp = x - mean_x[:, None], profile - mean_p[:, None]
    slope = np.sum(w * dx * dp, 1) / np.sum(w * dx * dx, 1)
    rms = np.sqrt(np.sum(w * (dp - slope[:, None] * dx) ** 2, 1))
    return mean_p - slope * mean_x, slope, rms


def _is_single_edge(edges: _ProfileEdges, noise: float) -> np.ndarray:
    """Return which profiles (n,) are one edge between two straight levels, as sharp as most."""
    is_single = np.abs(edges.offset_px) < MAX_EDGE_OFFSET_PX
    is_single &= edges.contrast > MIN_CONTRAST_TO_NOISE * noise
    max_misfit = 2 * MISFIT_PER_NOISE * noise + MAX_MISFIT_TO_CONTRAST * edges.contrast[:, None]
    is_single &= (edges.misfit < max_misfit).all(1)
    if not is_single.any():
        return is_single
    usual = np.median(edges.width[is_single])
    spread = MAD_TO_SIGMA * np.median(np.abs(edges.width[is_single] - usual))
    max_difference = MAX_WIDTH_SIGMAS * spread + MAX_WIDTH_MARGIN_PX
    return is_single & (np.abs(edges.width - usual) < max_difference)
