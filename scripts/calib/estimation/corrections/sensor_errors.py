"""What may be wrong about a sensor: its lens, or its ranges and beams."""

from dataclasses import replace

import numpy as np
from scipy.linalg import null_space

from calib.estimation.corrections.correction import (
    FINITE_STEP_M,
    Correction,
    make_finite_difference,
)
from calib.estimation.corrections.number_wording import (
    choose_by_sign,
    format_value_sigma,
    format_vector_sigma,
)
from calib.geometry.units import DEG_PER_RAD, MM_PER_M, SHARE_TO_PERCENT
from calib.sensors.camera.camera_model import CAMERA_MODELS

RELATIVE_STEP, FINITE_STEP_PX = 1e-6, 1e-4  # steps of the finite differences
OUTLINE_KINDS, RETURN_KINDS = ("board_outline",), ("target_surface", "cylinder_cap")
OUTLINE_TWIST_SIGMA = np.repeat(
    [0.03, np.radians(1.0)], 3
)  # m, rad: σ between two views of one instrument
MIN_RETURNS_PER_BEAM = 50  # returns of a beam, below which it is not looked at alone


def make_lens_corrections(setup):
    """The focal lengths of a camera, both together, and its principal point."""
    for name, camera in _sensors_with_attribute(setup, "params"):
        at = {p: i for i, p in enumerate(CAMERA_MODELS[camera.model].PARAMETER_NAMES)}
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
                f"the focal length of {name} is {format_value_sigma(theta[0], sigma[0], SHARE_TO_PERCENT, '%')} "
                f"{choose_by_sign(theta[0], 'longer', 'shorter')} than its params say: fx "
                f"{fx * (1 + theta[0]):.5g}, not {fx:.5g}"
            )

        def of_centre(theta, sigma, name=name):
            return f"the principal point of {name} is off by {format_vector_sigma(theta, sigma, 1.0, 'px')}"

        remedy = f"calibrate the lens of {name} again, at the focus and image size of the recording"
        yield Correction(
            "focal_length",
            name,
            True,
            (),
            1,
            make_finite_difference(zoomed, [RELATIVE_STEP]),
            of_focal,
            remedy,
        )
        yield Correction(
            "principal_point",
            name,
            True,
            (),
            2,
            make_finite_difference(moved, [FINITE_STEP_PX] * 2),
            of_centre,
            remedy,
        )


def make_range_corrections(setup):
    """A constant error of a lidar's ranges, and one in proportion to them."""
    for name, lidar in _sensors_with_attribute(setup, "range_sigma"):

        def of_bias(theta, sigma, name=name):
            return (
                f"the ranges of {name} are {format_value_sigma(theta[0], sigma[0], MM_PER_M, 'mm')} "
                f"{choose_by_sign(theta[0], 'too long', 'too short')}"
            )

        def of_scale(theta, sigma, name=name):
            return (
                f"the ranges of {name} are {format_value_sigma(theta[0], sigma[0], SHARE_TO_PERCENT, '%')} "
                f"{choose_by_sign(theta[0], 'too long', 'too short')}"
            )

        def by_scale(view):
            # Of the expected ranges: noise that stood on both sides would pass for a scale.
            return (
                view.range_derivative * (view.assignment.range + view.assignment.residual[:, 0])
            )[None]

        def longer(lidar, theta, placement):
            return replace(lidar, range_bias=lidar.range_bias + theta[0])

        remedy = f"check the ranges of {name} against a wall at a measured distance"
        yield Correction(
            "range_bias",
            name,
            True,
            RETURN_KINDS,
            1,
            lambda view: view.range_derivative[None],
            of_bias,
            remedy,
            np.array([lidar.beam_range_sigma]),
            longer,
        )
        yield Correction("range_scale", name, True, RETURN_KINDS, 1, by_scale, of_scale, remedy)


def make_beam_corrections(setup):
    """What the ranges of single beams of a lidar are off by beside what all of them are."""
    for name, lidar in _sensors_with_attribute(setup, "range_sigma"):
        own = [
            g.keypoints["feature_index"]
            for g in setup.groups
            if (g.sensor, g.kind) == (name, "target_surface")
        ]
        numbers, counts = np.unique(np.concatenate([*own, [-1]]), return_counts=True)
        rings = numbers[(numbers >= 0) & (counts >= MIN_RETURNS_PER_BEAM)]
        if len(rings) < 2:
            continue
        # Of numbers that sum to zero over all returns.
        basis = null_space(counts[np.isin(numbers, rings)][None].astype(float))
        yield _make_beam_correction(
            name, rings, basis, np.full(len(rings) - 1, lidar.beam_range_sigma)
        )


