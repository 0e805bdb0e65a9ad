"""What in a scan may be a target, wherever it is: things of its shape and size."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import se3
from calib.sensors.lidar import target_search

THIN = np.deg2rad(0.6)  # between the returns that are looked at
LINK = 1.5  # steps of the scan pattern between two returns of one thing
LEAST = 8  # returns of a candidate
SHARE = (0.35, 2.0)  # of the returns that a target's area lets expect
WRONG_SIZE = 0.4
LARGE, PEELS = 2.5, 4  # targets that a cluster is wide from which on planes are taken out of it
ANY = np.full(6, np.pi)  # margin of a pose that says nothing
FLAT, LONG = 0.25, 1.5  # least spread over the middle one, largest over the middle one
DRAWS = 200


@dataclass(frozen=True)
class Form:
    """What a scan tells of a shape's pose: its centre (3,), and the direction (3,) of its least
    (0) or largest (2) spread, target frame; whether it has one, and a sign that can be seen."""

    centre: np.ndarray
    direction: np.ndarray
    spread: int
    directed: bool
    signed: bool

    @classmethod
    def of(cls, target):
        values, vectors = principal(target.template(target.size[0] / 50))
        flat, long = values[0] < FLAT * values[1], values[2] > LONG * values[1]
        spread = 0 if flat else 2
        n = vectors[:, spread]
        seen = [target.faces(target.centre + s * 1e3 * n)[0] for s in (1, -1)]
        n = n if seen[0] else -n
        return cls(target.centre, n, spread, flat or long, seen[0] != seen[1])


def principal(points):
    """Spreads (3,), m, upwards, and unit axes (3, 3) in columns, of points (n, 3)."""
    values, vectors = np.linalg.eigh(np.cov(points.T))
    return np.sqrt(np.maximum(values, 0)), vectors


def thinned(lidar, xyz):
    """The points (m, 3) of xyz (n, 3) in reach, the first of each THIN by THIN of direction."""
    ranges = np.linalg.norm(xyz, axis=1)
    xyz = xyz[(ranges > lidar.range[0]) & (ranges < lidar.range[1])]
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    elevation = np.arctan2(xyz[:, 2], np.linalg.norm(xyz[:, :2], axis=1))
    cell = np.floor(np.column_stack([azimuth, elevation]) / THIN).astype(int)
    return xyz[np.sort(np.unique(cell, axis=0, return_index=True)[1])]


def steps(lidar):
    """Angles, rad, between thinned returns along azimuth and elevation."""
    return max(lidar.azimuth_step, THIN), max(lidar.elevation_step, THIN)


def things(points, step, width, rng):
    """Index arrays of points (n, 3) that hang together: no gap wider than LINK steps, rad.

    What is much wider than `width`, m, is a wall or floor, maybe with things on it: its largest
    plane is taken out, and the rest looked at again.
    """
    todo, out = [(np.arange(len(points)), 0)], []
    while todo:
        rows, peeled = todo.pop()
        ranges = np.linalg.norm(points[rows], axis=1)
        # In these coordinates lengths are shares of the range, as the gaps between beams are.
        relative = np.column_stack([points[rows] / ranges[:, None], np.log(ranges)])
        label = target_search.clusters(relative, LINK * step)
        order = np.argsort(label, kind="stable")
        for part in np.split(rows[order], np.cumsum(np.bincount(label))[:-1]):
            if len(part) < LEAST:
                continue
            if target_search.extent(points[part]) < LARGE * width:
                out.append(part)
            elif peeled < PEELS:
                todo.append((part[~on_plane(points[part], rng)], peeled + 1))
    return [part for part in out if len(part) >= LEAST]


def on_plane(points, rng):
    """Which points (n, 3) lie within 2 % of their range of the plane that holds most of them."""
    triples = points[rng.integers(0, len(points), (DRAWS, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
    away = np.abs(points @ normals.T - np.sum(normals * triples[:, 0], 1))
    inside = away < 0.02 * np.linalg.norm(points, axis=1)[:, None]
    return inside[:, inside.sum(0).argmax()]


def find(lidar, target, form, points, options):
    """[(centre (3,), direction (3,))], lidar frame, of what may be the target in thinned points."""
    rng = np.random.default_rng(options["seed"])
    out = []
    for rows in things(points, max(steps(lidar)), target.size[0], rng):
        if too_small(lidar, target, points[rows]):
            continue
        members = fitted(lidar, target, form, points[rows], options)
        if len(members) and like(lidar, target, form, members):
            out.append(measured(target, form, members))
    return out


def fitted(lidar, target, form, points, options):
    """The points (m, 3) of one thing (n, 3) that the shape explains, in its best attitude, without
    what hangs on by less than a step."""
    best = points[:0]
    for T in attitudes(form, points):
        rows = target.fit(points, T, ANY, lidar, options)
        best = points[rows] if len(rows) > len(best) else best
    if len(best) < LEAST:
        return points[:0]
    gap = LINK * max(steps(lidar)) * np.linalg.norm(best.mean(0))
    label = target_search.clusters(best, gap)
    best = best[label == np.bincount(label).argmax()]
    return best if len(best) >= LEAST else points[:0]


def attitudes(form, points):
    """[T (4, 4)] at the middle of the points (n, 3), with the shape's direction along their main
    axes: along any where a long shape may hang on something else."""
    values, axes = principal(points)
    clear = form.spread == 0 or values[2] > LONG * values[1]
    return [
        se3.pose(se3.between(form.direction, axes[:, k]), points.mean(0))
        for k in ((form.spread,) if clear else (0, 1, 2))
    ]


def too_small(lidar, target, points):
    """Whether a thing's points (n, 3) do not reach as far as the target, give or take a step."""
    step = max(steps(lidar)) * np.linalg.norm(points.mean(0))
    return target_search.extent(points) + 2 * step < (1 - WRONG_SIZE) * target.size[0]


def like(lidar, target, form, members):
    """Whether members (n, 3) have the size of the target and as many returns as it would give."""
    centre = members.mean(0)
    distance = np.linalg.norm(centre)
    step = max(steps(lidar)) * distance
    if target_search.wrong_size(target, members, step) > WRONG_SIZE:
        return False
    along = principal(members)[1][:, form.spread] @ centre / distance
    cosine = abs(along) if form.spread == 0 else np.sqrt(1 - along**2)
    expected = target.area * cosine / distance**2 / np.prod(steps(lidar))
    return SHARE[0] < len(members) / expected < SHARE[1]


def measured(target, form, members):
    """(centre (3,), direction (3,)), lidar frame, of a target whose visible returns are members."""
    centre = members.mean(0)
    beam = centre / np.linalg.norm(centre)
    direction = principal(members)[1][:, form.spread]
    if form.spread == 0:
        return centre, -np.copysign(1, direction @ beam) * direction
    # Returns evenly spread in angle have their centroid π/4 radii before the axis.
    return centre + np.pi / 8 * target.size[1] * beam, direction
