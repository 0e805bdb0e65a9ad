"""The way of the frames to the solve: how many are left after each step, why others are lost."""

from collections import Counter
from typing import Any

import numpy as np

from calib.io.status import Status
from calib.report.data.run_data import ReportRun, ReportSession
from calib.report.number_format import format_count

MAX_EXAMPLES = 12


def tabulate_frame_losses(run: ReportRun, session: str) -> list[dict[str, Any]]:
    """Return one row per sensor and target of a session."""
    targets = sorted(run.sessions[session].status_by_target) or sorted(run.options["targets"])
    return [
        count_frame_losses(run, session, sensor, target)
        for sensor in run.sessions[session].streams
        for target in targets
    ]


def count_frame_losses(run: ReportRun, session: str, sensor: str, target: str) -> dict[str, Any]:
    """Count the frames of one sensor and target after each step, with the reasons of the losses.

    frame_counts: frames, considered, kept, extracted, used.
    """
    stream = run.sessions[session].streams[sensor]
    is_target = np.asarray(stream.views["target"], str) == target
    is_kept = is_target & np.asarray(stream.views["kept"], bool)
    views = np.asarray(stream.views["view"])[is_kept].tolist()
    outcomes = {v: stream.status_by_view[v] for v in views if v in stream.status_by_view}
    failures = {v: status for v, status in outcomes.items() if not status.ok}
    extracted = [v for v in outcomes if v not in failures]
    used_views = run.used_views_by_stream.get((session, sensor), set())
    reasons = np.asarray(stream.views["reason"], str)[is_target & ~is_kept]
    n_frames = run.sessions[session].audit["sensors"].get(sensor, {}).get("messages", 0)
    n_used = sum(v in used_views for v in extracted)
    counts = [n_frames, int(is_target.sum()), len(views), len(extracted), n_used]
    return {
        "sensor": sensor,
        "target": target,
        "frame_counts": counts,
        "counts": [format_count(n) for n in counts],
        "shares": [100 * n / max(n_frames, 1) for n in counts],
        "losses": list_frame_losses(counts, reasons, failures),
        "failures": list_failure_examples(failures),
    }


def list_frame_losses(
    counts: list[int], reasons: np.ndarray, failures: dict[int, Status]
) -> list[tuple[str, str, str]]:
    """Return (step, count, reason) of all losses, in each step the most frequent first.

    reasons: of each frame that was not kept; failures: of the extraction, by view.
    """
    frames, considered, kept, extracted, used = counts
    losses = [("not considered", frames - considered, "sensor or target failed before")]
    losses += [("not kept", n, why) for why, n in Counter(reasons.tolist()).most_common()]
    causes = Counter(status.reason for status in failures.values())
    losses += [("not found", n, why) for why, n in causes.most_common()]
    losses += [("not found", kept - extracted - len(failures), "not searched")]
    losses += [("not used", extracted - used, "no measurement is an inlier")]
    return [(step, format_count(n), why) for step, n, why in losses if n > 0]


def list_failure_examples(failures: dict[int, Status]) -> dict[str, Any]:
    """Return up to MAX_EXAMPLES failures to find a target: (view, reason, found, expected)."""
    shown = sorted(failures.items())[:MAX_EXAMPLES]
    return {
        "rows": [(v, s.reason, s.found, s.expected) for v, s in shown],
        "n_more_failures": len(failures) - len(shown),
    }


def list_still_intervals(session: ReportSession) -> dict[str, np.ndarray]:
    """Return start and end (k, 2), ns, of the still intervals by target."""
    placements = session.placements
    kind = np.asarray(placements["kind"], str)
    targets = np.asarray(placements["target"], str)
    span = np.column_stack([np.asarray(placements[k], np.int64) for k in ("start_ns", "end_ns")])
    return {t: span[(targets == t) & (kind == "still")] for t in sorted(set(targets.tolist()))}
