"""Bodies in the map, through the frames that they are given in."""

import numpy as np

from calib import geometry, mocap


def bodies(edges, static, map_frame, wanted, max_gap):
    """{body: columns of mocap.parquet but `body`} of all that are given in the map, and of those
    wanted that a chain of edges leads to.

    edges: {(parent, child): columns with faults}; static: {(parent, child): (4, 4)}; max_gap, ns:
    the longest over which a frame in between is interpolated.
    """
    out = {child: edges[parent, child] for parent, child in edges if parent == map_frame}
    for body in sorted(set(wanted) - set(out)):
        chain = _chain({*edges, *static}, map_frame, body)
        if chain:
            found = _composed(chain, edges, static, max_gap)
            if found:
                out[body] = found
    return dict(sorted(out.items()))


def _chain(edges, map_frame, body):
    """Edges from the map down to a body, or None."""
    chain, frame, seen = [], body, {body}
    parents = {}
    for parent, child in sorted(edges, key=lambda e: e[0] != map_frame):
        parents.setdefault(child, parent)
    while frame != map_frame:
        parent = parents.get(frame)
        if parent is None or parent in seen:
            return None
        chain, frame = [(parent, frame), *chain], parent
        seen.add(parent)
    return chain


def _composed(chain, edges, static, max_gap):
    """Columns of a body at the stamps of the last edge of its chain that moves; of a body that
    never does, at those of whatever moves most."""
    moving = [e for e in chain if e in edges]
    if moving:
        base = edges[moving[-1]]
    elif edges:
        base = max(edges.values(), key=lambda c: len(c["t"]))
        base = base | {"fault": np.full(len(base["t"]), "", "U24")}
    else:
        return None
    fine = base["fault"] == ""
    T, known = np.tile(np.eye(4), (fine.sum(), 1, 1)), np.ones(fine.sum(), bool)
    for edge in chain:
        step, there = _at(edge, edges, static, base, fine, max_gap, edge in moving[-1:])
        T, known = T @ step, known & there
    return base | _filled(base, fine, T, known)


def _at(edge, edges, static, base, fine, max_gap, is_base):
    """Poses (n, 4, 4) of an edge at the base's stamps without fault, and whether they are known."""
    n = fine.sum()
    if is_base:
        T = geometry.from_xyz_quat(base["xyz"][fine], base["quat"][fine])
        return T, np.ones(n, bool)
    if edge in edges:
        columns = edges[edge]
        rows = columns["fault"] == ""
        T = geometry.from_xyz_quat(columns["xyz"][rows], columns["quat"][rows])
        return mocap.Trajectory(columns["t"][rows], T, max_gap).at(base["t"][fine])
    return np.tile(static[edge], (n, 1, 1)), np.ones(n, bool)


def _filled(base, fine, T, known):
    """xyz, quat and fault of the base's rows, those without fault replaced by the poses T."""
    xyz, quat, fault = (base[k].copy() for k in ("xyz", "quat", "fault"))
    xyz[fine], quat[fine] = T[:, :3, 3], geometry.to_quat(T)
    rows = np.flatnonzero(fine)
    fault[rows[~known]] = "no pose of its parent"
    return {"xyz": xyz, "quat": quat, "fault": fault}
