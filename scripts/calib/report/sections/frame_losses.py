"""What became of every frame on its way to the solve."""

from collections import Counter

import numpy as np

from calib.report.number_format import format_count

MAX_EXAMPLES = 12


def count_frame_losses(run, session, sensor, target):
    """Counts from frame to solve of one sensor and target, and the reasons for every loss."""
    stream = run.sessions[session].streams[sensor]
    of_target = np.asarray(stream.views["target"], str) == target
    kept = of_target & np.asarray(stream.views["kept"], bool)
    views = np.asarray(stream.views["view"])[kept].tolist()
    failures = {
        v: stream.status_by_view[v]
        for v in views
        if v in stream.status_by_view and not stream.status_by_view[v].ok
    }
    extracted = [v for v in views if v in stream.status_by_view and v not in failures]
    solved = run.used_views_by_stream.get((session, sensor), set())
    used = [v for v in extracted if v in solved]
    reasons = np.asarray(stream.views["reason"], str)[of_target & ~kept]
    frames = run.sessions[session].audit["sensors"].get(sensor, {}).get("messages", 0)
    counts = [frames, int(of_target.sum()), len(views), len(extracted), len(used)]
    return {
        "sensor": sensor,
        "target": target,
        "numbers": counts,
        "counts": [format_count(n) for n in counts],
        "shares": [100 * n / max(frames, 1) for n in counts],
        "losses": list_frame_losses(counts, reasons, failures),
        "failures": list_failure_examples(failures),
    }


def list_frame_losses(counts, reasons, failures):
    """[(step, count, reason)] of every frame lost, the largest first within each step."""
    frames, considered, kept, extracted, used = counts
    out = [
        ("not considered", frames - considered, "the sensor or the target could not be looked for")
    ]
    out += [("not kept", n, why) for why, n in Counter(reasons.tolist()).most_common()]
    out += [
        ("not found", n, why)
        for why, n in Counter(s.reason for s in failures.values()).most_common()
    ]
    out += [("not found", kept - extracted - len(failures), "not looked at")]
    out += [("not used", extracted - used, "no measurement was a member of the solution")]
    return [(step, format_count(n), why) for step, n, why in out if n > 0]


def list_failure_examples(failures):
    """The failures to find a target: view, reason, found and expected; at most a dozen."""
    shown = sorted(failures.items())[:MAX_EXAMPLES]
    more = len(failures) - len(shown)
    return {"rows": [(v, s.reason, s.found, s.expected) for v, s in shown], "more": max(more, 0)}


def tabulate_frame_losses(run, session):
    """Funnel rows of one session, by sensor and target; those of no consequence left out."""
    placements = run.sessions[session].status_by_target
    names = sorted(placements) or sorted(run.options["targets"])
    return [
        count_frame_losses(run, session, s, t) for s in run.sessions[session].streams for t in names
    ]


def list_still_intervals(run, session):
    """{target: (k, 2) start and end, ns} of the still intervals of a session."""
    p = run.sessions[session].placements
    kind, target = np.asarray(p["kind"], str), np.asarray(p["target"], str)
    span = np.column_stack([np.asarray(p["start_ns"], np.int64), np.asarray(p["end_ns"], np.int64)])
    return {t: span[(target == t) & (kind == "still")] for t in sorted(set(target.tolist()))}
