"""The content of preflight.json: what sensors see and how targets turn, as numbers."""

from typing import Any

from calib.geometry.rotation_spread import rotation_spread_deg
from calib.verdict.preflight_findings import (
    Sessions,
    Visibility,
    new_target_poses,
    visibility_summary,
)
from calib.verdict.preflight_visibility import SensorVisibility

MIN_TURN_PLACEMENTS = 3


def target_turns_json(sessions: Sessions, options: dict[str, Any]) -> dict[str, Any]:
    """Return {target: {placements, rotation_spread_deg}}.

    placements: whose pose is new to crop. rotation_spread_deg: rms rotation about the three main
    axes, largest first; None if there are fewer than 3 placements.
    """
    out = {}
    for target in sorted(options["targets"]):
        T = new_target_poses(sessions, target, options)
        spread = rotation_spread_deg(T)[0].tolist() if len(T) >= MIN_TURN_PLACEMENTS else None
        out[target] = {"placements": len(T), "rotation_spread_deg": spread}
    return out


def sensor_visibility_json(visibility: Visibility) -> dict[str, Any]:
    """Return {sensor: {placements, direction_spread_deg, moving_views, sessions}}.

    placements: in view from the stated pose (expected) and from any pose within its σ (possible).
    direction_spread_deg: of the targets in these. sessions: what is seen and lost in each, and why.
    """
    out = {}
    for name, by_session in visibility.items():
        usable = [v for v in by_session.values() if v.status.ok]
        targets = [t for v in usable for t in v.visibility_by_target.values()]
        expected = possible = None
        if usable:
            possible = visibility_summary(usable, "possible_reasons")
            if all(t.has_known_pose for t in targets):
                expected = visibility_summary(usable, "expected_reasons")
        out[name] = {
            "placements": {
                "expected": expected["placements"] if expected else None,
                "possible": possible["placements"] if possible else 0,
            },
            "direction_spread_deg": possible["direction_spread_deg"] if possible else {},
            "moving_views": sum(v.n_moving_views for v in usable),
            "sessions": {s: _session_visibility_json(v) for s, v in by_session.items()},
        }
    return out


def _session_visibility_json(visibility: SensorVisibility) -> dict[str, Any]:
    return {
        "status": visibility.status.to_dict(),
        "pose_source": visibility.pose_source,
        "mocap_coverage": visibility.mocap_coverage,
        "targets": {
            name: {
                "placements": len(t.T_robot_target),
                "expected": t.expected_reasons.count("") if t.has_known_pose else None,
                "possible": t.possible_reasons.count(""),
                "not_visible": t.count_lost_placements(),
                "moving_views": t.n_moving_views,
            }
            for name, t in visibility.visibility_by_target.items()
        },
    }
