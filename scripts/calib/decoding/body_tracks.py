"""The bodies of motion capture in the map, from the streams of a log, and their audit."""

import numpy as np

from calib.decoding.decoded_log import median_rate_hz, mocap_topics
from calib.decoding.sensor_audit import missing_topic_status
from calib.geometry.units import NS_PER_S
from calib.io.parquet_tables import concatenate_columns
from calib.io.status import OK, did_you_mean, failure_status
from calib.io.table_schemas import MOCAP_SCHEMA
from calib.mocap.body_frame_chains import bodies_in_map
from calib.mocap.messages.pose_messages import POSE_READERS
from calib.mocap.pose_conventions import to_si_xyzw
from calib.mocap.pose_faults import flag_poses
from calib.mocap.swapped_bodies import flag_swaps


def build_mocap_columns(recording, clocks, mocap_config):
    """Columns of mocap.parquet: bodies by name, poses in log order, each with its fault; and
    {topic: what was found and done about all of its poses, in words}.

    clocks: of intake.clocks; mocap_config: block of the rig with map and max_gap_s.
    """
    parts, words = {}, {}
    for topic, edges in recording.streams.columns_by_topic().items():
        edges, words[topic] = to_si_xyzw(edges)
        for edge, c in edges.items():
            timed = c | {
                "stamp_ns": clocks[topic].message_times_ns(c["stamp_ns"], c["log_time_ns"])
            }
            parts.setdefault(edge, []).append(timed)
    edges = _flag_swaps_per_parent(
        {edge: _merge_and_flag(several) for edge, several in sorted(parts.items())}
    )
    gap = round(mocap_config["max_gap_s"] * NS_PER_S)
    wanted = recording.streams.bodies
    found = bodies_in_map(edges, recording.static_transforms, mocap_config["map"], wanted, gap)
    named = [{"body": np.full(len(c["stamp_ns"]), name, object)} | c for name, c in found.items()]
    return concatenate_columns(named, MOCAP_SCHEMA), words


def _merge_and_flag(columns_per_topic):
    """Columns of one edge from one or more topics, in log order, each pose with its fault."""
    joined = columns_per_topic[0]
    if len(columns_per_topic) > 1:
        joined = {
            k: np.concatenate([c[k] for c in columns_per_topic]) for k in columns_per_topic[0]
        }
    if (np.diff(joined["log_time_ns"]) < 0).any():
        order = np.argsort(joined["log_time_ns"], kind="stable")
        joined = {k: v[order] for k, v in joined.items()}
    return joined | {"fault": flag_poses(joined["stamp_ns"], joined["xyz"], joined["quat"])}


def _flag_swaps_per_parent(edges):
    """The edges, with swapped names named as such among those of one parent."""
    out = {}
    for parent in sorted({parent for parent, _ in edges}):
        tracks = {child: c for (p, child), c in edges.items() if p == parent}
        out |= {(parent, child): c for child, c in flag_swaps(tracks).items()}
    return out


def audit_body(poses, name, recording, log, mocap_config):
    """Count, rate, gaps and faults of one body, with a status."""
    rows = poses["body"] == name
    if not rows.any():
        status = _missing_body_status(name, poses, recording, log, mocap_config)
        return {"status": status.to_dict(), "poses": 0}
    fault = poses["fault"][rows]
    t = poses["stamp_ns"][rows][fault == ""]
    kinds, counts = np.unique(fault[fault != ""], return_counts=True)
    # A body that is not seen at first or at last has a gap there, as long as others are seen.
    ends = poses["stamp_ns"][poses["fault"] == ""]
    gaps = np.diff(np.concatenate([[ends.min()], t, [ends.max()]])) if len(t) else np.zeros(0)
    return {
        "status": _usable_poses_status(name, fault).to_dict(),
        "poses": int(rows.sum()),
        "faults": dict(zip(kinds.tolist(), counts.tolist(), strict=True)),
        "rate_hz": median_rate_hz(t),
        "longest_gap_s": float(gaps.max(initial=0) / NS_PER_S),
        "gaps": int((gaps > mocap_config["max_gap_s"] * NS_PER_S).sum()),
    }


def _usable_poses_status(name, fault):
    """Ok, or what is wrong with every single pose of a body."""
    if (fault == "").any():
        return OK
    kinds, counts = np.unique(fault, return_counts=True)
    return failure_status(
        f"MCS body {name} has no pose that can be used",
        ", ".join(f"{n} × {k}" for k, n in zip(kinds, counts, strict=True)),
        "at least one",
        "Look at the body in the motion capture's own software.",
    )


def _missing_body_status(name, poses, recording, log, mocap_config):
    """Why a body is not in the map."""
    topics = mocap_topics(mocap_config)
    known = [t for t in topics if t in log.topics]
    reason = f"MCS body {name} is not in the log"
    if not known:
        status = missing_topic_status(sorted(topics)[0], log.topics, "Check `mocap.topics`.")
        return failure_status(
            f"{reason}: {status.reason}", status.found, status.expected, status.remedy
        )
    for topic in known:
        if log.topics[topic][0] not in POSE_READERS:
            kinds = ", ".join(sorted(POSE_READERS))
            found = f"{topic} carries {log.topics[topic][0]}"
            return failure_status(reason, found, kinds, "Name a topic of motion capture.")
        if (
            topic in recording.first_errors
            and recording.n_unreadable[topic] == log.topics[topic][1]
        ):
            return failure_status(reason, recording.first_errors[topic])
    if parents := sorted(recording.streams.parents_by_body.get(name, ())):
        found = f"it is given in {' and '.join(parents)}, which nothing connects to {mocap_config['map']}"
        return failure_status(reason, found, remedy=f"Set `mocap.map` to {parents[0]}.")
    seen = sorted({*poses["body"].tolist(), *recording.streams.parents_by_body})
    remedy = "Check `body`, `mocap.topics` and `mocap.map`, the parent frame of the poses."
    found = f"bodies {', '.join(seen) or 'none'}"
    return failure_status(reason, found, name, did_you_mean(name, seen) or remedy)
