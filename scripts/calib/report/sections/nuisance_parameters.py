"""What was estimated beside the poses: clocks, mounts, lenses, ranges, markers."""

import numpy as np

from calib.geometry.units import MM_PER_M, MS_PER_S
from calib.report.number_format import format_decimals, format_number
from calib.report.sections.extrinsics import tabulate_pose
from calib.sensors.camera.camera_model import CAMERA_MODELS
from calib.sensors.sensor_models import camera_from_config
from calib.targets.target_shapes import target_from_config

MOUNT_AXES = [f"{what} {axis}" for what in ("the place along", "the turn about") for axis in "xyz"]
CORRECTION_LABELS = {  # what was estimated of a sensor besides, by name of the Hypothesis
    "outline_vs_surface": "returns and outlines",
    "beam_width": "width of the beams",
    "beam_offsets": "ranges of single beams",
    "range_bias": "ranges",
}


def tabulate_nuisance_parameters(run):
    """(name, text or None) of everything beside the poses that could have been estimated."""
    rows = []
    for name, s in run.sensors.items():
        rows.append((f"time offset of {name}", _format_time_offset(s)))
        wander = sorted((s["clock_drift"] or {}).items())
        rows += [(f"clock of {name} in {session}", _format_clock_drift(w)) for session, w in wander]
        if s["kind"] == "camera":
            rows.append((f"intrinsics of {name}", _format_intrinsics(run, name, s)))
        rows += [
            (f"{CORRECTION_LABELS[c['name']]} of {name}", c["description"])
            for c in s["corrections"]
        ]
        rows += [
            (f"ranges of {name}, all together", told) for told in _format_common_range_error(s)
        ]
    for name, lag in sorted(run.calibration["mocap_offsets_s"].items()):
        rows.append((f"stamps of {name} against the robot's", _format_ms(lag)))
    for name, target in sorted(run.calibration["targets"].items()):
        rows.append((f"alignment of {name} in its MCS body", _format_mount(run, name, target)))
    for name, session in sorted(run.calibration["sessions"].items()):
        if session:
            T = np.array(session["T_robot_markers"]["matrix"])
            rows.append((f"robot markers in {name}, in R", _format_pose(T, session["covariance"])))
    return rows


def _format_common_range_error(sensor):
    """`0 ± 0.97 mm, ...` of the range error common to all beams of a lidar, if σ includes it."""
    sigma = sensor["common_range_sigma_m"]
    if sigma is None:
        return []
    return [
        f"0 ± {format_number(sigma * MM_PER_M, 2)} mm, not estimated, but included in the σ of the "
        "pose: targets on one side of a lidar cannot distinguish ranges that are too long from a "
        "lidar that sits farther back"
    ]


def _format_time_offset(sensor):
    """A sensor's offset with its σ and where it comes from, or why there is none."""
    offset, clock = sensor["time_offset_s"], sensor["time_offset_note"] or None
    if not offset:
        return clock
    return f"{_format_ms(offset)}, {clock}"


def _format_ms(offset):
    """`25.123 ± 0.14 ms` of an offset, s, with its σ."""
    value = format_decimals(offset["value"] * MS_PER_S, 3)
    return f"{value} ± {format_number(offset['sigma'] * MS_PER_S, 2)} ms"


def _format_clock_drift(clock_drift):
    """Offset in the middle of a session and drift within it, with their σ."""
    drift = clock_drift["drift_ppm"]
    told = f"{format_number(drift['value'], 3)} ± {format_number(drift['sigma'], 2)} ppm"
    return f"{_format_ms(clock_drift['time_offset_s'])} in its middle, drift {told}"


def _format_pose(T, covariance):
    """`x 1.2 ± 0.1 mm, ...` of a pose (4, 4)."""
    rows = tabulate_pose(T, covariance, None, None)
    return ", ".join(f"{r['name']} {r['value']} ± {r['sigma']} {r['unit']}" for r in rows)


def _format_mount(run, name, target):
    """Where a target sits in its body, who decided that, and what the data cannot tell of it; a
    turn that nobody could see does not matter and is not asked for."""
    if not target:
        return None
    T = np.array(target["T_body_target"]["matrix"])
    told = _format_pose(T, target["covariance"])
    if target["prior_sigma"] is None:
        return told
    ratio = np.sqrt(np.diag(target["covariance"])) / target["prior_sigma"]
    unseen = [3 + axis for axis in target_from_config(run.options["targets"][name]).symmetry_axes]
    matters = np.setdiff1d(np.arange(6), unseen)
    low, high = (format_number(v, 2) for v in (ratio[matters].min(), ratio[matters].max()))
    told += f"; σ is {low} to {high} of its prior"
    if unseen:
        told += f"; {', '.join(MOUNT_AXES[i] for i in unseen)} of the target does not matter"
    if target["undetermined"]:
        told += f": nothing tells {', '.join(target['undetermined'])}; tilt it to more sides"
    return told


def _format_intrinsics(run, name, sensor):
    """Parameters of a camera with their σ and what they were; or why there are none."""
    found = sensor["intrinsics"]
    if not found:
        return sensor["intrinsics_note"] or None
    names = CAMERA_MODELS[found["model"]].PARAMETER_NAMES
    # A camera pads what its config leaves out with zeros.
    before = camera_from_config(run.options["sensors"][name]).params
    rows = zip(names, before, found["params"], found["sigma"], strict=False)
    number = format_number
    return ", ".join(f"{n} {number(a, 5)} → {number(b, 5)} ± {number(s, 2)}" for n, a, b, s in rows)
