"""A camera's parameters as numbers of the estimate, with priors."""

from dataclasses import replace
from functools import partial

import numpy as np

from calib.estimation.corrections.correction import Hypothesis, differences
from calib.sensors.camera.camera_model import MODELS

NAME = "intrinsics"
OF_SIZE = {"fx": 0.05, "fy": 0.05, "cx": 0.05, "cy": 0.05}  # σ of priors, of the larger image side
OF_ONE = {"xi": 0.2, "alpha": 0.1, "p1": 0.01, "p2": 0.01}  # of other parameters; LENS for the rest
LENS = 0.3
STEP = 1e-4  # of a prior's σ, of the finite differences
KNOWN = 0.5  # of the prior's σ: where focal length or centre are told no better, none is estimated


def names(camera, count):
    """The parameters that are estimated: those that the config states."""
    return MODELS[camera.model].PARAMS[:count]


def lens(sensor, camera, count):
    """The Hypothesis that the first `count` parameters of a Camera are off."""
    size = max(camera.size)
    sigma = [
        OF_SIZE[n] * size if n in OF_SIZE else OF_ONE.get(n, LENS) for n in names(camera, count)
    ]
    slope = differences(
        lambda view, theta: {"model": changed(view.model, theta)}, STEP * np.array(sigma)
    )
    remedy = f"nothing: the parameters of {sensor} are estimated"
    return Hypothesis(
        NAME, sensor, True, (), count, slope, partial(_told, sensor), remedy, np.array(sigma),
        lambda model, theta, placement: changed(model, theta),
    )  # fmt: skip


def changed(camera, theta):
    """The Camera with its first parameters changed by theta (q,)."""
    params = np.array(camera.params)
    params[: len(theta)] += theta
    return replace(camera, params=tuple(params.tolist()))


def _told(sensor, theta, sigma):
    return (
        f"the parameters of {sensor} differ from the stated ones by up to {np.abs(theta).max():.3g}"
    )


def estimated(setup, result, sensor):
    """(params (q,), σ (q,), share (q,) of the priors' σ that is left) of a camera, or None."""
    at = setup.span(NAME, sensor)
    if at is None:
        return None
    theta = result.state.theta[at]
    share = np.sqrt(np.diag(result.solution.covariance)[setup.chained :][at])
    params = np.array(setup.models[sensor].params)[: len(theta)] + theta
    return params, share * setup.theta_sigma[at], share


def refused(setup, result):
    """{sensor: why} of the cameras whose views do not tell their parameters."""
    out = {}
    for h in (h for h in setup.corrections if h.name == NAME):
        camera = setup.models[h.of]
        share = estimated(setup, result, h.of)[2]
        loose = [
            n
            for n, s in zip(names(camera, h.size), share, strict=True)
            if n in OF_SIZE and s > KNOWN
        ]
        if loose:
            views = sum(g.sensor == h.of for g in setup.groups)
            out[h.of] = (
                f"not estimated: {views} groups of views tell {', '.join(loose)} no better than "
                "stated; show the pattern near, tilted to all sides and in all parts of the image"
            )
    return out
