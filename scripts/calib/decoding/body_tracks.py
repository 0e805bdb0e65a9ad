"""The bodies of motion capture in the map, from the streams of a log, and their audit."""

import difflib

import numpy as np

from calib.decoding import decoded_log, sensor_audit
from calib.io import parquet_tables, table_schemas
from calib.io.status import OK, failed
from calib.mocap import body_frame_chains, pose_conventions, pose_faults, swapped_bodies
from calib.mocap.messages import pose_messages

NS = decoded_log.NS


def columns(recording, clocks, mocap):
    """Columns of mocap.parquet: bodies by name, poses in log order, each with its fault; and
    {topic: what was found and done about all of its poses, in words}.

    clocks: of intake.clocks; mocap: block of the rig with map and max_gap_s.
    """
    parts, words = {}, {}
    for topic, edges in recording.streams.by_topic().items():
        edges, words[topic] = pose_conventions.standard(edges)
        for edge, c in edges.items():
            timed = c | {"t": clocks[topic].times(c["t"], c["log_t"])}
            parts.setdefault(edge, []).append(timed)
    edges = _told_apart({edge: _judged(several) for edge, several in sorted(parts.items())})
    gap = round(mocap["max_gap_s"] * NS)
    wanted = recording.streams.bodies
    found = body_frame_chains.bodies(edges, recording.static, mocap["map"], wanted, gap)
    named = [{"body": np.full(len(c["t"]), name, object)} | c for name, c in found.items()]
    return parquet_tables.concatenate(named, table_schemas.MOCAP), words


def _judged(several):
    """Columns of one edge from one or more topics, in log order, each pose with its fault."""
    joined = several[0]
    if len(several) > 1:
        joined = {k: np.concatenate([c[k] for c in several]) for k in several[0]}
    if (np.diff(joined["log_t"]) < 0).any():
        order = np.argsort(joined["log_t"], kind="stable")
        joined = {k: v[order] for k, v in joined.items()}
    return joined | {"fault": pose_faults.of(joined["t"], joined["xyz"], joined["quat"])}


def _told_apart(edges):
    """The edges, with swapped names named as such among those of one parent."""
    out = {}
    for parent in sorted({parent for parent, _ in edges}):
        tracks = {child: c for (p, child), c in edges.items() if p == parent}
        out |= {(parent, child): c for child, c in swapped_bodies.named(tracks).items()}
    return out


def audit(poses, name, recording, log, mocap):
    """Count, rate, gaps and faults of one body, with a status."""
    rows = poses["body"] == name
    if not rows.any():
        status = _unseen(name, poses, recording, log, mocap)
        return {"status": status.to_dict(), "poses": 0}
    fault = poses["fault"][rows]
    t = poses["t"][rows][fault == ""]
    kinds, counts = np.unique(fault[fault != ""], return_counts=True)
    # A body that is not seen at first or at last has a gap there, as long as others are seen.
    ends = poses["t"][poses["fault"] == ""]
    gaps = np.diff(np.concatenate([[ends.min()], t, [ends.max()]])) if len(t) else np.zeros(0)
    return {
        "status": _usable(name, fault).to_dict(),
        "poses": int(rows.sum()),
        "faults": dict(zip(kinds.tolist(), counts.tolist(), strict=True)),
        "rate_hz": decoded_log.rate(t),
        "longest_gap_s": float(gaps.max(initial=0) / NS),
        "gaps": int((gaps > mocap["max_gap_s"] * NS).sum()),
    }


def _usable(name, fault):
    """Ok, or what is wrong with every single pose of a body."""
    if (fault == "").any():
        return OK
    kinds, counts = np.unique(fault, return_counts=True)
    return failed(
        f"MCS body {name} has no pose that can be used",
        ", ".join(f"{n} × {k}" for k, n in zip(kinds, counts, strict=True)),
        "at least one",
        "Look at the body in the motion capture's own software.",
    )


def _unseen(name, poses, recording, log, mocap):
    """Why a body is not in the map."""
    topics = decoded_log.topics_of(mocap)
    known = [t for t in topics if t in log.topics]
    reason = f"MCS body {name} is not in the log"
    if not known:
        status = sensor_audit.missing(sorted(topics)[0], log.topics, "check `mocap.topics`")
        return failed(f"{reason}: {status.reason}", status.found, status.expected, status.remedy)
    for topic in known:
        if log.topics[topic][0] not in pose_messages.TYPES:
            kinds = ", ".join(sorted(pose_messages.TYPES))
            found = f"{topic} carries {log.topics[topic][0]}"
            return failed(reason, found, kinds, "Name a topic of motion capture.")
        if topic in recording.why and recording.unreadable[topic] == log.topics[topic][1]:
            return failed(reason, recording.why[topic])
    if parents := sorted(recording.streams.parents.get(name, ())):
        found = f"it is given in {' and '.join(parents)}, which nothing connects to {mocap['map']}"
        return failed(reason, found, remedy=f"Set `mocap.map` to {parents[0]}.")
    seen = sorted({*poses["body"].tolist(), *recording.streams.parents})
    near = difflib.get_close_matches(name, seen, 1)
    remedy = "check `body`, `mocap.topics` and `mocap.map`, the parent frame of the poses"
    found = f"bodies {', '.join(seen) or 'none'}"
    return failed(reason, found, name, f"did you mean {near[0]}?" if near else remedy)
