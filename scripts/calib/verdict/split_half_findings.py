"""Findings on split halves: σ that two halves of the placements do not confirm."""

from typing import Any

import numpy as np

from calib.diagnosis.error_search.supported_corrections import CORRECTIONS_BY_KEY
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.verdict.findings import Finding, Limits, make_finding, with_limit

CHECK = "split_half"
SAME_CHOICE_REMEDY = (
    "Something differs between placements that is not estimated. Check that the target and all "
    "markers are rigid, and the lens. Until then multiply σ by {factor:.1f}."
)
OTHER_CHOICE_REMEDY = (
    "The halves chose different corrections: {first}, and {second}. Record more placements, or "
    "set {key} to false. Until then multiply σ by {factor:.1f}."
)


def split_half_findings(split_halves: dict[str, Any] | None, limits: Limits) -> list[Finding]:
    """Return one finding for each sensor whose poses of two halves differ by more than σ says."""
    if split_halves is None:
        return []
    out, limit = [], limits[f"warn_{CHECK}"]
    for name, sensor in sorted(split_halves["sensors"].items()):
        ratio = sensor["nees"] / sensor["n_directions"]
        if ratio > limit:
            out.append(with_limit(_finding(name, sensor, split_halves["adopted"]), ratio, limit))
            out[-1]["text"] += f", warn above {limit:.3g}"
    return out


def format_choice(adopted: list[dict[str, str]]) -> str:
    """Return the corrections that a half adopted, `beam offsets of lidar`, or `none`."""
    names = [f"{c['name'].replace('_', ' ')} of {c['subject']}" for c in adopted]
    return ", ".join(names) or "none"


def _config_key(correction: str) -> str:
    """Return the key of the config that forbids the estimation of a correction."""
    keys = (key for key, names in CORRECTIONS_BY_KEY.items() if correction in names)
    return f"solve.estimate.{next(keys, 'lidar_corrections')}"


def _finding(name: str, sensor: dict[str, Any], adopted: list[list[dict[str, str]]]) -> Finding:
    m, rad = np.linalg.norm(np.reshape(sensor["shift"], (2, 3)), axis=1)
    ratio = sensor["nees"] / sensor["n_directions"]
    factor = float(np.sqrt(ratio))
    remedy = SAME_CHOICE_REMEDY.format(factor=factor)
    if adopted[0] != adopted[1]:
        first, second = map(format_choice, adopted)
        disputed = [c for c in adopted[0] + adopted[1] if (c in adopted[0]) != (c in adopted[1])]
        key = _config_key(disputed[0]["name"])
        remedy = OTHER_CHOICE_REMEDY.format(first=first, second=second, key=key, factor=factor)
    text = (
        f"{name}: poses from two halves of the placements differ by {m * MM_PER_M:.2g} mm and "
        f"{rad * DEG_PER_RAD:.2g}°, their squared difference is {ratio:.3g} times what σ says"
    )
    return make_finding(CHECK, [name], "warn", text=text, remedy=remedy)
