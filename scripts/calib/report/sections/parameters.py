"""Parameters estimated beside the poses: time offsets, mounts, lenses, ranges, robot markers."""

from typing import Any, NamedTuple

import numpy as np

from calib.geometry.units import MM_PER_M, MS_PER_S, SHARE_TO_PERCENT
from calib.report.data.run_data import ReportRun
from calib.report.number_format import format_decimals, format_number
from calib.report.sections.extrinsics import tabulate_pose
from calib.sensors.camera.camera_model import CAMERA_MODELS
from calib.sensors.sensor_models import camera_from_config
from calib.targets.target_shapes import target_from_config

CORRECTION_LABELS = {
    "outline_vs_surface": "returns and outlines",
    "beam_width": "width of the beams",
    "beam_offsets": "ranges of single beams",
    "range_bias": "ranges",
    "dark_ranges": "ranges of dark squares",
    "intensity_ranges": "ranges by intensity",
}


class NuisanceParameter(NamedTuple):
    """A parameter beside the poses, and its estimate as text; None if it is not estimated."""

    name: str
    estimate: str | None


def tabulate_nuisance_parameters(run: ReportRun) -> list[NuisanceParameter]:
    """Return all parameters beside the poses that the solve can estimate."""
    calibration = run.calibration
    rows = []
    for name, sensor in run.sensors.items():
        rows += _list_sensor_parameters(run, name, sensor)
    rows += [
        NuisanceParameter(f"time offset of the stream of {name}", _format_ms(offset))
        for name, offset in sorted(calibration["mocap_offsets_s"].items())
    ]
    rows += [
        NuisanceParameter(f"scale of the motion capture in {name}", _format_scale_error(scale))
        for name, scale in sorted(calibration["mocap_scales"].items())
    ]
    rows += [
        NuisanceParameter(f"mount of {name} in its MCS body", _format_mount(run, name, block))
        for name, block in sorted(calibration["targets"].items())
    ]
    rows += [
        NuisanceParameter(f"shape of {name}", shape["description"])
        for name, shape in sorted(calibration["board_shapes"].items())
    ]
    for name, block in sorted(calibration["sessions"].items()):
        if block:
            T = np.array(block["T_robot_markers"]["matrix"])
            text = _format_pose(T, block["covariance"])
            rows.append(NuisanceParameter(f"robot markers in {name}, robot frame", text))
    return rows


def _list_sensor_parameters(
    run: ReportRun, name: str, sensor: dict[str, Any]
) -> list[NuisanceParameter]:
    """Return time offset, clock drift, intrinsics and corrections of one sensor."""
    rows = [NuisanceParameter(f"time offset of {name}", _format_time_offset(sensor))]
    rows += [
        NuisanceParameter(f"clock of {name} in {session}", _format_clock_drift(drift))
        for session, drift in sorted((sensor["clock_drift"] or {}).items())
    ]
    if sensor["kind"] == "camera":
        rows.append(NuisanceParameter(f"intrinsics of {name}", _format_intrinsics(run, name)))
    rows += [
        NuisanceParameter(f"{CORRECTION_LABELS[c['name']]} of {name}", c["description"])
        for c in sensor["corrections"]
    ]
    sigma = sensor["common_range_sigma_m"]
    if sigma is not None:
        label = f"ranges of {name}, all together"
        rows.append(NuisanceParameter(label, _format_common_range_error(sigma)))
    return rows


def _format_common_range_error(sigma_m: float) -> str:
    """Format the range error that all beams of a lidar have in common, which σ includes."""
    return (
        f"0 ± {format_number(sigma_m * MM_PER_M, 2)} mm, not estimated, but included in the σ of "
        "the pose: targets on one side of a lidar cannot distinguish ranges that are too long "
        "from a lidar that sits farther back"
    )


def _format_time_offset(sensor: dict[str, Any]) -> str | None:
    """Format the time offset of a sensor with its σ and source, or why it is not estimated."""
    offset, note = sensor["time_offset_s"], sensor["time_offset_note"] or None
    return f"{_format_ms(offset)}, {note}" if offset else note


def _format_ms(offset_s: dict[str, float]) -> str:
    """Format an offset, s, with its σ: `25.123 ± 0.14 ms`."""
    value = format_decimals(offset_s["value"] * MS_PER_S, 3)
    return f"{value} ± {format_number(offset_s['sigma'] * MS_PER_S, 2)} ms"


def _format_scale_error(scale: dict[str, float]) -> str:
    """Format the error of a scale, a share, with its σ: `distances 0.401 ± 0.06 % too long`."""
    value, sigma = (SHARE_TO_PERCENT * scale[key] for key in ("value", "sigma"))
    side = "long" if value > 0 else "short"
    return f"distances {abs(value):.3f} ± {format_number(sigma, 2)} % too {side}"


def _format_clock_drift(block: dict[str, Any]) -> str:
    """Format the time offset in the middle of a session and the drift within it, with their σ."""
    drift = block["drift_ppm"]
    ppm = f"{format_number(drift['value'], 3)} ± {format_number(drift['sigma'], 2)} ppm"
    return f"{_format_ms(block['time_offset_s'])} in the middle, drift {ppm}"


def _format_pose(T: np.ndarray, covariance: list[list[float]]) -> str:
    """Format a pose (4, 4): `x 1.2 ± 0.1 mm, ...`."""
    rows = tabulate_pose(T, covariance)
    return ", ".join(f"{r['name']} {r['value']} ± {r['sigma']} {r['unit']}" for r in rows)


def _format_mount(run: ReportRun, name: str, block: dict[str, Any] | None) -> str | None:
    """Format the mount of a target, how much the data improve it, and what they do not determine.

    Rotations about an axis of symmetry do not matter and are not asked for.
    """
    if not block:
        return None
    text = _format_pose(np.array(block["T_body_target"]["matrix"]), block["covariance"])
    if block["prior_sigma"] is None:
        return text
    ratio = np.sqrt(np.diag(block["covariance"])) / block["prior_sigma"]
    symmetry_axes = target_from_config(run.options["targets"][name]).symmetry_axes
    matters = np.setdiff1d(np.arange(6), [3 + axis for axis in symmetry_axes])
    low, high = (format_number(v, 2) for v in (ratio[matters].min(), ratio[matters].max()))
    text += f"; σ is {low} to {high} of its prior"
    if symmetry_axes:
        axes = ", ".join("xyz"[axis] for axis in symmetry_axes)
        text += f"; its rotation about {axes} does not matter"
    if block["undetermined"]:
        text += f"; undetermined: {', '.join(block['undetermined'])}: tilt it to more sides"
    return text


def _format_intrinsics(run: ReportRun, name: str) -> str | None:
    """Format the parameters of a camera, before and after with σ, or why they are not estimated."""
    sensor = run.sensors[name]
    block = sensor["intrinsics"]
    if not block:
        return sensor["intrinsics_note"] or None
    # A camera model pads the parameters that its config leaves out with zeros.
    before = camera_from_config(run.options["sensors"][name]).params
    names = CAMERA_MODELS[block["model"]].PARAMETER_NAMES
    rows = zip(names, before, block["params"], block["sigma"], strict=False)
    return ", ".join(
        f"{n} {format_number(a, 5)} → {format_number(b, 5)} ± {format_number(s, 2)}"
        for n, a, b, s in rows
    )
