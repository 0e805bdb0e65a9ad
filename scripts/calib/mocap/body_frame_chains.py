"""Bodies in the map, through the frames that they are given in."""


def bodies(edges, static, map_frame, wanted, max_gap):
    """{body: columns of mocap.parquet but `body`} of all that are given in the map, and of those
    wanted that a chain of edges leads to.

    edges: {(parent, child): columns with faults}; static: {(parent, child): pose block}; max_gap,
    ns: the longest over which a frame in between is interpolated.
    """
    out = {child: edges[parent, child] for parent, child in edges if parent == map_frame}
    for body in sorted(set(wanted) - set(out)):
        chain = _chain({*edges, *static}, map_frame, body)
        if chain:
            from calib.mocap import (
                body_poses_in_map,  # 0.5 s of SciPy, which most logs need not pay
            )

            found = body_poses_in_map.composed(chain, edges, static, max_gap)
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
