"""What went wrong or nearly so, ranked by what it costs."""

from calib.report import number_format
from calib.report.sections.extrinsics import DEG, MM
from calib.verdict import findings

SMALL_IS_BAD = ("placements", "tilt_deg")


def rows(run, sessions):
    """{level, text, cost, remedy} of every finding, then of every loss of views, each the costliest
    first; sessions: {session: rows of funnel.table}."""
    found = [(_rank(run, f), f) for f in run.verdict["findings"]]
    found.sort(key=lambda item: (-findings.LEVELS.index(item[1]["level"]), -item[0][0]))
    out = [
        {"level": f["level"], "text": f["text"], "cost": cost, "remedy": f["remedy"]}
        for (_, cost), f in found
    ]
    return out + losses(run, sessions)


def _rank(run, finding):
    """(how many times its limit, that in words) of one finding."""
    check, value, limit = (finding[k] for k in ("check", "value", "limit"))
    if check == "status":
        return float("inf"), f"the pose of {', '.join(finding['sensors'])}"
    if check == "suspicion":
        return _by_suspicion(run, finding)
    if check == "moved":
        return _by_session(run, finding)
    if value is None or not limit:
        return 1.0, number_format.DASH
    times = limit / max(value, 1e-9) if check in SMALL_IS_BAD else value / limit
    told = f"{number_format.number(times, 2)} × the limit"
    if check in SMALL_IS_BAD:
        told = f"{number_format.number(100 * value / limit, 2)} % of the limit"
    return times, told


def _by_suspicion(run, finding):
    """What mending a suspicion would move, in the verdict's own limit."""
    own = [s for s in run.calibration["suspicions"] if s["text"] in finding["text"]]
    moved = [(by["sigmas"], n, by) for s in own for n, by in s["shift"].items()]
    if not moved:
        return 1.0, number_format.DASH
    sigmas, name, by = max(moved, key=lambda m: m[0])
    m, deg = number_format.number(by["m"] * MM, 2), number_format.number(by["rad"] * DEG, 2)
    far = f"{m} mm, {deg}° of {name}"
    return sigmas / run.verdict["limits"].get("warn_shift_sigma", 1.0), far


def _by_session(run, finding):
    """How far a sensor moved between sessions, over what a position may be unsure by."""
    own = [r for r in run.calibration["repeatability"] if r["sensor"] in finding["sensors"]]
    far = max((sum(v**2 for v in r["shift"][:3]) ** 0.5 for r in own), default=0.0)
    limit = run.verdict["limits"]["warn_sigma_m"]
    return far / limit, f"{number_format.number(far * MM, 2)} mm between sessions"


def losses(run, sessions):
    """Rows of views that were kept but told nothing, and of targets that a sensor never saw."""
    out, used = [], {}
    for session, table in sessions.items():
        for row in table:
            kept, extracted, told = row["numbers"][2:]
            key = row["sensor"], row["target"]
            used[key] = used.get(key, 0) + told
            if kept > told:
                share = (kept - told) / kept
                why = {step: reason for step, _, reason in reversed(row["losses"])}
                reason = why.get("not found") if kept > extracted else why.get("not used")
                words = f"{row['sensor']}, {row['target']}, {session}: {reason}"
                views = number_format.plural(kept, "kept view")
                cost = f"{number_format.count(kept - told)} of {views}"
                out.append((share, {"text": words, "cost": cost, "remedy": ""}))
    for (sensor, target), n in sorted(used.items()):
        if not n and run.sensors[sensor]["T_robot_sensor"]:
            words = f"no view of {target} by {sensor} was used"
            remedy = "hold it where this sensor sees it, if that is what tells it best"
            out.append((0.0, {"text": words, "cost": "one kind of target", "remedy": remedy}))
    out.sort(key=lambda item: -item[0])
    return [{"level": "note"} | row for _, row in out]
