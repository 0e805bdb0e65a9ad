"""Corners of a target's pattern, or the contour of its colour."""

import numpy as np

from calib.extraction.extraction_inputs import columns_of
from calib.extraction.working_pose import LOOSE, in_view, settle, working_pose
from calib.io import parquet_tables, table_schemas
from calib.io.status import OK
from calib.sensors.camera import cylinder_silhouette
from calib.sensors.camera.images import image_messages
from calib.views import field_of_view, windows

NOISE = 100.0  # times σ: what the working pose starts from; errors of the MCS exceed a corner's σ


def extract(job, views):
    """Keypoints of a camera's views (calib.extraction.extractor_registry)."""
    kept = np.flatnonzero(views["kept"])
    first = {i: seen(job, views, i, job.T_robot_sensor) for i in kept}
    keypoints = parquet_tables.concatenate(
        [p for p, s in first.values() if s.ok], table_schemas.KEYPOINTS
    )
    if len(keypoints["view"]) == 0:
        outcomes = [(int(views["view"][i]), status) for i, (_, status) in first.items()]
        return keypoints, outcomes, None
    centre = job.expected(int(keypoints["placement"][0]))[:3, 3]
    wide = windows.margin_px(job.model, centre, job.margin) / keypoints["sigma"].min()
    T = working_pose(job, keypoints, job.T_robot_sensor, job.associate | LOOSE, wide)
    return settle(job, lambda at: at_pose(job, views, at, first), T, NOISE)


def seen(job, views, i, T_robot_sensor):
    """(keypoint columns, status) of one view."""
    image = image_messages.from_png(views["png"][i])
    if job.targets[views["target"][i]].pattern:
        return corners(job, views, i, image)
    return contour(job, views, i, image, T_robot_sensor)


def parts_of(job, views, i, T_robot_sensor):
    """(parts of keypoint columns, status) of one view."""
    part, status = seen(job, views, i, T_robot_sensor)
    return [part] if status.ok else [], status


def at_pose(job, views, T_robot_sensor, first):
    """(parts of the keypoints, outcomes) of the views that count at a pose of the sensor.

    first: (columns, status) of every view from the guess, which has no part in finding corners.
    """
    counts = in_view(job, views, T_robot_sensor, field_of_view.hidden_from_camera)
    parts, outcomes = [], []
    for i, found in first.items():
        part, status = None, counts[i]
        if status.ok:
            pattern = job.targets[views["target"][i]].pattern
            part, status = found if pattern else seen(job, views, i, T_robot_sensor)
        parts += [part] if status.ok else []
        outcomes.append((int(views["view"][i]), status))
    return parts, outcomes


def corners(job, views, i, image):
    """(keypoint columns, status) of the pattern in one view's region (h, w, 3)."""
    pattern = job.targets[views["target"][i]].pattern
    offset = np.array([views["u0"][i], views["v0"][i]])
    found, status = pattern.locate(image_messages.grey(image), job.model, offset)
    if not status.ok:
        return None, status
    errors = {"sigma": found.sigma, "whiten": found.whiten}
    return columns_of(views, i, "corner", found.index, uv=found.uv, **errors), status


def contour(job, views, i, image, T_robot_sensor=None):
    """(keypoint columns, status) of the coloured blob in one view's region (h, w, 3): its sides, or
    all of its contour where the target is compared by points."""
    target = job.targets[views["target"][i]]
    where = job.expected(int(views["placement"][i]), T_robot_sensor)
    offset = np.array([views["u0"][i], views["v0"][i]])
    found, status = cylinder_silhouette.find(image, offset, target.color, job.model, target, where)
    if not status.ok:
        return None, status
    edges, on_limb = found.edges, np.flatnonzero(found.side)
    if target.points:
        index, sigma = np.zeros(len(edges.uv)), edges.sigma
        return columns_of(views, i, "silhouette", index, uv=edges.uv, sigma=sigma), OK
    uv, sigma = edges.uv[on_limb], edges.sigma[on_limb]
    return columns_of(views, i, "limb", found.side[on_limb], uv=uv, sigma=sigma), OK
