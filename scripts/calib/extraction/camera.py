"""Corners of a target's pattern, or the contour of its colour."""

import numpy as np

from calib import images, limbs, tables
from calib import views as windows
from calib.extraction.job import LOOSE, columns_of, working_pose
from calib.status import OK, failed


def extract(job, views):
    """Keypoints of a camera's views (calib.extraction)."""
    parts, outcomes = [], []
    for i in np.flatnonzero(views["kept"]):
        image = images.from_png(views["png"][i])
        of_target = corners if job.targets[views["target"][i]].pattern else contour
        part, status = of_target(job, views, i, image)
        parts += [part] if status.ok else []
        outcomes.append((int(views["view"][i]), status))
    keypoints = tables.concatenate(parts, tables.KEYPOINTS)
    if not parts:
        return keypoints, outcomes, None
    centre = job.expected(int(keypoints["placement"][0]))[:3, 3]
    wide = windows.margin_px(job.model, centre, job.margin) / keypoints["sigma"].min()
    T = working_pose(job, keypoints, job.T_robot_sensor, job.associate | LOOSE, wide)
    return keypoints, outcomes, T


def corners(job, views, i, image):
    """(keypoint columns, status) of the pattern in one view's region (h, w, 3)."""
    pattern = job.targets[views["target"][i]].pattern
    uv = pattern.detect(images.grey(image))
    if uv is None:
        size = f"{image.shape[1]} x {image.shape[0]} px"
        return None, failed(f"no {pattern.name} in the region of {size}", "none", pattern.expected)
    uv = uv + [views["u0"][i], views["v0"][i]]
    sigma = job.options["corner_sigma_px"]
    return columns_of(views, i, "corner", np.arange(len(uv)), uv=uv, sigma=sigma), OK


def contour(job, views, i, image):
    """(keypoint columns, status) of the coloured blob in one view's region (h, w, 3): its sides, or
    all of its contour where the target is compared by points."""
    target = job.targets[views["target"][i]]
    where = job.expected(int(views["placement"][i]))
    offset = np.array([views["u0"][i], views["v0"][i]])
    found, status = limbs.find(image, offset, target.color, job.model, target, where)
    if not status.ok:
        return None, status
    edges, on_limb = found.edges, np.flatnonzero(found.side)
    if target.points:
        index, sigma = np.zeros(len(edges.uv)), edges.sigma
        return columns_of(views, i, "silhouette", index, uv=edges.uv, sigma=sigma), OK
    uv, sigma = edges.uv[on_limb], edges.sigma[on_limb]
    return columns_of(views, i, "limb", found.side[on_limb], uv=uv, sigma=sigma), OK
