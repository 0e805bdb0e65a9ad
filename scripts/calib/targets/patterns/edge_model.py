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

from calib.targets.patterns.rectified_window import cut_corner_window

X, Y, FIRST, SECOND, BLUR2, MEAN, SADDLE, LIGHT_X, LIGHT_Y = range(9)
MAX_PARAMETER_STEP = np.array(
    [2, 2, 0.3, 0.3, 0.5, 255, 255, 0.02, 0.02]
)  # of a step, in their units
MIN_BLUR2_PX2 = 0.05**2  # px², of the blur: beside the pixel's own width none is seen below
INITIAL_BLUR2_PX2 = 0.5**2
MIN_WINDOW_PIXELS = 40  # pixels
MAX_UNIT_VARIANCE_PX2 = 0.1  # px², for noise of one grey level: there is no contrast to speak of
MAX_FIT_STEPS, STEP_TOLERANCE_SHARE, MAX_DAMPING = (
    15,
    5e-4,
    1e6,
)  # settled: of the largest step, in every unknown
MAX_CORNER_SHIFT_SHARE = 0.3  # of the spacing: what moves farther has found something else


@dataclass(frozen=True)
class CornerFit:
    """Per corner: the region's pixel (n, 2); its covariance (n, 2, 2), px², for independent noise
    of one grey level; rms (n,), grey levels, of what the model leaves; saddle (n,), half the
    contrast, grey levels, positive where light lies ahead in both directions; whether the fit
    settled near its start (n,)."""

    uv: np.ndarray
    covariance: np.ndarray
    rms: np.ndarray
    saddle: np.ndarray
    is_valid: np.ndarray


def fit_corner_edges(region, uv, along, across):
    """Fit of the corners near pixels uv (n, 2) of a Region, good to about a pixel.

    along, across (n, 2): the ways, px, to the next corners in the two directions of the grid.
    """
    whole = np.isfinite(np.concatenate([uv, along, across], 1)).all(1)
    whole &= np.abs(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]) > 1
    uv, along, across = (
        np.where(whole[:, None], given, instead)
        for given, instead in ((uv, (0, 0)), (along, (10, 0)), (across, (0, 10)))
    )
    around = cut_corner_window(region, uv, along, across)
    p = _initial_parameters(around, along, across)
    p, r, J, settled = _run_levenberg_marquardt(around, p)
    information = np.swapaxes(J, 1, 2) @ J
    count = around.weight.sum(1)
    seen = count >= MIN_WINDOW_PIXELS
    information[~seen] = np.eye(len(MAX_PARAMETER_STEP))
    # A sharp edge says nothing of its blur, and a flat patch nothing at all.
    information += 1e-9 * np.eye(len(MAX_PARAMETER_STEP))
    covariance = np.linalg.inv(information)[:, :2, :2]
    found, ok = region.project(around.to_rays(p[:, :2]))
    nearest = np.minimum(np.linalg.norm(along, axis=1), np.linalg.norm(across, axis=1))
    ok &= (
        whole
        & settled
        & seen
        & around.is_valid
        & (np.trace(covariance, axis1=1, axis2=2) < MAX_UNIT_VARIANCE_PX2)
    )
    ok &= np.linalg.norm(found - uv, axis=1) < MAX_CORNER_SHIFT_SHARE * nearest
    rms = np.sqrt((r * r).sum(1) / np.maximum(count - len(MAX_PARAMETER_STEP), 1))
    return CornerFit(found, covariance, rms, p[:, SADDLE], ok)


def _initial_parameters(window, along, across):
    """Parameters (n, 9): at the seed, along its sides, a little blurred, the levels that fit."""
    p = np.zeros((len(along), len(MAX_PARAMETER_STEP)))
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


