"""Bodies in the map, through the frames that they are given in."""


def bodies_in_map(columns_by_edge, static_poses, map_frame, wanted_bodies, max_gap_ns):
    """{body: columns of mocap.parquet but `body`} of all that are given in the map, and of those
    wanted that a chain of edges leads to.

    columns_by_edge: {(parent, child): columns with faults}; static_poses: {(parent, child): pose block}; max_gap,
    ns: the longest over which a frame in between is interpolated.
    """
    out = {
        child: columns_by_edge[parent, child]
        for parent, child in columns_by_edge
        if parent == map_frame
    }
    for body in sorted(set(wanted_bodies) - set(out)):
        chain = _find_edge_chain({*columns_by_edge, *static_poses}, map_frame, body)
        if chain:
            from calib.mocap import body_poses_in_map

            found = body_poses_in_map.compose_body_poses(
                chain, columns_by_edge, static_poses, max_gap_ns
            )
            if found:
                out[body] = found
    return dict(sorted(out.items()))


def _find_edge_chain(edges, map_frame, body):
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
