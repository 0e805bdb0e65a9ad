"""What may be wrong about a sensor: its lens, or its ranges and beams."""

from dataclasses import replace

import numpy as np
from scipy.linalg import null_space

from calib.estimation.corrections.correction import METRE, Hypothesis, differences
from calib.estimation.corrections.number_wording import DEGREES, MM, PERCENT, by, vector, way
from calib.sensors.camera.camera_model import MODELS

RELATIVE, PIXEL = 1e-6, 1e-4  # steps of the finite differences
EDGES, RETURNS = ("edge",), ("surface", "cap")
APART = np.repeat([0.03, np.radians(1.0)], 3)  # m, rad: σ between two views of one instrument
FEW = 50  # returns of a beam, below which it is not looked at alone


def lenses(setup):
    """The focal lengths of a camera, both together, and its principal point."""
    for name, camera in _sensors(setup, "params"):
        at = {p: i for i, p in enumerate(MODELS[camera.model].PARAMS)}
        focal, centre = [at["fx"], at["fy"]], [at["cx"], at["cy"]]

        def zoomed(view, theta, focal=focal):
            params = np.array(view.model.params)
            params[focal] *= 1 + theta[0]
            return {"model": replace(view.model, params=tuple(params))}

        def moved(view, theta, centre=centre):
            params = np.array(view.model.params)
            params[centre] += theta
            return {"model": replace(view.model, params=tuple(params))}

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
    for name, lidar in _sensors(setup, "range_sigma"):

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

        def by_scale(view):
            # Of the expected ranges: noise that stood on both sides would pass for a scale.
            return (view.by_range * (view.assigned.range + view.assigned.value[:, 0]))[None]

        def longer(lidar, theta, placement):
            return replace(lidar, range_bias=lidar.range_bias + theta[0])

        remedy = f"check the ranges of {name} against a wall at a measured distance"
        yield Hypothesis(
            "range_bias",
            name,
            True,
            RETURNS,
            1,
            lambda view: view.by_range[None],
            of_bias,
            remedy,
            np.array([lidar.beam_range_sigma]),
            longer,
        )
        yield Hypothesis("range_scale", name, True, RETURNS, 1, by_scale, of_scale, remedy)


def beams(setup):
    """What the ranges of single beams of a lidar are off by beside what all of them are."""
    for name, lidar in _sensors(setup, "range_sigma"):
        own = [
            g.keypoints["index"] for g in setup.groups if (g.sensor, g.kind) == (name, "surface")
        ]
        numbers, counts = np.unique(np.concatenate([*own, [-1]]), return_counts=True)
        rings = numbers[(numbers >= 0) & (counts >= FEW)]
        if len(rings) < 2:
            continue
        # Of numbers that sum to zero over all returns.
        basis = null_space(counts[np.isin(numbers, rings)][None].astype(float))
        yield _of_beams(name, rings, basis, np.full(len(rings) - 1, lidar.beam_range_sigma))


def _of_beams(name, rings, basis, sigma):
    """The Hypothesis that the ranges of rings (n,) are too long by basis (n, q) times θ, m."""
    remedy = f"correct the ranges of {name} beam by beam, or let it warm up before recording"

    def derivative(view):
        share = basis.T @ (view.group.keypoints["index"] == rings[:, None])
        return view.by_range * share[:, None]

    def told(theta, sigma):
        off, spread = basis @ theta, np.sqrt(basis**2 @ sigma**2)
        worst = np.abs(off).argmax()
        return (
            f"single beams of {name} read long or short: beam {rings[worst]} is "
            f"{by(off[worst], spread[worst], MM, 'mm')} "
            f"{way(off[worst], 'longer', 'shorter')} than the mean of all, rms of all "
            f"{MM * np.sqrt(np.mean(off**2)):.2g} mm"
        )

    def longer(lidar, theta, placement):
        offsets = np.zeros(max(rings.max() + 1, len(lidar.range_offsets)))
        offsets[: len(lidar.range_offsets)] = lidar.range_offsets
        offsets[rings] += basis @ theta
        return replace(lidar, range_offsets=tuple(offsets.tolist()))

    return Hypothesis(
        "beams", name, True, RETURNS, len(sigma), derivative, told, remedy, sigma, longer
    )


