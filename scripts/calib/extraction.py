"""Keypoints of one sensor: found from a guess, then again from the pose that all views agree on."""

from dataclasses import dataclass

import numpy as np

from calib import crossings, estimation, finding, geometry, images, placements, tables
from calib import views as windows
from calib.status import OK, failed

SUPERSET_M = 0.1  # returns this near to the target's surface are handed on; solve decides
LOOSE = {"gate_sigma": 6.0, "edge_margin_m": -1.0, "min_cosine": -1.0}
ROUNDS = 2
WORKING_ROUNDS, WORKING_POINTS = 6, 5000


@dataclass(frozen=True)
class Job:
    """One sensor in one session: model, targets, placements by number, guess and options."""

    name: str
    model: object
    targets: dict
    places: dict
    T_robot_sensor: np.ndarray
    sigma: np.ndarray
    margin: np.ndarray
    options: dict
    associate: dict

    def expected(self, placement, T_robot_sensor=None):
        """T_sensor_target (4, 4) in a placement, from the guess or another pose of the sensor."""
        T = self.T_robot_sensor if T_robot_sensor is None else T_robot_sensor
        place = self.places[placement]
        return geometry.inverse(T) @ place.T_robot_body @ place.T_body_target


def columns_of(views, i, kind, index, xyz=None, uv=None, sigma=0.0, dt=0):
    """Keypoint columns of one view: what is not measured is NaN."""
    n = len(index)
    nan = np.full((n, 3), np.nan)
    return {
        "view": np.full(n, views["view"][i]),
        "t": views["t"][i] + np.broadcast_to(dt, n),
        "target": np.full(n, views["target"][i]),
        "placement": np.full(n, views["placement"][i]),
        "kind": np.full(n, kind),
        "index": np.asarray(index),
        "xyz": nan if xyz is None else xyz,
        "uv": nan[:, :2] if uv is None else uv,
        "sigma": np.full(n, sigma),
    }


def working_pose(job, keypoints, T_robot_sensor, associate, noise):
    """T_robot_sensor (4, 4) that the keypoints agree on, held by the guess where they say nothing.

    noise: the factor on the keypoints' σ to start from, large where the start may be far off.
    Evenly thinned to WORKING_POINTS: it only says where to look.
    """
    n = len(keypoints["view"])
    keypoints = tables.select(keypoints, np.arange(0, n, -(-n // WORKING_POINTS)))
    used = sorted(set(keypoints["placement"].tolist()))
    index = {number: i for i, number in enumerate(used)}
    setup = estimation.Setup(
        models={job.name: job.model},
        targets=job.targets,
        placements=[job.places[number] for number in used],
        groups=placements.groups(keypoints, job.name, index),
        associate=associate,
        prior={job.name: (job.T_robot_sensor, job.sigma)},
    )
    start = {job.name: T_robot_sensor}
    result = estimation.estimate(setup, start, WORKING_ROUNDS, 1e-4, 1e-4, noise)
    return result.state.T_robot_sensor[job.name]


def from_camera(job, views):
    """(keypoints, outcome per view, working pose) of the pattern's corners in a camera's views."""
    parts, outcomes = [], []
    for i in np.flatnonzero(views["kept"]):
        pattern = job.targets[views["target"][i]].pattern
        image = images.from_png(views["png"][i])
        uv = pattern.detect(images.grey(image))
        status = OK
        if uv is None:
            size = f"{image.shape[1]} x {image.shape[0]} px"
            status = failed(f"no {pattern.name} in the region of {size}", "none", pattern.expected)
        else:
            uv = uv + [views["u0"][i], views["v0"][i]]
            sigma = job.options["corner_sigma_px"]
            parts.append(columns_of(views, i, "corner", np.arange(len(uv)), uv=uv, sigma=sigma))
        outcomes.append((int(views["view"][i]), status))
    keypoints = tables.concatenate(parts, tables.KEYPOINTS)
    if not parts:
        return keypoints, outcomes, None
    centre = job.expected(int(keypoints["placement"][0]))[:3, 3]
    wide = windows.margin_px(job.model, centre, job.margin) / job.options["corner_sigma_px"]
    T = working_pose(job, keypoints, job.T_robot_sensor, job.associate | LOOSE, wide)
    return keypoints, outcomes, T


def from_lidar(job, views):
    """(keypoints, outcome per view, working pose) of surfaces and outlines in a lidar's views."""
    found, parts, outcomes = [], [], []
    for i in np.flatnonzero(views["kept"]):
        points = np.asarray(views["xyz"][i], float).reshape(-1, 3)
        target, placement = job.targets[views["target"][i]], int(views["placement"][i])
        where = job.expected(placement)
        rows, status = finding.find(target, points, where, job.margin, job.model, job.options)
        outcomes.append((int(views["view"][i]), status))
        if status.ok:
            found.append(i)
            part = surface_columns(job, views, i, points, rows)
            parts.append(part)
    if not parts:
        return tables.empty(tables.KEYPOINTS), outcomes, None
    keypoints = tables.concatenate(parts, tables.KEYPOINTS)
    distance = np.linalg.norm(keypoints["xyz"], axis=1).mean()
    wide = windows.spread(job.margin, distance) * distance / job.model.range_sigma
    T = working_pose(job, keypoints, job.T_robot_sensor, job.associate | LOOSE, wide)
    for _ in range(ROUNDS):
        parts = [p for i in found for p in around(job, views, i, T, found)]
        keypoints = tables.concatenate(parts, tables.KEYPOINTS)
        if not parts:
            return keypoints, outcomes, None
        T = working_pose(job, keypoints, T, job.associate, 3.0)
    return keypoints, outcomes, T


def surface_columns(job, views, i, points, rows):
    """Returns (rows of points (n, 3)) of a view as surface keypoints with their own stamps."""
    dt, ring = np.asarray(views["dt"][i])[rows], np.asarray(views["ring"][i])[rows]
    sigma = job.model.range_sigma
    return columns_of(views, i, "surface", ring, xyz=points[rows], sigma=sigma, dt=dt)


def around(job, views, i, T_robot_sensor, found):
    """Keypoint columns of one view: returns near the surface, and crossings of the outline."""
    target, placement = job.targets[views["target"][i]], int(views["placement"][i])
    points = np.asarray(views["xyz"][i], float).reshape(-1, 3)
    where = job.expected(placement, T_robot_sensor)
    q = geometry.transform(geometry.inverse(where), points)
    near = np.abs(target.distance(*q.T)) < SUPERSET_M
    rows = np.flatnonzero(near & (target.depth(q) > -SUPERSET_M))
    parts = [surface_columns(job, views, i, points, rows)]
    if len(target.edges()):
        gate = 4 * job.model.range_sigma
        ring = np.asarray(views["ring"][i])
        rays, rings = crossings.crossings(target, where, points, ring, job.model, gate)
        # The scans of a placement repeat its crossings: together they count as one.
        repeated = sum(views["placement"][k] == placement for k in found)
        sigma = job.model.azimuth_step / np.sqrt(12) * np.sqrt(repeated)
        parts.append(columns_of(views, i, "edge", rings, xyz=rays, sigma=sigma))
    return [p for p in parts if len(p["view"])]
