"""What a settled estimate says, as solution.json and as rows of residuals.parquet."""

import itertools
from importlib.metadata import version

import numpy as np

from calib.diagnosis import leave_one_out, model_selection, observability, residual_statistics
from calib.diagnosis.observability import MOUNT
from calib.estimation.corrections import camera_intrinsics, clock_drift, clock_offset
from calib.geometry import se3
from calib.io import pose_block
from calib.io.status import OK, failed
from calib.sensors.lidar import lidar_model

HELD = 0.9  # of the σ of a prior: what is known no better is told by nothing else
PACKAGES = ("casadi", "mcap", "numpy", "opencv-python-headless", "pyarrow", "rosbags", "scipy")


def as_json(setup, result, suspected, known, options):
    """The content of solution.json; known: sensor -> (status before the solve, guess.json)."""
    names = sorted(setup.models)
    open_directions = {n: directions(setup, result, n) for n in names}
    status = {n: outcome(n, known, open_directions, setup, result) for n in options["sensors"]}
    solved = [n for n in names if status[n].ok]
    joint = joint_covariance(setup, result, solved) if solved else None
    left = leave_one_out.leave_out(setup, result) if solved else []
    sensors = {}
    for name, (_, guess) in sorted(known.items()):
        sensors[name] = {
            "kind": options["sensors"][name]["kind"],
            "frame": guess["frame"],
            "status": status[name].to_dict(),
            "guess": {k: guess[k] for k in ("T_robot_sensor", "sigma", "source", "time_offset_s")},
            "undetermined": open_directions.get(name, []),
            **pose_of(name, result, solved, joint, guess),
            **lens_of(name, setup, result),
            **clock_offset.told(name, setup, result, guess),
            "time_wander": clock_drift.told(name, setup, result, guess),
            **residual_statistics.counts(name, options["sensors"][name]["kind"], setup, result),
            **tests_of(name, setup, result, left if name in solved else []),
        }
    return {
        "rig": options["rig"],
        "settled": result.settled,
        "ipopt": result.solution.status if result.solution else None,
        "sensors": sensors,
        "joint_covariance": {"order": solved, "matrix": joint.tolist()} if solved else None,
        "pairs": pairs(result.state.T_robot_sensor, solved, joint),
        "targets": targets(setup, result, options),
        "suspicions": [s | {"shift": {n: s["shift"][n] for n in solved}} for s in suspected]
        if solved
        else [],
        "sessions": dict.fromkeys(options["sessions"]),
        "mocap_offsets_s": clock_offset.streams(setup, result),
        "influences": residual_statistics.influences(setup, left),
        "noise": noise(setup, result),
        "provenance": {
            "sessions": options["sessions"],
            "packages": {p: version(p) for p in PACKAGES},
        },
    }


def directions(setup, result, name):
    """The undetermined directions of a sensor: [{direction (6,), unit twist, words}]."""
    i, T = sorted(setup.models).index(name), result.state.T_robot_sensor[name]
    common = observability.in_common(residual_statistics.seen(name, setup, result)[0])
    found = observability.undetermined(result.solution.information, len(setup.models), i)
    return [{"direction": d.tolist(), "words": observability.in_words(d, T, common)} for d in found]


def outcome(name, known, open_directions, setup, result):
    """Status of one sensor after the solve."""
    before, guess = known[name]
    if not before.ok:
        return before
    if open_directions[name]:
        if misread := residual_statistics.misread(name, setup, result):
            return turned(name, *misread)
        words = "; ".join(d["words"] for d in open_directions[name])
        return failed(
            f"the data do not determine {name}: {words}",
            f"{len(open_directions[name])} open directions",
            "none",
            advice(name, setup, result),
        )
    if not result.solution.success:
        return failed(f"IPOPT ended with {result.solution.status}", remedy="See solve.log.")
    return OK


def turned(name, target, pattern, stated, otherwise):
    """The Status of a camera that sees the pattern of a target counted from another end."""
    colour = {"black": "white", "white": "black"}[pattern.first_square]
    return failed(
        f"{name} sees the pattern of {target} the other way round than stated",
        f"corners {otherwise:.1f} px from their places counted from a {colour} first square",
        f"from a {pattern.first_square} one, but so they are {stated:.0f} px off",
        f"Set first_square of {target} to {colour}. Where the sheet should begin with "
        f"{pattern.first_square}, it was printed or mounted mirrored: print it anew as it is.",
    )


def advice(name, setup, result):
    """Which views would tell more of a sensor's pose (observability.advice)."""
    lidar = isinstance(setup.models[name], lidar_model.Lidar)
    return observability.advice(*residual_statistics.seen(name, setup, result), lidar)


def lens_of(name, setup, result):
    """{intrinsics: {model, params, sigma} or None, lens: why not} of one sensor."""
    found = camera_intrinsics.estimated(setup, result, name) if result.solution else None
    why = setup.lenses.get(name)
    if found is None:
        return {"intrinsics": None, "lens": why if isinstance(why, str) else ""}
    params, sigma, _ = found
    model = setup.models[name].model
    told = {"model": model, "params": params.tolist(), "sigma": sigma.tolist()}
    return {"intrinsics": told, "lens": ""}