def _make_beam_correction(name, rings, basis, sigma):
    """The Hypothesis that the ranges of rings (n,) are too long by basis (n, q) times θ, m."""
    remedy = f"correct the ranges of {name} beam by beam, or let it warm up before recording"

    def derivative(view):
        share = basis.T @ (view.group.keypoints["feature_index"] == rings[:, None])
        return view.range_derivative * share[:, None]

    def told(theta, sigma):
        off, spread = basis @ theta, np.sqrt(basis**2 @ sigma**2)
        worst = np.abs(off).argmax()
        return (
            f"single beams of {name} read long or short: beam {rings[worst]} is "
            f"{format_value_sigma(off[worst], spread[worst], MM_PER_M, 'mm')} "
            f"{choose_by_sign(off[worst], 'longer', 'shorter')} than the mean of all, rms of all "
            f"{MM_PER_M * np.sqrt(np.mean(off**2)):.2g} mm"
        )

    def longer(lidar, theta, placement):
        offsets = np.zeros(max(rings.max() + 1, len(lidar.range_offsets)))
        offsets[: len(lidar.range_offsets)] = lidar.range_offsets
        offsets[rings] += basis @ theta
        return replace(lidar, range_offsets=tuple(offsets.tolist()))

    return Correction(
        "beam_offsets",
        name,
        True,
        RETURN_KINDS,
        len(sigma),
        derivative,
        told,
        remedy,
        sigma,
        longer,
    )


def make_beam_width_corrections(setup):
    """That a lidar's beams see outlines larger all round, by a width and by an angle.

    By how much depends on how far a target is, how bright, and before what: what is estimated is a
    width of its own for every placement. Outlines then tell directions, and no sizes.
    """
    for name, lidar in _sensors_with_attribute(setup, "range_sigma"):
        own = [g.placement for g in setup.groups if (g.sensor, g.kind) == (name, "board_outline")]
        if not own:
            continue

        def change(view, theta):
            return {"model": _widen_beams(view.model, theta)}

        def told(theta, sigma, name=name):
            return (
                f"outlines in the scans of {name} are seen "
                f"{format_value_sigma(theta[0], sigma[0], MM_PER_M, 'mm')} {choose_by_sign(theta[0], 'wider', 'narrower')} all "
                f"round, and {format_value_sigma(theta[1], sigma[1], DEG_PER_RAD, '°')} "
                f"{choose_by_sign(theta[1], 'wider', 'narrower')} besides"
            )

        remedy = (
            f"nothing, if the beam of {name} is about twice that wide: both sides of a target err "
            "alike; otherwise measure outline_m"
        )
        slope = make_finite_difference(change, [FINITE_STEP_M, RELATIVE_STEP])
        apart = _make_placement_width_correction(
            name, np.unique(own), lidar.beam_width_sigma, remedy
        )
        yield Correction(
            "beam_width",
            name,
            True,
            OUTLINE_KINDS,
            2,
            slope,
            told,
            remedy,
            apart.prior_sigma,
            apart.apply_to_model,
            apart,
        )


def _make_placement_width_correction(name, places, sigma, remedy):
    """The Hypothesis of a width, m, for each of the places (n,)."""

    def derivative(view):
        rise = make_finite_difference(
            lambda v, t: {"model": _widen_beams(v.model, (t[0], 0.0))}, [FINITE_STEP_M]
        )(view)
        return (places == view.group.placement)[:, None, None] * rise

    def wider(lidar, theta, placement):
        return _widen_beams(lidar, (float(theta[places == placement].sum()), 0.0))

    def told(theta, sigma):
        least, most, mean = (
            f"{MM_PER_M * v:.1f}" for v in (theta.min(), theta.max(), theta.mean())
        )
        return (
            f"outlines in the scans of {name} are seen {mean} mm wider all round in the mean, "
            f"{least} to {most} mm in single placements"
        )

    size = len(places)
    return Correction(
        "beam_width",
        name,
        True,
        OUTLINE_KINDS,
        size,
        derivative,
        told,
        remedy,
        np.full(size, sigma),
        wider,
    )


def _widen_beams(lidar, theta):
    """The lidar with beams that see outlines so much wider, (m, rad)."""
    return replace(lidar, beam_width=tuple(np.add(lidar.beam_width, theta).tolist()))


def make_outline_twist_corrections(setup):
    """That the outlines in a lidar's scans put it elsewhere than its returns do: something is wrong
    that has no other name. The returns are believed, for outlines depend on more: how wide a beam
    is, how much of it must meet a target, and what stands behind."""
    for name, _ in _sensors_with_attribute(setup, "range_sigma"):
        if {"board_outline", "target_surface"} - {g.kind for g in setup.groups if g.sensor == name}:
            continue

        def moved(lidar, theta, placement):
            return replace(lidar, outline_twist=tuple(np.add(lidar.outline_twist, theta).tolist()))

        def change(view, theta, moved=moved):
            return {"model": moved(view.model, theta, None)}

        def told(theta, sigma, name=name):
            return (
                f"outlines in the scans of {name} put it elsewhere than its returns do, along and "
                f"about its x, y, z by {format_vector_sigma(theta[:3], sigma[:3], MM_PER_M, 'mm')} and "
                f"{format_vector_sigma(theta[3:], sigma[3:], DEG_PER_RAD, '°')}"
            )

        remedy = (
            f"find which is wrong, the ranges of {name}, its angles, or the poses of the motion "
            "capture; show targets nearer and farther, and tilted to all sides"
        )
        slope = make_finite_difference(change, [FINITE_STEP_M] * 3 + [RELATIVE_STEP] * 3)
        yield Correction(
            "outline_vs_surface",
            name,
            True,
            OUTLINE_KINDS,
            6,
            slope,
            told,
            remedy,
            OUTLINE_TWIST_SIGMA,
            moved,
        )


def _sensors_with_attribute(setup, attribute):
    """(name, model) of the sensors whose model has an attribute."""
    return [(n, m) for n, m in sorted(setup.models.items()) if hasattr(m, attribute)]
