"""Which measurement belongs to which part of a target: decided here, for extract and solve alike.

Every function takes the current T_sensor_target of one placement and says, per measurement, the
feature it belongs to (-1: none), its σ, its residual, and what the report wants to know.
"""

from dataclasses import dataclass

import numpy as np

from calib import geometry
from calib.targets import polygon

TAPER_M, TAPER_COSINE = 0.01, 0.1  # over which the weight of a return fades in from a limit
VERTEX_M = 0.02  # an outline crossing nearer than this to a vertex may belong to either edge
ALONG_SCAN = 0.2  # an edge more parallel than this to the scan line fixes no crossing


@dataclass(frozen=True)
class Assignment:
    """Per measurement (n,): its feature; whether the geometry alone would admit it; sigma; value
    (n, 2), the residual in px, m or rad; range, m, and cosine of incidence."""

    feature: np.ndarray
    candidate: np.ndarray
    sigma: np.ndarray
    value: np.ndarray
    range: np.ndarray
    cosine: np.ndarray


def corners(camera, target, T_sensor_target, keypoints, options, scale):
    """Corners of each view numbered as the labelling that fits the prediction best.

    The offset common to a view is ignored, because a wrong guess shifts the whole pattern first;
    a view whose best two labellings fit nearly alike is left out.
    """
    uv, valid = camera.project(geometry.transform(T_sensor_target, target.pattern.corners()))
    n = len(keypoints["view"])
    feature = np.full(n, -1)
    for view in np.unique(keypoints["view"]):
        rows = np.flatnonzero(keypoints["view"] == view)
        feature[rows] = _labelling(target.pattern, uv, keypoints, rows)
    value = keypoints["uv"] - uv[feature]
    sigma = scale * keypoints["sigma"]
    far = np.linalg.norm(value, axis=1) > options["gate_sigma"] * sigma
    feature[far | ~valid[feature]] = -1
    points = geometry.transform(T_sensor_target, target.pattern.corners()[feature])
    cosine = np.full(n, target.faces(geometry.inverse(T_sensor_target)[:3, 3])[1])
    everything = np.ones(n, bool)
    return Assignment(feature, everything, sigma, value, np.linalg.norm(points, axis=1), cosine)


def _labelling(pattern, predicted, keypoints, rows):
    """Corner of each row of one view, or -1 for all when two labellings fit nearly alike."""
    options = pattern.labellings()[:, keypoints["index"][rows]]
    away = keypoints["uv"][rows] - predicted[options]
    away -= away.mean(1, keepdims=True)
    misfit = np.sqrt((away**2).sum(-1).mean(-1))
    best, second = np.argsort(misfit)[:2]
    return options[best] if misfit[best] < 0.5 * misfit[second] else -1


def surface(lidar, target, T_sensor_target, keypoints, options, scale):
    """Returns that lie on the target: over its surface, near it, and not at a grazing angle.

    The range noise acts along the beam: a distance from the surface has σ_range times the cosine
    of incidence. Towards the rim and towards grazing σ grows without bound, so that nothing jumps
    when a return comes or goes there.
    """
    p = keypoints["xyz"]
    ranges = np.linalg.norm(p, axis=1)
    T_target_sensor = geometry.inverse(T_sensor_target)
    q = geometry.transform(T_target_sensor, p)
    beams = p @ T_target_sensor[:3, :3].T / np.maximum(ranges, 1e-9)[:, None]
    cosine = -np.sum(target.normal(q) * beams, 1)
    distance = target.distance(*q.T)
    trust = taper(cosine - options["min_cosine"], TAPER_COSINE)
    trust *= taper(target.depth(q) - options["edge_margin_m"], TAPER_M)
    over = trust > 0
    sigma = scale * keypoints["sigma"] * np.clip(cosine, options["min_cosine"], 1)
    sigma /= np.sqrt(np.where(over, trust, 1.0))
    member = over & (np.abs(distance) < options["gate_sigma"] * sigma)
    value = np.column_stack([distance, np.zeros(len(p))])
    return Assignment(np.where(member, 0, -1), over, sigma, value, ranges, cosine)


def edge(lidar, target, T_sensor_target, keypoints, options, scale):
    """Crossings of the outline, each with the edge nearest to where its ray meets the board.

    A crossing lies anywhere between two beams: σ is the step between them over √12, taken across
    the edge. Several scans of a placement repeat the same crossings and count as one.
    """
    ray = keypoints["xyz"]
    T_target_sensor = geometry.inverse(T_sensor_target)
    origin = T_target_sensor[:3, 3]
    beam = ray @ T_target_sensor[:3, :3].T
    cosine = -beam[:, 2]
    hit = (
        origin
        + beam * (-origin[2] / np.where(np.abs(beam[:, 2]) > 1e-6, beam[:, 2], 1e-6))[:, None]
    )
    index, fraction = polygon.nearest_edge(target.vertices, hit[:, :2])
    ends = target.edges()[index]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    a, b = (geometry.transform(T_sensor_target, ends[:, k]) for k in (0, 1))
    normal = np.cross(a, b)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    angle = np.sum(normal * ray, 1)
    across = np.abs(np.sum(normal * np.cross([0.0, 0.0, 1.0], ray), 1))
    sigma = scale * keypoints["sigma"] * np.maximum(across, ALONG_SCAN)
    clear = np.minimum(fraction, 1 - fraction) * length > VERTEX_M
    over = clear & (across > ALONG_SCAN) & (cosine > options["min_cosine"])
    member = over & (np.abs(angle) < options["gate_sigma"] * sigma)
    value = np.column_stack([angle, np.zeros(len(ray))])
    ranges = np.linalg.norm(hit - origin, axis=1)
    return Assignment(np.where(member, index, -1), over, sigma, value, ranges, cosine)


def taper(beyond, width):
    """0 at and below a limit, 1 from width beyond it on, linear between."""
    return np.clip(beyond / width, 0, 1)


def loss_weight(size, gate):
    """Weight (n,) of Tukey's biweight for residuals of a size (n,), in σ; 0 from the gate on."""
    return np.maximum(1 - (size / gate) ** 2, 0) ** 2


KINDS = {"corner": corners, "surface": surface, "edge": edge}


def assign(kind, sensor, target, T_sensor_target, keypoints, options, scale):
    """The Assignment of keypoints (columns) of one kind, sensor, target and placement.

    sensor: its Camera or rig.Lidar; scale: the current factor on the keypoints' own σ.
    """
    return KINDS[kind](sensor, target, T_sensor_target, keypoints, options, scale)


def measurement(kind, target, keypoints, assigned):
    """Data (columns, n) of the kind's residual (expressions.DATA); 1/σ is zero for non-members."""
    weight = np.where(assigned.feature >= 0, 1 / assigned.sigma, 0.0)
    if kind == "corner":
        parts = [keypoints["uv"], target.pattern.corners()[assigned.feature]]
    elif kind == "surface":
        parts = [keypoints["xyz"]]
    else:
        ends = target.edges()[assigned.feature]
        parts = [keypoints["xyz"], ends.reshape(-1, 6)]
    return np.column_stack([*parts, weight]).T