def joint_covariance(setup, result, solved):
    """(6k, 6k) over the solved sensors in order; what is not solved is marginalised out."""
    names = sorted(setup.models)
    rows = [6 * names.index(n) + i for n in solved for i in range(6)]
    return result.solution.covariance[np.ix_(rows, rows)]


def pairs(T_robot_sensor, order, joint):
    """[{from, to, T, covariance}] of every two of the sensors in order: T maps points of `to` into
    `from`, with the covariance (6, 6) of its right perturbation, T·Exp(ξ), along the axes of `to`.

    joint (6k, 6k): the covariance of their poses; what both share cancels.
    """
    out = []
    for a, b in itertools.combinations(order, 2):
        at = [6 * order.index(n) + i for n in (a, b) for i in range(6)]
        T_r_a, T_r_b = T_robot_sensor[a], T_robot_sensor[b]
        spread = se3.covariance_of_relative(T_r_a, T_r_b, joint[np.ix_(at, at)])
        T = pose_block.pose_json(se3.inverse(T_r_a) @ T_r_b)
        out.append({"from": a, "to": b, "T": T, "covariance": spread.tolist()})
    return out


def pose_of(name, result, solved, joint, guess):
    """T_robot_sensor, its covariance, weakest direction, and distance from the guess in its σ; null
    for a sensor without a pose."""
    if name not in solved:
        return dict.fromkeys(("T_robot_sensor", "covariance", "weakest", "correction"))
    T = result.state.T_robot_sensor[name]
    at = 6 * solved.index(name)
    block = joint[at : at + 6, at : at + 6]
    words, sigma = observability.weakest(block, T)
    return {
        "T_robot_sensor": pose_block.pose_json(T),
        "covariance": block.tolist(),
        "weakest": {"direction": words, "sigma": sigma},
        "correction": residual_statistics.correction(T, guess),
    }


def tests_of(name, setup, result, left):
    """What a verdict asks of one sensor beside its pose; left: crossvalidation.Left, or none."""
    if name not in setup.models:
        none = {"tilt": {}, "fit": {}, "advice": "", "held_out": None, "predicted": None}
        return none | {"corrections": []}
    directions, _ = residual_statistics.seen(name, setup, result)
    return {
        "tilt": observability.tilts(directions),
        "fit": residual_statistics.fit(name, setup, result),
        "corrections": model_selection.corrections(setup, result, name) if left else [],
        "advice": advice(name, setup, result),
        "held_out": residual_statistics.held_out(name, left),
        "predicted": leave_one_out.sigma_by_count(setup, result, name) if left else None,
    }


def targets(setup, result, options):
    """{name: {T_body_target, covariance, shift, prior, open} where it was estimated, else None}.

    shift (6,): from where the config puts it; prior (6,): the σ of that; None for unknown mounts.
    open: in words, what of it nothing tells and the prior alone holds, though it matters.
    """
    out = dict.fromkeys(sorted(options["targets"]))
    first = 6 * len(setup.models)
    for i, name in enumerate(sorted(setup.mounts)):
        at = slice(first + 6 * i, first + 6 * i + 6)
        block = result.solution.covariance[at, at]
        pose = pose_block.pose_json(result.state.mounts[name])
        out[name] = {"T_body_target": pose, "covariance": block.tolist()}
        out[name] |= {"shift": None, "prior": None, "open": []}
        if name in setup.alignment:
            off = se3.inverse(setup.mounts[name]) @ result.state.mounts[name]
            prior = setup.alignment[name]
            ratio = np.sqrt(np.diag(block)) / prior
            unseen = [3 + axis for axis in setup.targets[name].turns]
            held = [MOUNT[k] for k in range(6) if ratio[k] > HELD and k not in unseen]
            shift = se3.se3_log(off).tolist()
            out[name] |= {"shift": shift, "prior": prior.tolist(), "open": held}
    return out


def noise(setup, result):
    """Re-estimated σ by sensor and kind, SI or px, and the factor on the priors of the MCS."""
    out = {}
    for (sensor, kind), scale in sorted(result.state.noise.items()):
        if sensor not in setup.models:
            continue
        sigmas = [
            g.keypoints["sigma"] for g in setup.groups if (g.sensor, g.kind) == (sensor, kind)
        ]
        out.setdefault(sensor, {})[kind] = float(scale.total * np.median(np.concatenate(sigmas)))
    return {"sensors": out, "mocap_factor": float(result.state.mocap)}


def pair_of(value):
    """Values (n, k) as the table holds them (n, 2): u and v, or a length and 0."""
    if value.shape[1] == 2:
        return value
    length = value[:, 0] if value.shape[1] == 1 else np.linalg.norm(value, axis=1)
    return np.column_stack([length, np.zeros(len(value))])
