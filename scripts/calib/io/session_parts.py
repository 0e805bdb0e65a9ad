"""Sessions that remounted_at_s cuts: what comes before the robot's markers moved, and after."""

from typing import Any

from calib.io.status import InputError

CUT_KEY = "remounted_at_s"
PART_SUFFIX = "_after"  # of the name of the later part


def cut_sessions(sessions: dict[str, dict[str, Any]], file_name: str) -> dict[str, dict[str, Any]]:
    """Return the sessions by name, those with CUT_KEY as two, each with `is_part`.

    The later part has remounted: true, so that the place of the markers is estimated.
    """
    out: dict[str, dict[str, Any]] = {}
    for name, session in sessions.items():
        whole = {k: v for k, v in session.items() if k != CUT_KEY}
        if CUT_KEY not in session:
            out[name] = whole | {"is_part": False}
            continue
        cut_s, later = session[CUT_KEY], f"{name}{PART_SUFFIX}"
        _require_cuttable(name, sessions, file_name)
        out[name] = whole | {"is_part": True, "to_s": cut_s}
        out[later] = whole | {"is_part": True, "from_s": cut_s, "remounted": True}
    return out


def _require_cuttable(name: str, sessions: dict[str, dict[str, Any]], file_name: str) -> None:
    """Raise InputError if the cut lies outside the session, or the name of a part is taken."""
    session, later = sessions[name], f"{name}{PART_SUFFIX}"
    cut_s, start_s, end_s = session[CUT_KEY], session.get("from_s", 0.0), session.get("to_s")
    if cut_s <= start_s or (end_s is not None and cut_s >= end_s):
        end = "the end of the log" if end_s is None else f"to_s {end_s} s"
        raise InputError(
            f"{file_name}: sessions.{name}.{CUT_KEY}: {cut_s} s; expected a time between from_s "
            f"{start_s} s and {end}"
        )
    if later in sessions:
        raise InputError(
            f"{file_name}: sessions.{later} exists, and is the name of what comes after "
            f"sessions.{name}.{CUT_KEY}. Rename it."
        )