def widths(setup):
    """That a lidar's beams see outlines larger all round, by a width and by an angle.

    By how much depends on how far a target is, how bright, and before what: what is estimated is a
    width of its own for every placement. Outlines then tell directions, and no sizes.
    """
    for name, lidar in _sensors(setup, "range_sigma"):
        own = [g.placement for g in setup.groups if (g.sensor, g.kind) == (name, "edge")]
        if not own:
            continue

        def change(view, theta):
            return {"model": _wider(view.model, theta)}

        def told(theta, sigma, name=name):
            return (
                f"outlines in the scans of {name} are seen "
                f"{by(theta[0], sigma[0], MM, 'mm')} {way(theta[0], 'wider', 'narrower')} all "
                f"round, and {by(theta[1], sigma[1], DEGREES, '°')} "
                f"{way(theta[1], 'wider', 'narrower')} besides"
            )

        remedy = (
            f"nothing, if the beam of {name} is about twice that wide: both sides of a target err "
            "alike; otherwise measure outline_m"
        )
        slope = differences(change, [METRE, RELATIVE])
        apart = _placement_widths(name, np.unique(own), lidar.beam_width_sigma, remedy)
        yield Hypothesis(
            "beam_width",
            name,
            True,
            EDGES,
            2,
            slope,
            told,
            remedy,
            apart.sigma,
            apart.mended,
            apart,
        )


def _placement_widths(name, places, sigma, remedy):
    """The Hypothesis of a width, m, for each of the places (n,)."""

    def derivative(view):
        rise = differences(lambda v, t: {"model": _wider(v.model, (t[0], 0.0))}, [METRE])(view)
        return (places == view.group.placement)[:, None, None] * rise

    def wider(lidar, theta, placement):
        return _wider(lidar, (float(theta[places == placement].sum()), 0.0))

    def told(theta, sigma):
        least, most, mean = (f"{MM * v:.1f}" for v in (theta.min(), theta.max(), theta.mean()))
        return (
            f"outlines in the scans of {name} are seen {mean} mm wider all round in the mean, "
            f"{least} to {most} mm in single placements"
        )

    size = len(places)
    return Hypothesis(
        "beam_width", name, True, EDGES, size, derivative, told, remedy, np.full(size, sigma), wider
    )


def _wider(lidar, theta):
    """The lidar with beams that see outlines so much wider, (m, rad)."""
    return replace(lidar, beam_width=tuple(np.add(lidar.beam_width, theta).tolist()))


def disagreements(setup):
    """That the outlines in a lidar's scans put it elsewhere than its returns do: something is wrong
    that has no other name. The returns are believed, for outlines depend on more: how wide a beam
    is, how much of it must meet a target, and what stands behind."""
    for name, _ in _sensors(setup, "range_sigma"):
        if {"edge", "surface"} - {g.kind for g in setup.groups if g.sensor == name}:
            continue

        def moved(lidar, theta, placement):
            return replace(lidar, apart=tuple(np.add(lidar.apart, theta).tolist()))

        def change(view, theta, moved=moved):
            return {"model": moved(view.model, theta, None)}

        def told(theta, sigma, name=name):
            return (
                f"outlines in the scans of {name} put it elsewhere than its returns do, along and "
                f"about its x, y, z by {vector(theta[:3], sigma[:3], MM, 'mm')} and "
                f"{vector(theta[3:], sigma[3:], DEGREES, '°')}"
            )

        remedy = (
            f"find which is wrong, the ranges of {name}, its angles, or the poses of the motion "
            "capture; show targets nearer and farther, and tilted to all sides"
        )
        slope = differences(change, [METRE] * 3 + [RELATIVE] * 3)
        yield Hypothesis("apart", name, True, EDGES, 6, slope, told, remedy, APART, moved)


def _sensors(setup, has):
    """(name, model) of the sensors whose model has an attribute."""
    return [(n, m) for n, m in sorted(setup.models.items()) if hasattr(m, has)]
