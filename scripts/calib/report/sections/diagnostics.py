"""What went wrong or nearly so, ranked by what it costs."""

from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.number_format import DASH, format_count, format_number, format_plural
from calib.verdict.findings import VERDICT_LEVELS

LOWER_LIMIT_CHECKS = ("placements", "tilt_deg")


def tabulate_diagnostics(run, losses_by_session):
    """{level, text, cost, remedy} of every finding, then of every loss of views, each the costliest
    first; losses_by_session: {session: rows of funnel.table}."""
    found = [(_rank_finding(run, f), f) for f in run.verdict["findings"]]
    found.sort(key=lambda item: (-VERDICT_LEVELS.index(item[1]["level"]), -item[0][0]))
    out = [
        {"level": f["level"], "text": f["text"], "cost": cost, "remedy": f["remedy"]}
        for (_, cost), f in found
    ]
    return out + tabulate_lost_views(run, losses_by_session)


def _rank_finding(run, finding):
    """(how many times its limit, that in words) of one finding."""
    check, value, limit = (finding[k] for k in ("check", "value", "limit"))
    if check == "status":
        return float("inf"), f"the pose of {', '.join(finding['sensors'])}"
    if check == "suspected_error":
        return _rank_suspected_error(run, finding)
    if check == "sensor_moved":
        return _rank_session_move(run, finding)
    if finding["ratio"] is None:
        return 1.0, DASH
    told = f"{format_number(finding['ratio'], 2)} × the limit"
    if check in LOWER_LIMIT_CHECKS:
        told = f"{format_number(100 * value / limit, 2)} % of the limit"
    return finding["ratio"], told


def _rank_suspected_error(run, finding):
    """What mending a suspicion would move, in the verdict's own limit."""
    own = [s for s in run.calibration["suspected_errors"] if s["description"] in finding["text"]]
    moved = [(by["sigmas"], n, by) for s in own for n, by in s["pose_shift"].items()]
    if not moved:
        return 1.0, DASH
    sigmas, name, by = max(moved, key=lambda m: m[0])
    m, deg = format_number(by["m"] * MM_PER_M, 2), format_number(by["rad"] * DEG_PER_RAD, 2)
    far = f"{m} mm, {deg}° of {name}"
    return sigmas / run.verdict["limits"].get("warn_error_moves_pose_sigma", 1.0), far


def _rank_session_move(run, finding):
    """How far a sensor moved between sessions, over what a position may be unsure by."""
    own = [r for r in run.calibration["repeatability"] if r["sensor"] in finding["sensors"]]
    far = max((sum(v**2 for v in r["shift"][:3]) ** 0.5 for r in own), default=0.0)
    limit = run.verdict["limits"]["warn_sigma_m"]
    return far / limit, f"{format_number(far * MM_PER_M, 2)} mm between sessions"


def tabulate_lost_views(run, losses_by_session):
    """Rows of views that were kept but told nothing, and of targets that a sensor never saw."""
    out, used = [], {}
    for session, table in losses_by_session.items():
        for row in table:
            kept, extracted, told = row["numbers"][2:]
            key = row["sensor"], row["target"]
            used[key] = used.get(key, 0) + told
            if kept > told:
                share = (kept - told) / kept
                why = {step: reason for step, _, reason in reversed(row["losses"])}
                reason = why.get("not found") if kept > extracted else why.get("not used")
                words = f"{row['sensor']}, {row['target']}, {session}: {reason}"
                views = format_plural(kept, "kept view")
                cost = f"{format_count(kept - told)} of {views}"
                out.append((share, {"text": words, "cost": cost, "remedy": ""}))
    for (sensor, target), n in sorted(used.items()):
        if not n and run.sensors[sensor]["T_robot_sensor"]:
            words = f"no view of {target} by {sensor} was used"
            remedy = "hold it where this sensor sees it, if that is what tells it best"
            out.append((0.0, {"text": words, "cost": "one kind of target", "remedy": remedy}))
    out.sort(key=lambda item: -item[0])
    return [{"level": "note"} | row for _, row in out]
