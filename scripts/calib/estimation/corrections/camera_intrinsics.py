"""A camera's parameters as numbers of the estimate, with priors."""

from dataclasses import replace
from functools import partial

import numpy as np

from calib.estimation.corrections.correction import Correction, make_finite_difference
from calib.sensors.camera.camera_model import CAMERA_MODELS

INTRINSICS = "intrinsics"
PRIOR_SIGMA_PER_IMAGE_SIZE = {
    "fx": 0.05,
    "fy": 0.05,
    "cx": 0.05,
    "cy": 0.05,
}  # σ of priors, of the larger image side
PRIOR_SIGMA_BY_PARAMETER = {
    "xi": 0.2,
    "alpha": 0.1,
    "p1": 0.01,
    "p2": 0.01,
}  # of other parameters; LENS for the rest
DEFAULT_PRIOR_SIGMA = 0.3
STEP_IN_PRIOR_SIGMA = 1e-4  # of a prior's σ, of the finite differences
MAX_INTRINSICS_SIGMA_RATIO = (
    0.5  # of the prior's σ: where focal length or centre are told no better, none is estimated
)


def intrinsics_parameter_names(camera, count):
    """The parameters that are estimated: those that the config states."""
    return CAMERA_MODELS[camera.model].PARAMETER_NAMES[:count]


def make_intrinsics_correction(sensor, camera, count):
    """The Hypothesis that the first `count` parameters of a Camera are off."""
    size = max(camera.size_px)
    sigma = [
        PRIOR_SIGMA_PER_IMAGE_SIZE[n] * size
        if n in PRIOR_SIGMA_PER_IMAGE_SIZE
        else PRIOR_SIGMA_BY_PARAMETER.get(n, DEFAULT_PRIOR_SIGMA)
        for n in intrinsics_parameter_names(camera, count)
    ]
    slope = make_finite_difference(
        lambda view, theta: {"model": shift_camera_parameters(view.model, theta)},
        STEP_IN_PRIOR_SIGMA * np.array(sigma),
    )
    remedy = f"nothing: the parameters of {sensor} are estimated"
    return Correction(
        INTRINSICS, sensor, True, (), count, slope, partial(_describe_intrinsics, sensor), remedy, np.array(sigma),
        lambda model, theta, placement: shift_camera_parameters(model, theta),
    )  # fmt: skip


def shift_camera_parameters(camera, theta):
    """The Camera with its first parameters changed by theta (q,)."""
    params = np.array(camera.params)
    params[: len(theta)] += theta
    return replace(camera, params=tuple(params.tolist()))


def _describe_intrinsics(sensor, theta, sigma):
    return (
        f"the parameters of {sensor} differ from the stated ones by up to {np.abs(theta).max():.3g}"
    )


def get_intrinsics_estimate(setup, result, sensor):
    """(params (q,), σ (q,), share (q,) of the priors' σ that is left) of a camera, or None."""
    at = setup.correction_slice(INTRINSICS, sensor)
    if at is None:
        return None
    theta = result.state.correction_values[at]
    share = np.sqrt(np.diag(result.solve_result.covariance)[setup.n_chain_unknowns :][at])
    params = np.array(setup.models[sensor].params)[: len(theta)] + theta
    return params, share * setup.correction_sigma[at], share


def find_unobservable_intrinsics(setup, result):
    """{sensor: why} of the cameras whose views do not tell their parameters."""
    out = {}
    for h in (h for h in setup.corrections if h.name == INTRINSICS):
        camera = setup.models[h.subject]
        share = get_intrinsics_estimate(setup, result, h.subject)[2]
        loose = [
            n
            for n, s in zip(intrinsics_parameter_names(camera, h.n_values), share, strict=True)
            if n in PRIOR_SIGMA_PER_IMAGE_SIZE and s > MAX_INTRINSICS_SIGMA_RATIO
        ]
        if loose:
            views = sum(g.sensor == h.subject for g in setup.groups)
            out[h.subject] = (
                f"not estimated: {views} groups of views tell {', '.join(loose)} no better than "
                "stated; show the pattern near, tilted to all sides and in all parts of the image"
            )
    return out
