"""Where two straight edges cross: a model of the grey levels around a corner, fitted to them.

Two flat levels, in light that may fall off to one side, meet in two straight lines, seen through
the pixel's square and a Gaussian blur; the lines are straight in the tangent plane at the corner's
ray, whatever the lens. Nine unknowns a corner: place, direction of either line, blur, mean, saddle
(half the contrast) and the light's slopes. It reaches the Cramér-Rao bound on exact images.

Four free levels instead of the slopes are as good in even light, but where light falls to half over
five squares they are up to 0.25 px off at single corners, and this 0.008 px (rms).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from calib.targets.patterns.image_region import ImageRegion
from calib.targets.patterns.rectified_window import CornerWindow, cut_corner_window

# Columns of the parameters: pixels, angles of the two lines, variance of the blur, levels, slopes.
X, Y, FIRST, SECOND, BLUR2, MEAN, SADDLE, LIGHT_X, LIGHT_Y = range(9)
N_PARAMETERS = 9
MAX_PARAMETER_STEP = np.array([2, 2, 0.3, 0.3, 0.5, 255, 255, 0.02, 0.02])
MIN_BLUR2_PX2 = 0.05**2  # a smaller blur cannot be seen beside the pixel's own width
INITIAL_BLUR2_PX2 = 0.5**2
MIN_WINDOW_PIXELS = 40
MAX_UNIT_VARIANCE_PX2 = 0.1  # for noise of one grey level; above it there is no contrast
MAX_FIT_STEPS = 15
STEP_TOLERANCE_SHARE = 5e-4  # of MAX_PARAMETER_STEP; a fit with smaller steps has converged
MAX_DAMPING = 1e6
MAX_CORNER_SHIFT_SHARE = 0.3  # of the spacing; a fit that moves farther has found something else


@dataclass(frozen=True)
class CornerFit:
    """The edge model fitted to n corners.

    uv: (n, 2) pixels of the region; covariance: (n, 2, 2), px², for independent noise of one grey
    level; rms: (n,) of the residuals, grey levels; saddle: (n,) half the contrast, grey levels,
    positive where light lies ahead in both directions; is_valid: (n,) whether the fit converged
    near its start.
    """

    uv: np.ndarray
    covariance: np.ndarray
    rms: np.ndarray
    saddle: np.ndarray
    is_valid: np.ndarray


def fit_corner_edges(
    region: ImageRegion, uv: np.ndarray, along: np.ndarray, across: np.ndarray
) -> CornerFit:
    """Fit the corners near pixels uv (n, 2) of a region, good to about a pixel.

    along, across (n, 2): vectors, px, to the next corners in the two directions of the grid.
    """
    is_finite = np.isfinite(np.concatenate([uv, along, across], 1)).all(1)
    is_finite &= np.abs(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]) > 1
    uv, along, across = (
        np.where(is_finite[:, None], values, placeholder)
        for values, placeholder in ((uv, (0, 0)), (along, (10, 0)), (across, (0, 10)))
    )
    window = cut_corner_window(region, uv, along, across)
    p = _initial_parameters(window, along, across)
    p, r, J, has_converged = _run_levenberg_marquardt(window, p)
    count = window.weight.sum(1)
    has_pixels = count >= MIN_WINDOW_PIXELS
    covariance = _corner_covariance(J, has_pixels)
    found, is_valid = region.project(window.to_rays(p[:, :2]))
    spacing = np.minimum(np.linalg.norm(along, axis=1), np.linalg.norm(across, axis=1))
    is_valid &= is_finite & has_converged & has_pixels & window.is_valid
    is_valid &= np.trace(covariance, axis1=1, axis2=2) < MAX_UNIT_VARIANCE_PX2
    is_valid &= np.linalg.norm(found - uv, axis=1) < MAX_CORNER_SHIFT_SHARE * spacing
    rms = np.sqrt((r * r).sum(1) / np.maximum(count - N_PARAMETERS, 1))
    return CornerFit(found, covariance, rms, p[:, SADDLE], is_valid)


def _corner_covariance(J: np.ndarray, has_pixels: np.ndarray) -> np.ndarray:
    """Return the covariance (n, 2, 2), px², of corners from Jacobians (n, k, 9), at unit noise."""
    information = np.swapaxes(J, 1, 2) @ J
    information[~has_pixels] = np.eye(N_PARAMETERS)
    # A sharp edge says nothing of its blur, and a flat patch nothing at all.
    information += 1e-9 * np.eye(N_PARAMETERS)
    return np.linalg.inv(information)[:, :2, :2]


def _initial_parameters(window: CornerWindow, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return parameters (n, 9): at the seed, along its sides, a little blurred, fitted levels."""
    p = np.zeros((len(along), N_PARAMETERS))
    turn = np.sign(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0])
    # The normals of the two edges point across and along.
    p[:, FIRST] = np.arctan2(turn * along[:, 0], -turn * along[:, 1])
    p[:, SECOND] = np.arctan2(-turn * across[:, 0], turn * across[:, 1])
    p[:, BLUR2] = INITIAL_BLUR2_PX2
    r, J = _edge_residuals(window, p)
    levels = J[..., MEAN : SADDLE + 1]
    A = np.swapaxes(levels, 1, 2) @ levels + 1e-9 * np.eye(2)
    p[:, MEAN : SADDLE + 1] = -np.linalg.solve(A, np.swapaxes(levels, 1, 2) @ r[..., None])[..., 0]
    return p