def _run_levenberg_marquardt(window, p):
    """Levenberg and Marquardt's method for all corners at once, until none moves.

    Parameters (n, 9), residuals (n, k), Jacobians (n, k, 9), and which settled (n,).
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
        better = cost_trial <= cost[active]
        rows = active[better]
        p[rows], r[rows], J[rows] = trial[better], r_trial[better], J_trial[better]
        cost[rows] = cost_trial[better]
        damping[active] *= np.where(better, 0.1, 10)
        moves = (np.abs(step) > STEP_TOLERANCE_SHARE * MAX_PARAMETER_STEP).any(1)
        active = active[moves & (damping[active] < MAX_DAMPING)]
        if not len(active):
            break
    settled = damping < MAX_DAMPING
    settled[active] = False
    return p, r, J, settled


def _damped_step(p, r, J, damping):
    A = np.swapaxes(J, 1, 2) @ J
    diagonal = np.einsum("nmm->nm", A) + 1e-9
    A[:, range(len(MAX_PARAMETER_STEP)), range(len(MAX_PARAMETER_STEP))] += (
        damping[:, None] * diagonal + 1e-9
    )
    slope = np.swapaxes(J, 1, 2) @ r[..., None]
    held = (p[:, BLUR2] <= MIN_BLUR2_PX2) & (slope[:, BLUR2, 0] > 0)
    A[held, BLUR2, BLUR2] = 1e30
    step = -np.linalg.solve(A, slope)[..., 0]
    return np.clip(step, -MAX_PARAMETER_STEP, MAX_PARAMETER_STEP)


def _edge_residuals(window, p):
    """Residuals (n, k), model less grey level, and Jacobians (n, k, 9)."""
    S, by_S = _line_side(window, p, FIRST)
    U, by_U = _line_side(window, p, SECOND)
    mean, saddle, light_x, light_y = p[:, MEAN:].T[..., None]
    x, y = window.tangent_xy
    light = 1 + light_x * x + light_y * y
    flat = mean + saddle * S * U
    to_S, to_U = saddle * U * light, saddle * S * light
    J = np.empty((*S.shape, len(MAX_PARAMETER_STEP)))
    for column, slope_S, slope_U in zip((X, Y, BLUR2), by_S[1:], by_U[1:], strict=True):
        J[..., column] = to_S * slope_S + to_U * slope_U
    J[..., FIRST], J[..., SECOND] = to_S * by_S[0], to_U * by_U[0]
    J[..., MEAN], J[..., SADDLE] = light, S * U * light
    J[..., LIGHT_X], J[..., LIGHT_Y] = flat * x, flat * y
    J *= window.weight[..., None]
    r = flat * light - window.grey
    return r * window.weight, J


def _line_side(window, p, line):
    """-1 and 1 on the two sides (n, k) of a line, smooth between; slopes by angle, x, y, blur²."""
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


def _pixel_edge_response(d, c, s, blur2):
    """Share of a pixel's light that comes from beyond an edge, and its slope and bend by d.

    d: from the edge, px; c, s: absolute parts of its normal, which are the widths of the two boxes
    that make up the pixel's square as seen along the edge; blur2: variance of the Gaussian, px².
    """
    b = np.sqrt(blur2)
    value, slope, bend = (d > 0).astype(float), np.zeros_like(d), np.zeros_like(d)
    # Beyond the pixel's half diagonal and six sigma nothing is left of the edge.
    near = np.abs(d) < np.sqrt(0.5) + 6 * b
    d, c, s, b = d[near], c[near], s[near], np.broadcast_to(b, near.shape)[near]
    wide, narrow = np.maximum(c, s), np.maximum(np.minimum(c, s), 1e-3)
    area = wide * narrow
    value_near = slope_near = bend_near = 0.0
    outer, inner = (wide + narrow) / 2, (wide - narrow) / 2
    for sign, shift in ((1, outer), (-1, inner), (-1, -inner), (1, -outer)):
        x = d + shift
        z = x / b
        P = ndtr(z)
        G = x * P + b / np.sqrt(2 * np.pi) * np.exp(-0.5 * z * z)
        value_near = value_near + sign * 0.5 * (x * G + b * b * P)
        slope_near = slope_near + sign * G
        bend_near = bend_near + sign * P
    value[near], slope[near], bend[near] = value_near / area, slope_near / area, bend_near / area
    return value, slope, bend
