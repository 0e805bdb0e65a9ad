"""Tracks of the bodies of motion capture in the map, and their audit."""

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np

from calib.decoding.decoded_log import DecodedLog, median_rate_hz, mocap_topics
from calib.decoding.sensor_audit import missing_topic_status
from calib.decoding.stream_clocks import StreamClock
from calib.geometry.frame_graph import Edge, FrameGraph
from calib.geometry.units import NS_PER_S
from calib.io.logs.open_log import RecordedLog
from calib.io.parquet_tables import Columns, concatenate_columns
from calib.io.status import OK, Status, did_you_mean, failure_status
from calib.io.table_schemas import MOCAP_SCHEMA
from calib.mocap.body_trajectory import longest_gap_ns
from calib.mocap.messages.pose_messages import POSE_READERS
from calib.mocap.pose_conventions import INFERRED, to_xyzw
from calib.mocap.pose_faults import flag_poses
from calib.mocap.position_unit import PositionUnit, find_position_unit
from calib.mocap.swapped_bodies import flag_swaps


def build_mocap_columns(
    decoded: DecodedLog, clocks: dict[str, StreamClock], mocap_config: dict[str, Any]
) -> tuple[Columns, dict[str, list[str]]]:
    """Return the columns of mocap.parquet, and {topic: notes on what was inferred}.

    Rows are sorted by body, then in log order; each pose has its fault. mocap_config: block `mocap`
    of the rig, with map and max_gap_s.
    """
    parts: dict[Edge, list[Columns]] = {}
    notes = {}
    sent = decoded.streams.columns_by_topic()
    unit = _position_unit(decoded, sent, mocap_config)
    for topic, sent_edges in sent.items():
        in_metres = {edge: unit.to_metres(c) for edge, c in sent_edges.items()}
        edges, notes[topic] = to_xyzw(in_metres, mocap_config["quaternions"])
        if unit.basis:
            notes[topic].insert(0, f"positions read as millimetres: {unit.basis}")
        for edge, c in edges.items():
            times = clocks[topic].message_times_ns(c["stamp_ns"], c["log_time_ns"])
            parts.setdefault(edge, []).append(c | {"stamp_ns": times})
    tracks = bodies_in_map(
        _flag_swaps_per_parent({edge: _merge_and_flag(p) for edge, p in sorted(parts.items())}),
        decoded.static_transforms,
        map_frame=mocap_config["map"],
        wanted_bodies=decoded.streams.bodies,
        max_gap_ns=round(mocap_config["max_gap_s"] * NS_PER_S),
    )
    named = [{"body": np.full(len(c["stamp_ns"]), name, object)} | c for name, c in tracks.items()]
    return concatenate_columns(named, MOCAP_SCHEMA), notes


def _position_unit(
    decoded: DecodedLog, sent: dict[str, dict[Edge, Columns]], mocap_config: dict[str, Any]
) -> PositionUnit:
    """Return the unit of all positions: as configured, or as the wanted bodies tell it."""
    if mocap_config["unit"] != INFERRED:
        return PositionUnit(mocap_config["unit"])
    return find_position_unit(sent, mocap_config["map"], decoded.streams.wanted_frames)


def bodies_in_map(
    columns_by_edge: dict[Edge, Columns],
    static_poses: dict[Edge, dict[str, Any]],
    *,
    map_frame: str,
    wanted_bodies: Collection[str],
    max_gap_ns: int,
) -> dict[str, Columns]:
    """Return {body: columns of mocap.parquet without `body`} of the bodies in the map.

    These are all bodies given in the map frame, and the wanted bodies that a chain of edges leads
    to. columns_by_edge: {(parent, child): columns with faults}; static_poses: {(parent, child):
    pose block}; max_gap_ns: longest gap over which a frame in between is interpolated.
    """
    tracks = {child: c for (parent, child), c in columns_by_edge.items() if parent == map_frame}
    graph = FrameGraph({*columns_by_edge, *static_poses})
    for body in sorted(set(wanted_bodies) - set(tracks)):
        chain = graph.find_path(map_frame, body, towards_parents=False)
        if not chain:
            continue
        # Not at the top: few logs need it, and SciPy takes 0.3 s to import.
        from calib.mocap.body_poses_in_map import compose_body_poses

        track = compose_body_poses(chain, columns_by_edge, static_poses, max_gap_ns)
        if track:
            tracks[body] = track
    return dict(sorted(tracks.items()))