def _run_levenberg_marquardt(
    window: CornerWindow, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Run the method of Levenberg and Marquardt for all corners at once, until none moves.

    Returns parameters (n, 9), residuals (n, k), Jacobians (n, k, 9), and which converged (n,).
    """
    r, J = _edge_residuals(window, p)
    cost, damping = (r * r).sum(1), np.full(len(p), 1e-3)
    active = np.arange(len(p))
    for _ in range(MAX_FIT_STEPS):
        step = _damped_step(p[active], r[active], J[active], damping[active])
        trial = p[active] + step
        trial[:, BLUR2] = np.maximum(trial[:, BLUR2], MIN_BLUR2_PX2)
        r_trial, J_trial = _edge_residuals(window.select_corners(active), trial)
        cost_trial = (r_trial * r_trial).sum(1)
        is_better = cost_trial <= cost[active]
        rows = active[is_better]
        p[rows], r[rows], J[rows] = trial[is_better], r_trial[is_better], J_trial[is_better]
        cost[rows] = cost_trial[is_better]
        damping[active] *= np.where(is_better, 0.1, 10)
        is_moving = (np.abs(step) > STEP_TOLERANCE_SHARE * MAX_PARAMETER_STEP).any(1)
        active = active[is_moving & (damping[active] < MAX_DAMPING)]
        if not len(active):
            break
    has_converged = damping < MAX_DAMPING
    has_converged[active] = False
    return p, r, J, has_converged


def _damped_step(p: np.ndarray, r: np.ndarray, J: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Return the clipped steps (n, 9); a blur at its lower bound is kept if it would decrease."""
    A = np.swapaxes(J, 1, 2) @ J
    diagonal = np.einsum("nmm->nm", A) + 1e-9
    A[:, range(N_PARAMETERS), range(N_PARAMETERS)] += damping[:, None] * diagonal + 1e-9
    slope = np.swapaxes(J, 1, 2) @ r[..., None]
    is_at_bound = (p[:, BLUR2] <= MIN_BLUR2_PX2) & (slope[:, BLUR2, 0] > 0)
    A[is_at_bound, BLUR2, BLUR2] = 1e30
    step = -np.linalg.solve(A, slope)[..., 0]
    return np.clip(step, -MAX_PARAMETER_STEP, MAX_PARAMETER_STEP)


def _edge_residuals(window: CornerWindow, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals (n, k), model minus grey level, and Jacobians (n, k, 9)."""
    S, by_S = _line_side(window, p, FIRST)
    U, by_U = _line_side(window, p, SECOND)
    mean, saddle, light_x, light_y = p[:, MEAN:].T[..., None]
    x, y = window.tangent_xy
    light = 1 + light_x * x + light_y * y
    flat = mean + saddle * S * U
    to_S, to_U = saddle * U * light, saddle * S * light
    J = np.empty((*S.shape, N_PARAMETERS))
    for column, slope_S, slope_U in zip((X, Y, BLUR2), by_S[1:], by_U[1:], strict=True):
        J[..., column] = to_S * slope_S + to_U * slope_U
    J[..., FIRST], J[..., SECOND] = to_S * by_S[0], to_U * by_U[0]
    J[..., MEAN], J[..., SADDLE] = light, S * U * light
    J[..., LIGHT_X], J[..., LIGHT_Y] = flat * x, flat * y
    J *= window.weight[..., None]
    r = flat * light - window.grey
    return r * window.weight, J


def _line_side(
    window: CornerWindow, p: np.ndarray, line: int
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Return the side (n, k) of a line, -1 to 1, smooth between, and its slopes (n, k).

    line: column of its angle, FIRST or SECOND. The slopes are by angle, x, y and blur².
    """
    nx, ny = np.cos(p[:, line, None]), np.sin(p[:, line, None])
    x, y = window.tangent_xy[0] - p[:, X, None], window.tangent_xy[1] - p[:, Y, None]
    # The normal as the pixels have it, whose squares the lens distorts.
    nu, nv = nx * window.tangent_jacobian[0] + ny * window.tangent_jacobian[1]
    size = np.sqrt(nu * nu + nv * nv)
    d = (x * nx + y * ny) / size
    E, slope, bend = _pixel_edge_response(
        d, np.abs(nu / size), np.abs(nv / size), p[:, BLUR2, None]
    )
    push = 2 * slope / size
    return 2 * E - 1, (push * (y * nx - x * ny), -push * nx, -push * ny, bend)


def _pixel_edge_response(
    d: np.ndarray, c: np.ndarray, s: np.ndarray, blur2: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the share of a pixel's light from beyond an edge, its slope and its bend by d.

    d: distance from the edge, px; c, s: absolute parts of its normal, which are the widths of the
    two boxes that make up the pixel's square as seen along the edge; blur2: variance of the
    Gaussian, px².
    """
    b = np.sqrt(blur2)
    value, slope, bend = (d > 0).astype(float), np.zeros_like(d), np.zeros_like(d)
    # Beyond the pixel's half diagonal and six sigma nothing is left of the edge.
    is_near = np.abs(d) < np.sqrt(0.5) + 6 * b
    d, c, s, b = d[is_near], c[is_near], s[is_near], np.broadcast_to(b, is_near.shape)[is_near]
    wide, narrow = np.maximum(c, s), np.maximum(np.minimum(c, s), 1e-3)
    area = wide * narrow
    value_near, slope_near, bend_near = np.zeros((3, *d.shape))
    outer, inner = (wide + narrow) / 2, (wide - narrow) / 2
    for sign, shift in ((1, outer), (-1, inner), (-1, -inner), (1, -outer)):
        x = d + shift
        z = x / b
        P = ndtr(z)
        G = x * P + b / np.sqrt(2 * np.pi) * np.exp(-0.5 * z * z)
        value_near = value_near + sign * 0.5 * (x * G + b * b * P)
        slope_near = slope_near + sign * G
        bend_near = bend_near + sign * P
    value[is_near], slope[is_near] = value_near / area, slope_near / area
    bend[is_near] = bend_near / area
    return value, slope, bend
