"""What was estimated beside the poses: clocks, mounts, lenses, ranges, markers."""

import numpy as np

from calib.report import number_format
from calib.report.sections import extrinsics
from calib.report.sections.extrinsics import MM
from calib.sensors import sensor_models
from calib.sensors.camera import camera_model
from calib.targets import target_shapes

AXES = [f"{what} {axis}" for what in ("the place along", "the turn about") for axis in "xyz"]
CORRECTED = {  # what was estimated of a sensor besides, by name of the Hypothesis
    "apart": "returns and outlines",
    "beam_width": "width of the beams",
    "beams": "ranges of single beams",
    "range_bias": "ranges",
}


def other_unknowns(run):
    """(name, text or None) of everything beside the poses that could have been estimated."""
    rows = []
    for name, s in run.sensors.items():
        rows.append((f"time offset of {name}", _offset(s)))
        wander = sorted((s["time_wander"] or {}).items())
        rows += [(f"clock of {name} in {session}", _wander(w)) for session, w in wander]
        if s["kind"] == "camera":
            rows.append((f"intrinsics of {name}", _lens(run, name, s)))
        rows += [(f"{CORRECTED[c['name']]} of {name}", c["text"]) for c in s["corrections"]]
        rows += [(f"ranges of {name}, all together", told) for told in _in_common(s)]
    for name, lag in sorted(run.calibration["mocap_offsets_s"].items()):
        rows.append((f"stamps of {name} against the robot's", _ms(lag)))
    for name, target in sorted(run.calibration["targets"].items()):
        rows.append((f"alignment of {name} in its MCS body", _alignment(run, name, target)))
    for name, session in sorted(run.calibration["sessions"].items()):
        if session:
            T = np.array(session["T_robot_markers"]["matrix"])
            rows.append((f"robot markers in {name}, in R", _pose(T, session["covariance"])))
    return rows


def _in_common(sensor):
    """What the beams of a lidar may be off by in common where single ones were found to be off and
    that is not estimated (considered.errors), in a list."""
    found = {c["name"]: np.array(c["estimate"]) for c in sensor["corrections"]}
    if "beams" not in found or "range_bias" in found:
        return []
    # The numbers of beams are along an orthonormal basis: their squares are those of the errors.
    theta = found["beams"]
    sigma = np.sqrt(np.sum(theta**2) / len(theta) / (len(theta) + 1))
    return [
        f"0 ± {number_format.number(sigma * MM, 2)} mm, not estimated, but in the σ of the pose: "
        "targets on one side of a lidar do not tell ranges that are too long from a lidar farther "
        "back"
    ]


def _offset(sensor):
    """A sensor's offset with its σ and where it comes from, or why there is none."""
    offset, clock = sensor["time_offset_s"], sensor["clock"] or None
    if not offset:
        return clock
    return f"{_ms(offset)}, {clock}"


def _ms(offset):
    """`25.123 ± 0.14 ms` of an offset, s, with its σ."""
    value = number_format.fixed(offset["value"] * MM, 3)
    return f"{value} ± {number_format.number(offset['sigma'] * MM, 2)} ms"


def _wander(found):
    """Offset in the middle of a session and drift within it, with their σ."""
    drift = found["drift_ppm"]
    told = (
        f"{number_format.number(drift['value'], 3)} ± {number_format.number(drift['sigma'], 2)} ppm"
    )
    return f"{_ms(found['time_offset_s'])} in its middle, drift {told}"


def _pose(T, covariance):
    """`x 1.2 ± 0.1 mm, ...` of a pose (4, 4)."""
    rows = extrinsics.rows(T, covariance, None, None)
    return ", ".join(f"{r['name']} {r['value']} ± {r['sigma']} {r['unit']}" for r in rows)


def _alignment(run, name, target):
    """Where a target sits in its body, who decided that, and what the data cannot tell of it; a
    turn that nobody could see does not matter and is not asked for."""
    if not target:
        return None
    T = np.array(target["T_body_target"]["matrix"])
    told = _pose(T, target["covariance"])
    if target["prior"] is None:
        return told
    ratio = np.sqrt(np.diag(target["covariance"])) / target["prior"]
    unseen = [3 + axis for axis in target_shapes.from_config(run.options["targets"][name]).turns]
    matters = np.setdiff1d(np.arange(6), unseen)
    low, high = (number_format.number(v, 2) for v in (ratio[matters].min(), ratio[matters].max()))
    told += f"; σ is {low} to {high} of its prior"
    if unseen:
        told += f"; {', '.join(AXES[i] for i in unseen)} of the target does not matter"
    if target["open"]:
        told += f": nothing tells {', '.join(target['open'])}; tilt it to more sides"
    return told


def _lens(run, name, sensor):
    """Parameters of a camera with their σ and what they were; or why there are none."""
    found = sensor["intrinsics"]
    if not found:
        return sensor["lens"] or None
    names = camera_model.MODELS[found["model"]].PARAMS
    # A camera pads what its config leaves out with zeros.
    before = sensor_models.camera(run.options["sensors"][name]).params
    rows = zip(names, before, found["params"], found["sigma"], strict=False)
    number = number_format.number
    return ", ".join(f"{n} {number(a, 5)} → {number(b, 5)} ± {number(s, 2)}" for n, a, b, s in rows)