def _merge_and_flag(columns_per_topic: list[Columns]) -> Columns:
    """Return the columns of one edge from one or more topics, in log order, with faults."""
    joined = columns_per_topic[0]
    if len(columns_per_topic) > 1:
        joined = {k: np.concatenate([c[k] for c in columns_per_topic]) for k in joined}
    if (np.diff(joined["log_time_ns"]) < 0).any():
        order = np.argsort(joined["log_time_ns"], kind="stable")
        joined = {k: v[order] for k, v in joined.items()}
    return joined | {"fault": flag_poses(joined["stamp_ns"], joined["xyz"], joined["quat"])}


def _flag_swaps_per_parent(edges: dict[Edge, Columns]) -> dict[Edge, Columns]:
    """Flag swapped names among the bodies in each parent frame."""
    out: dict[Edge, Columns] = {}
    for parent in sorted({parent for parent, _ in edges}):
        tracks = {child: c for (p, child), c in edges.items() if p == parent}
        out |= {(parent, child): c for child, c in flag_swaps(tracks).items()}
    return out


def audit_body(
    poses: Columns, name: str, decoded: DecodedLog, log: RecordedLog, mocap_config: dict[str, Any]
) -> dict[str, Any]:
    """Return the block of a body in log.json: count, rate, gaps, faults and status.

    poses: columns of mocap.parquet.
    """
    rows = poses["body"] == name
    if not rows.any():
        status = _missing_body_status(name, poses, decoded, log, mocap_config)
        return {"status": status.to_dict(), "poses": 0}
    fault = poses["fault"][rows]
    t = poses["stamp_ns"][rows][fault == ""]
    kinds, counts = np.unique(fault[fault != ""], return_counts=True)
    # A body that is not seen at the start or the end has a gap there, if others are seen then.
    ends = poses["stamp_ns"][poses["fault"] == ""]
    gaps = np.diff(np.concatenate([[ends.min()], t, [ends.max()]])) if len(t) else np.zeros(0)
    return {
        "status": _usable_poses_status(name, fault).to_dict(),
        "poses": int(rows.sum()),
        "faults": dict(zip(kinds.tolist(), counts.tolist(), strict=True)),
        "rate_hz": median_rate_hz(t),
        "longest_gap_s": float(gaps.max(initial=0) / NS_PER_S),
        "gaps": int((gaps > longest_gap_ns(t, mocap_config["max_gap_s"])).sum()),
    }


def _usable_poses_status(name: str, fault: np.ndarray) -> Status:
    """Return ok, or the faults of a body without any usable pose."""
    if (fault == "").any():
        return OK
    kinds, counts = np.unique(fault, return_counts=True)
    return failure_status(
        f"MCS body {name} has no pose that can be used",
        ", ".join(f"{n} × {k}" for k, n in zip(kinds, counts, strict=True)),
        "at least one",
        "Check the body in the software of the motion capture system.",
    )


def _missing_body_status(
    name: str, poses: Columns, decoded: DecodedLog, log: RecordedLog, mocap_config: dict[str, Any]
) -> Status:
    """Return why a body is not in the map."""
    reason = f"MCS body {name} is not in the log"
    topics = mocap_topics(mocap_config)
    topics_in_log = [t for t in topics if t in log.topics]
    if not topics_in_log:
        status = missing_topic_status(sorted(topics)[0], log.topics, "Check `mocap.topics`.")
        return replace(status, reason=f"{reason}: {status.reason}")
    for topic in topics_in_log:
        message_type, n_messages = log.topics[topic]
        if message_type not in POSE_READERS:
            found, expected = f"{topic} carries {message_type}", ", ".join(sorted(POSE_READERS))
            remedy = "Set `mocap.topics` to topics of motion capture."
            return failure_status(reason, found, expected, remedy)
        if topic in decoded.first_errors and decoded.n_unreadable[topic] == n_messages:
            return failure_status(reason, decoded.first_errors[topic])
    if parents := sorted(decoded.streams.parents_by_body.get(name, ())):
        frames = " and ".join(parents)
        found = f"its parent frame {frames} has no transform to {mocap_config['map']}"
        return failure_status(reason, found, remedy=f"Set `mocap.map` to {parents[0]}.")
    bodies = sorted({*poses["body"].tolist(), *decoded.streams.parents_by_body})
    remedy = "Check `body`, `mocap.topics` and `mocap.map`, the parent frame of the poses."
    found = f"bodies {', '.join(bodies) or 'none'}"
    return failure_status(reason, found, name, did_you_mean(name, bodies) or remedy)
