"""What the recordings held, and what became of every frame on its way to the solve."""

from collections import Counter

import numpy as np

from calib.report import text
from calib.status import Status

NS = 1e9
EXAMPLES = 12


def streams(run, session):
    """Rows of one session's audit: a sensor's messages, rate, longest gap and status."""
    heard, rows = run.sessions[session], []
    for name, stream in heard.streams.items():
        audit = heard.audit["sensors"].get(name, {})
        gap = audit.get("longest_gap_s", longest_gap(stream.views["t"]))
        topic = run.options["sensors"][name]["topic"]
        rows.append(
            {
                "name": name,
                "topic": topic,
                "type": heard.audit["topics"].get(topic, {}).get("type", text.DASH),
                "frame": audit.get("frame") or text.DASH,
                "messages": text.count(audit.get("messages", 0)),
                "rate": text.number(audit.get("rate_hz", 0.0)),
                "gap": text.number(gap),
                "ok": audit.get("status", {}).get("ok", False),
                "told": [f"{k}: {v}" for k, v in sorted(audit.get("told", {}).items())],
            }
        )
    return rows


def longest_gap(t):
    """Longest time, s, between two frames of stamps t (n,), ns, repeats allowed; None below two."""
    stamps = np.unique(np.asarray(t))
    return float(np.diff(stamps).max() / NS) if len(stamps) > 1 else None


def bodies(run, session):
    """Rows of one session's audit of the MCS: a body's poses, rate, longest gap, faults, status."""
    rows = []
    targets = {t["body"]: n for n, t in run.options["targets"].items()}
    for name, audit in sorted(run.sessions[session].audit["bodies"].items()):
        faults = ", ".join(
            f"{text.count(n)} × {k}" for k, n in sorted(audit.get("faults", {}).items())
        )
        role = "the robot" if name == run.options["body"] else targets.get(name, "")
        rows.append(
            {
                "name": name,
                "role": role,
                "poses": text.count(audit["poses"]),
                "rate": text.number(audit.get("rate_hz")),
                "gap": text.number(audit.get("longest_gap_s")),
                "faults": faults or "none",
                "ok": audit["status"]["ok"],
            }
        )
    return rows


def heard(run, session):
    """(what, in words) of a session's log: what could not be read, and of every topic of motion
    capture whose times are used and what else was found and done about its poses."""
    audit = run.sessions[session].audit
    said = [("not all could be read", fault) for fault in audit.get("faults", [])]
    for topic, about in audit.get("mocap", {}).items():
        late = about["delay_s"]
        delay = f"; taken by the log {late * 1e3:.0f} ms after" if late is not None else ""
        words = "; ".join([f"time by {about['stamps']}{delay}", *about["found"]])
        said.append((topic, words))
    for name, sensor in audit["sensors"].items():
        if sensor.get("stamps", "header") != "header":
            said.append((name, f"time by {sensor['stamps']}"))
    return said


def unused_topics(run, session):
    """(topic, type, messages) of what the log holds beside the sensors used."""
    used = {run.options["sensors"][n]["topic"] for n in run.sessions[session].streams}
    found = sorted(run.sessions[session].audit["topics"].items())
    return [(k, t["type"], text.count(t["messages"])) for k, t in found if k not in used]


def problems(run, session):
    """(where, status) of everything in a session that could not be done, each fault once."""
    s = run.sessions[session]
    found = [(f"sensor {n}", Status.from_dict(a["status"])) for n, a in s.audit["sensors"].items()]
    found += [
        (f"MCS body {n}", Status.from_dict(a["status"])) for n, a in s.audit["bodies"].items()
    ]
    found += [("placements", s.status)]
    found += [(f"placements of {n}", status) for n, status in sorted(s.targets.items())]
    for name, stream in s.streams.items():
        guess = Status.from_dict(stream.guess["status"])
        steps = (("first guess", guess), ("views", stream.seen), ("keypoints", stream.found))
        found += [(f"{what} of {name}", status) for what, status in steps]
    once = {}
    for where, status in found:
        if not status.ok:
            once.setdefault(status, []).append(where)
    return [(", ".join(where), status) for status, where in once.items()]


def row(run, session, sensor, target):
    """Counts from frame to solve of one sensor and target, and the reasons for every loss."""
    stream = run.sessions[session].streams[sensor]
    of_target = np.asarray(stream.views["target"], str) == target
    kept = of_target & np.asarray(stream.views["kept"], bool)
    views = np.asarray(stream.views["view"])[kept].tolist()
    failures = {
        v: stream.outcomes[v] for v in views if v in stream.outcomes and not stream.outcomes[v].ok
    }
    extracted = [v for v in views if v in stream.outcomes and v not in failures]
    solved = run.used_views.get((session, sensor), set())
    used = [v for v in extracted if v in solved]
    reasons = np.asarray(stream.views["reason"], str)[of_target & ~kept]
    frames = run.sessions[session].audit["sensors"].get(sensor, {}).get("messages", 0)
    counts = [frames, int(of_target.sum()), len(views), len(extracted), len(used)]
    return {
        "sensor": sensor,
        "target": target,
        "counts": [text.count(n) for n in counts],
        "shares": [100 * n / max(frames, 1) for n in counts],
        "losses": losses(counts, reasons, failures),
        "failures": examples(failures),
    }


def losses(counts, reasons, failures):
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
    return [(step, text.count(n), why) for step, n, why in out if n > 0]


def examples(failures):
    """The failures to find a target: view, reason, found and expected; at most a dozen."""
    shown = sorted(failures.items())[:EXAMPLES]
    more = len(failures) - len(shown)
    return {"rows": [(v, s.reason, s.found, s.expected) for v, s in shown], "more": max(more, 0)}


def table(run, session):
    """Funnel rows of one session, by sensor and target; those of no consequence left out."""
    placements = run.sessions[session].targets
    names = sorted(placements) or sorted(run.options["targets"])
    return [row(run, session, s, t) for s in run.sessions[session].streams for t in names]


def still(run, session):
    """{target: (k, 2) start and end, ns} of the still intervals of a session."""
    p = run.sessions[session].placements
    kind, target = np.asarray(p["kind"], str), np.asarray(p["target"], str)
    span = np.column_stack([np.asarray(p["start"], np.int64), np.asarray(p["end"], np.int64)])
    return {t: span[(target == t) & (kind == "still")] for t in sorted(set(target.tolist()))}
