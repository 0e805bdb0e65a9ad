"""What sensors see of targets, exactly, as keypoints without scans, images or extraction.

Rooms, rigs and placements are the simulator's; measurements are thinned so that an estimate takes
a few hundredths of a second. A sight is the columns of one sensor, target and placement.
"""

import numpy as np

from calib.geometry import se3
from calib.sensors import sensor_models
from simulation.world import ray_casting, room_scene

FEWEST, POINTS = 30, 50  # returns of a scan
LINES = 10  # contour points on each side of a cylinder
SAMPLES = 400  # of an edge, between which its crossing is interpolated
FLATTEST = 0.35  # cosine of incidence
SIGMA_PX = {"corner": 0.01, "limb": 0.05}


def lidar(session, name, options, target, shape, k):
    """Sights by a lidar of a target (its name and shape) at rest k: returns, crossings."""
    spec, model = session.rig.specs[name], sensor_models.model(options)
    T_world_lidar = session.knots["robot"][k] @ session.rig.sensors[name]
    T = se3.inverse(T_world_lidar) @ session.knots[target][k]
    beams = spec.scans.firing(np.deg2rad(spec.sector_deg), 0).beams
    rings, beams = beams.shape[1], beams.reshape(-1, 3)
    rows, distance = on_target(session, target, T_world_lidar, beams, k)
    if len(rows) < FEWEST:
        return
    p = beams[rows] * distance[rows, None]
    rows = rows[shape.gap(*_in_target(T, p, beams[rows]))[1] > FLATTEST]
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, POINTS).astype(int))]
    xyz = beams[rows] * distance[rows, None]
    yield _columns("surface", rows % rings, model.range_sigma, xyz=xyz)
    rays, ring = crossings(shape.edges(), T, np.deg2rad(spec.scans.elevation_deg))
    yield _columns("edge", ring, model.azimuth_step / np.sqrt(12), xyz=rays)


def on_target(session, target, T_world_lidar, beams, k):
    """Indices of the beams (n, 3) that meet a target at rest k, a cylinder on its side; and the
    distance (n,) of all."""
    number = room_scene.index(session.scene, target)
    surfaces = room_scene.poses({target: session.knots[target][k]})
    distance, label = ray_casting.cast(session.scene, surfaces, T_world_lidar, beams, [number])
    met = np.isfinite(distance)
    if target == "cylinder":
        met &= label == session.scene.first[number]
    return np.flatnonzero(met), distance


def _in_target(T_sensor_target, points, beams):
    """Points and beams (3, n) in the target's frame."""
    T = se3.inverse(T_sensor_target)
    return se3.transform(T, points).T, (beams @ T[:3, :3].T).T


def crossings(edges, T_sensor_target, elevation):
    """Rays (n, 3), lidar frame, at which rings at those elevations, rad, cross edges (e, 2, 3), and
    the number of the ring of each."""
    share = np.linspace(0, 1, SAMPLES)[:, None]
    rays, rings = [np.zeros((0, 3))], [np.zeros(0, int)]
    for a, b in edges:
        p = se3.transform(T_sensor_target, a + share * (b - a))
        height = np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1]))
        above = height[:, None] > elevation
        at, ring = np.nonzero(above[1:] != above[:-1])
        way = (elevation[ring] - height[at]) / (height[at + 1] - height[at])
        met = p[at] + way[:, None] * (p[at + 1] - p[at])
        rays.append(met / np.linalg.norm(met, axis=1)[:, None])
        rings.append(ring)
    return np.concatenate(rays), np.concatenate(rings)


def camera(session, name, options, target, shape, k):
    """Sights by a camera: corners of a pattern, or the sides of a cylinder."""
    model = sensor_models.model(options)
    T_world_camera = session.knots["robot"][k] @ session.rig.sensors[name]
    T = se3.inverse(T_world_camera) @ session.knots[target][k]
    if shape.pattern:
        points = shape.pattern.corners()
        uv = _projected(model, se3.transform(T, points))
        if uv is not None and shape.faces(se3.inverse(T)[:3, 3])[1] > FLATTEST:
            index = np.arange(len(points))
            yield _columns("corner", index, SIGMA_PX["corner"], uv=uv, whiten=[1.0, 0.0, 1.0])
        return
    points, side = limb(shape, T)
    uv = _projected(model, points)
    if uv is not None:
        yield _columns("limb", side, SIGMA_PX["limb"], uv=uv)


def _projected(model, points):
    uv, valid = model.project(points)
    return uv if valid.all() and model.in_image(uv, 10.0).all() else None


def limb(shape, T_camera_target):
    """Points (n, 3), camera frame, m, along the two lines where rays touch a cylinder's side, and
    the side of the axis, +1 or -1, that each is on."""
    eye = se3.inverse(T_camera_target)[:3, 3]
    half = np.arccos(shape.radius / np.hypot(eye[1], eye[2]))
    angles = np.arctan2(eye[2], eye[1]) + np.array([-half, half])
    along, angle = np.meshgrid(np.linspace(-0.42, 0.42, LINES) * shape.length, angles)
    across = shape.radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    q = np.concatenate([along[..., None], across], -1).reshape(-1, 3)
    points = se3.transform(T_camera_target, q)
    axis, centre = T_camera_target[:3, 0], T_camera_target[:3, 3]
    return points, np.sign(np.cross(axis, points) @ centre).astype(int)


def _columns(kind, index, sigma, xyz=None, uv=None, whiten=np.nan):
    """Columns of a sight that do not depend on whose it is."""
    n = len(index)
    return {
        "kind": np.full(n, kind, dtype="U16"),
        "index": np.asarray(index, int),
        "xyz": np.full((n, 3), np.nan) if xyz is None else xyz,
        "uv": np.full((n, 2), np.nan) if uv is None else uv,
        "sigma": np.full(n, sigma),
        "whiten": np.broadcast_to(whiten, (n, 3)),
    }


SENSORS = {"lidar": lidar, "camera": camera}
