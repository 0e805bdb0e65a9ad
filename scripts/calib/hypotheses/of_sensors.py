"""What may be wrong about a sensor: its lens, or its ranges and beams."""

from dataclasses import replace

import numpy as np
from scipy.linalg import null_space

from calib.cameras import MODELS
from calib.hypotheses.base import Hypothesis, differences
from calib.hypotheses.words import DEGREES, MM, PERCENT, by, vector, way

RELATIVE, PIXEL = 1e-6, 1e-4  # steps of the finite differences
EDGES, RETURNS = ("edge",), ("surface",)
FEW = 50  # returns of a beam, below which it is not looked at alone


def lenses(setup):
    """The focal lengths of a camera, both together, and its principal point."""
    for name, camera in _sensors(setup, "params"):
        at = {p: i for i, p in enumerate(MODELS[camera.model].PARAMS)}
        focal, centre = [at["fx"], at["fy"]], [at["cx"], at["cy"]]

        def zoomed(view, theta, focal=focal):
            camera = view.setup.models[view.group.sensor]
            params = np.array(camera.params)
            params[focal] *= 1 + theta[0]
            return {"model": replace(camera, params=tuple(params))}

        def moved(view, theta, centre=centre):
            camera = view.setup.models[view.group.sensor]
            params = np.array(camera.params)
            params[centre] += theta
            return {"model": replace(camera, params=tuple(params))}

        def of_focal(theta, sigma, name=name, fx=camera.params[focal[0]]):
            return (
                f"the focal length of {name} is {by(theta[0], sigma[0], PERCENT, '%')} "
                f"{way(theta[0], 'longer', 'shorter')} than its params say: fx "
                f"{fx * (1 + theta[0]):.5g}, not {fx:.5g}"
            )

        def of_centre(theta, sigma, name=name):
            return f"the principal point of {name} is off by {vector(theta, sigma, 1.0, 'px')}"

        remedy = f"calibrate the lens of {name} again, at the focus and image size of the recording"
        yield Hypothesis(
            "focal", name, True, (), 1, differences(zoomed, [RELATIVE]), of_focal, remedy
        )
        yield Hypothesis(
            "principal_point",
            name,
            True,
            (),
            2,
            differences(moved, [PIXEL] * 2),
            of_centre,
            remedy,
        )


def ranges(setup):
    """A constant error of a lidar's ranges, and one in proportion to them."""
    for name, _ in _sensors(setup, "range_sigma"):

        def of_bias(theta, sigma, name=name):
            return (
                f"the ranges of {name} are {by(theta[0], sigma[0], MM, 'mm')} "
                f"{way(theta[0], 'too long', 'too short')}"
            )

        def of_scale(theta, sigma, name=name):
            return (
                f"the ranges of {name} are {by(theta[0], sigma[0], PERCENT, '%')} "
                f"{way(theta[0], 'too long', 'too short')}"
            )

        remedy = f"check the ranges of {name} against a wall at a measured distance"

        def by_scale(view):
            # Of the expected ranges: noise that stood on both sides would pass for a scale.
            return (view.by_range * (view.assigned.range + view.assigned.value[:, 0]))[None]

        for what, derivative, told in (
            ("range_bias", lambda view: view.by_range[None], of_bias),
            ("range_scale", by_scale, of_scale),
        ):
            yield Hypothesis(what, name, True, RETURNS, 1, derivative, told, remedy)


def beams(setup):
    """What the ranges of single beams of a lidar are off by beside what all of them are."""
    for name, _ in _sensors(setup, "range_sigma"):
        own = [
            g.keypoints["index"] for g in setup.groups if (g.sensor, g.kind) == (name, "surface")
        ]
        numbers, counts = np.unique(np.concatenate([*own, [-1]]), return_counts=True)
        rings = numbers[(numbers >= 0) & (counts >= FEW)]
        if len(rings) < 2:
            continue
        # Of numbers that sum to zero over all returns.
        basis = null_space(counts[np.isin(numbers, rings)][None].astype(float))

        def derivative(view, rings=rings, basis=basis):
            share = basis.T @ (view.group.keypoints["index"] == rings[:, None])
            return view.by_range * share[:, None]

        def told(theta, sigma, name=name, rings=rings, basis=basis):
            off, spread = basis @ theta, np.sqrt(basis**2 @ sigma**2)
            worst = np.abs(off).argmax()
            return (
                f"single beams of {name} read long or short: beam {rings[worst]} is "
                f"{by(off[worst], spread[worst], MM, 'mm')} "
                f"{way(off[worst], 'longer', 'shorter')} than the mean of all, rms of all "
                f"{MM * np.sqrt(np.mean(off**2)):.2g} mm"
            )

        remedy = f"correct the ranges of {name} beam by beam, or let it warm up before recording"
        size = len(rings) - 1
        yield Hypothesis("beams", name, True, RETURNS, size, derivative, told, remedy)


def widths(setup):
    """The width of a lidar's beams: outlines in its scans are larger all round by an angle."""
    for name, _ in _sensors(setup, "range_sigma"):
        if not any(g.sensor == name and g.kind == "edge" for g in setup.groups):
            continue

        def derivative(view):
            middle = view.target.centre[:2]
            grown = middle + (1 + RELATIVE) * (view.target.vertices - middle)
            rise = view.changed(target=replace(view.target, vertices=grown))
            return (np.sign(rise - view.assigned.standard.T) / view.assigned.sigma)[None]

        def told(theta, sigma, name=name):
            return (
                f"outlines in the scans of {name} are {by(theta[0], sigma[0], DEGREES, '°')} "
                f"{way(theta[0], 'wider', 'narrower')} all round than its beams should see them"
            )

        remedy = (
            f"nothing, if the beam of {name} is about twice that wide: both sides of a target err "
            "alike; otherwise measure outline_m"
        )
        yield Hypothesis("beam_width", name, True, EDGES, 1, derivative, told, remedy)


def _sensors(setup, has):
    """(name, model) of the sensors whose model has an attribute."""
    return [(n, m) for n, m in sorted(setup.models.items()) if hasattr(m, has)]
