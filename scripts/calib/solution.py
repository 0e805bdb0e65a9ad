"""What a settled estimate says, as solution.json and as rows of residuals.parquet."""

from importlib.metadata import version

import numpy as np

from calib import estimation, geometry, kinds, observability, rig, tables
from calib.kinds.assignment import loss_weight
from calib.status import OK, failed

PACKAGES = ("casadi", "mcap", "numpy", "opencv-python-headless", "pyarrow", "rosbags", "scipy")
UNIT = {"camera": "px", "lidar": "m"}


def as_json(setup, result, known, options):
    """The content of solution.json; known: sensor -> (status before the solve, guess.json)."""
    names = sorted(setup.models)
    open_directions = {n: directions(setup, result, i) for i, n in enumerate(names)}
    status = {n: outcome(n, known, open_directions, result) for n in options["sensors"]}
    solved = [n for n in names if status[n].ok]
    joint = joint_covariance(setup, result, solved) if solved else None
    sensors = {}
    for name, (_, guess) in sorted(known.items()):
        sensors[name] = {
            "kind": options["sensors"][name]["kind"],
            "frame": guess["frame"],
            "status": status[name].to_dict(),
            "guess": {k: guess[k] for k in ("T_robot_sensor", "sigma", "source")},
            "undetermined": open_directions.get(name, []),
            **pose_of(name, result, solved, joint),
            **counts(name, options["sensors"][name]["kind"], setup, result),
        }
    return {
        "rig": options["rig"],
        "settled": result.settled,
        "ipopt": result.solution.status if result.solution else None,
        "sensors": sensors,
        "joint_covariance": {"order": solved, "matrix": joint.tolist()} if solved else None,
        "targets": dict.fromkeys(sorted(options["targets"])),
        "noise": noise(setup, result),
        "provenance": {
            "sessions": options["sessions"],
            "packages": {p: version(p) for p in PACKAGES},
        },
    }


def directions(setup, result, i):
    """The undetermined directions of sensor i in words."""
    name = sorted(setup.models)[i]
    T = result.state.T_robot_sensor[name]
    found = observability.undetermined(result.solution.information, len(setup.models), i)
    return [observability.in_words(d, T) for d in found]


def outcome(name, known, open_directions, result):
    """Status of one sensor after the solve."""
    before, _ = known[name]
    if not before.ok:
        return before
    if open_directions[name]:
        return failed(
            f"the data do not determine {name}: {'; '.join(open_directions[name])}",
            f"{len(open_directions[name])} open directions",
            "none",
            "Record placements that differ in those directions, with tilted targets.",
        )
    if not result.solution.success:
        return failed(f"IPOPT ended with {result.solution.status}", remedy="See solve.log.")
    return OK


def joint_covariance(setup, result, solved):
    """(6k, 6k) over the solved sensors in order; what is not solved is marginalised out."""
    names = sorted(setup.models)
    rows = [6 * names.index(n) + i for n in solved for i in range(6)]
    return estimation.covariance(result.solution.information)[np.ix_(rows, rows)]


def pose_of(name, result, solved, joint):
    """T_robot_sensor, its covariance and weakest direction; null for a sensor without a pose."""
    if name not in solved:
        return {"T_robot_sensor": None, "covariance": None, "weakest": None}
    T = result.state.T_robot_sensor[name]
    at = 6 * solved.index(name)
    block = joint[at : at + 6, at : at + 6]
    words, sigma = observability.weakest(block, T)
    return {
        "T_robot_sensor": rig.pose_json(T),
        "covariance": block.tolist(),
        "weakest": {"direction": words, "sigma": sigma},
    }


def counts(name, kind, setup, result):
    """Placements, observations and points used, share rejected, and the rms of what is left."""
    used, views, squares, candidates, members = set(), set(), [], 0, 0
    for g, a in zip(setup.groups, result.assigned, strict=True):
        if g.sensor != name:
            continue
        member = a.feature >= 0
        candidates += int(a.candidate.sum())
        members += int((member & a.candidate).sum())
        if member.any():
            used.add(g.placement)
            session = setup.placements[g.placement].session
            views |= {(session, int(v)) for v in np.unique(g.keypoints["view"][member])}
        unit = kinds.KINDS[g.kind].UNIT
        if unit == UNIT[kind]:
            squares.append((a.value[member] ** 2).sum(1))
    squares = np.concatenate(squares) if squares else np.zeros(0)
    rms = float(np.sqrt(squares.mean())) if len(squares) else None
    return {
        "placements": len(used),
        "observations": len(views),
        "points": members,
        "rejected": 1 - members / candidates if candidates else 0.0,
        "residual": {"rms": rms, "unit": UNIT[kind]},
    }


def noise(setup, result):
    """Re-estimated σ by sensor and kind, SI or px, and the factor on the priors of the MCS."""
    out = {}
    for (sensor, kind), scale in sorted(result.state.noise.items()):
        sigmas = [
            g.keypoints["sigma"] for g in setup.groups if (g.sensor, g.kind) == (sensor, kind)
        ]
        out.setdefault(sensor, {})[kind] = float(scale * np.median(np.concatenate(sigmas)))
    return {"sensors": out, "mocap_factor": float(result.state.mocap)}


def residuals(setup, result):
    """Columns of residuals.parquet."""
    parts, gate = [], setup.associate["gate_sigma"]
    for g, a in zip(setup.groups, result.assigned, strict=True):
        place = setup.placements[g.placement]
        n = len(a.feature)
        k = g.keypoints
        T = estimation.T_sensor_target(setup, result.state, g.sensor, g.placement)
        in_target = geometry.transform(geometry.inverse(T), np.nan_to_num(k["xyz"]))
        in_image = kinds.KINDS[g.kind].UNIT == "px"
        pixel = np.column_stack([k["uv"], np.zeros(n)])
        parts.append(
            {
                "session": np.full(n, place.session),
                "sensor": np.full(n, g.sensor),
                "target": np.full(n, place.target),
                "placement": k["placement"],
                "view": k["view"],
                "kind": np.full(n, g.kind),
                "value": _pair(a.value),
                "sigma": a.sigma,
                "weight": np.where(a.feature >= 0, loss_weight(a.size, gate), 0.0),
                "measured": pixel if in_image else in_target,
                "range": a.range,
                "cosine": a.cosine,
                "index": a.feature if g.kind == "corner" else k["index"],
            }
        )
    return tables.concatenate(parts, tables.RESIDUALS)


def _pair(value):
    """Values (n, k) as the table holds them (n, 2): u and v, or a length and 0."""
    if value.shape[1] == 2:
        return value
    length = value[:, 0] if value.shape[1] == 1 else np.linalg.norm(value, axis=1)
    return np.column_stack([length, np.zeros(len(value))])
