"""The edge between two colours to a fraction of a pixel, along the normals of an outline.

Pixels are (u, v) with (0, 0) at the centre of the top-left pixel; colours are BGR, grey levels.
"""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates

from calib.geometry.units import MAD_TO_SIGMA

PROFILE_REACH_PX, PROFILE_STEP_PX = (
    11.0,
    0.5,
)  # of a profile across the edge, and between its samples
IMAGE_SMOOTHING_PX, OUTLINE_SMOOTHING_PX, NORMAL_SMOOTHING_PX = (
    0.7,
    2.0,
    4.0,
)  # Gaussians: the image; along the outline
# Half the window whose area is compared, and the bands beside it that give the levels. The window
# moves until the edge is in its middle, so that blur wider than it cancels.
EDGE_WINDOW_PX, LEVEL_BAND_PX = 2.0, (2.5, 8.5)
N_EDGE_ROUNDS = 5
MAX_EDGE_OFFSET_PX = 2.5  # from the outline to the edge; the bands must then be within reach
MAX_SHADING_SHARE = (
    0.2  # share of its own brightness by which a surface may darken towards its limb
)
MIN_NOISE_LEVELS = 0.3  # grey levels: rounding to whole ones
# What noise of one grey level does, measured on white noise: to the misfit of a line, and to the
# edge at a contrast of one. Neighbours share noise: a point alone scatters 0.6 times as much, but
# the mean of many goes by this.
MISFIT_PER_NOISE, EDGE_SIGMA_PER_NOISE = 0.18, 2.7
MIN_CONTRAST_TO_NOISE = 4  # times the noise: 0.7 px
MIN_EDGE_SIGMA_PX = 0.03  # background that is not straight, shading that is not grey


class SubpixelEdges(NamedTuple):
    """Points uv (n, 2) of an edge, px, its outward normals (n, 2), sigma (n,), px, and which were
    measured (n,): the others, sigma 1 px, lie where the outline does, as far off as is usual."""

    uv: np.ndarray
    normal: np.ndarray
    sigma: np.ndarray
    is_measured: np.ndarray


def outline_normals(outline):
    """Outward unit normals (n, 2) of a closed chain of pixels (n, 2), smoothed over some 10."""
    u, v = outline.T
    turn = np.sign(np.sum(u * np.roll(v, -1) - v * np.roll(u, -1)))
    along = gaussian_filter1d(outline, NORMAL_SMOOTHING_PX, axis=0, order=1, mode="wrap")
    normal = turn * np.column_stack([along[:, 1], -along[:, 0]])
    return normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-9)[:, None]


def refine_outline(image, outline, normal=None):
    """Edges of an image (h, w, 3) near an outline (n, 2), along its normals.

    In a profile across the edge the levels inside and outside continue as straight lines to where
    their areas add up to the profile's own: blur and the pixels' size do not move that point.
    """
    normal = outline_normals(outline) if normal is None else normal
    # A base on whole pixels would meet the lattice always in the same phase, 0.3 px inside an
    # edge, and what the interpolation gets wrong there would not average out: 0.03 px at 30°.
    base = gaussian_filter1d(outline, OUTLINE_SMOOTHING_PX, axis=0, mode="wrap")
    s = np.arange(-PROFILE_REACH_PX, PROFILE_REACH_PX + PROFILE_STEP_PX / 2, PROFILE_STEP_PX)
    profile = _project_colors(
        _sample_colors(image, base[:, None] + s[:, None] * normal[:, None]), s
    )
    e, contrast, misfit, width = _locate_edge(profile, s)
    noise = max(np.nanmedian(misfit) / MISFIT_PER_NOISE, MIN_NOISE_LEVELS)
    settled = _is_single_edge(e, contrast, misfit, width, noise)
    sigma = np.hypot(
        noise * EDGE_SIGMA_PER_NOISE / np.where(settled, contrast, np.inf), MIN_EDGE_SIGMA_PX
    )
    usual = np.median(e[settled]) if settled.any() else 0.0
    uv = base + np.where(settled, e, usual)[:, None] * normal
    return SubpixelEdges(uv, normal, np.where(settled, sigma, 1.0), settled)


def _sample_colors(image, uv):
    """Colours (n, k, 3) of an image (h, w, 3), a little smoothed, at uv (n, k, 2), px."""
    low = np.maximum(np.floor(uv.min((0, 1))).astype(int) - 4, 0)
    high = np.maximum(np.ceil(uv.max((0, 1))).astype(int) + 5, 0)
    part = image[low[1] : high[1], low[0] : high[0]].astype(float)
    soft = np.moveaxis(cv2.GaussianBlur(part, (0, 0), IMAGE_SMOOTHING_PX), -1, 0)
    u, v = np.moveaxis(uv - low, -1, 0)
    return np.stack([map_coordinates(c, [v, u], order=1, cval=np.nan) for c in soft], -1)


def _project_colors(colors, s):
    """Profiles (n, k) of colours (n, k, 3) on the direction that tells outside from inside.

    What shading changes, brightness but not hue, counts as noise there: against a background of
    another hue the profile hardly sees it. It is the optimum of Fisher's linear discriminant.
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


@np.errstate(divide="ignore", invalid="ignore")
def _locate_edge(profile, s):
    """Edge e (n,), px along the profiles (n, k), contrast there, rms misfit (n, 2) of the lines
    through the levels inside and outside, and width (n,), px, of the edge.

    With o - i = c₀ + c₁ (s - m) in the window m ± W, the edge is where ∫ (o - p) = ∫ (o - i) up to
    it; m moves there. Contrast is positive: `_project` sees to it.
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
    return m, c0, np.column_stack([i_rms, o_rms]), width


def _fit_level_line(profile, x):
    """Level at x = 0, slope and rms misfit (n,) of the lines through profiles (n, k) in the band
    of x (n, k)."""
    w = np.clip((x - LEVEL_BAND_PX[0]) / PROFILE_STEP_PX + 0.5, 0, 1)
    w *= np.clip((LEVEL_BAND_PX[1] - x) / PROFILE_STEP_PX + 0.5, 0, 1)
    w /= np.sum(w, 1, keepdims=True)
    mean_x, mean_p = np.sum(w * x, 1), np.sum(w * profile, 1)
    dx, dp = x - mean_x[:, None], profile - mean_p[:, None]
    slope = np.sum(w * dx * dp, 1) / np.sum(w * dx * dx, 1)
    rms = np.sqrt(np.sum(w * (dp - slope[:, None] * dx) ** 2, 1))
    return mean_p - slope * mean_x, slope, rms


def _is_single_edge(offset_px, contrast, misfit, width, noise):
    """Which profiles (n,) are one edge between two straight levels, as sharp as most others."""
    good = (np.abs(offset_px) < MAX_EDGE_OFFSET_PX) & (contrast > MIN_CONTRAST_TO_NOISE * noise)
    good &= (misfit < 2 * MISFIT_PER_NOISE * noise + 0.005 * contrast[:, None]).all(1)
    if not good.any():
        return good
    usual = np.median(width[good])
    spread = MAD_TO_SIGMA * np.median(np.abs(width[good] - usual))
    return good & (np.abs(width - usual) < 4 * spread + 0.02)
