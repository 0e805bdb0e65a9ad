"""A camera from the coloured bodies that its images show: each blob is a bearing, an axis, a size.

Three bearings to bodies of known place leave at most four poses (the perspective three-point
problem); what the other blobs look like says which. All that agree are then fitted together.
"""

from itertools import combinations

import cv2
import numpy as np
from scipy.optimize import least_squares

from calib.geometry import se3
from calib.initial_guess import bearing_pnp, pose_voting
from calib.initial_guess.frame_sampling import readable
from calib.initial_guess.pose_guess import Found
from calib.sensors.camera import cylinder_silhouette

LEAST = 4  # placements: three give poses, another says which
TRIPLES = 8  # blobs that triples are drawn from
STARTS = 10  # poses by three blobs that are fitted to all
AGREES = 0.1  # of a blob's own size: what its place, axis and size may be off after the fit
HIDDEN = 10.0  # misfit of a blob where the lens would see no target


def find(camera, shapes, looks, content_of, options):
    """Found: the pose that most blobs of the targets' colours agree on."""
    seen, wanted = [], [k for k in looks if shapes[k.target].color]
    for look, image in readable(wanted, content_of):
        blob = read(shapes[look.target].color, image)
        seen += [] if blob is None else [(look, blob)]
        if len(seen) >= options["enough_images"]:
            break
    least = max(LEAST, options["min_placements"])
    T, rows = best(camera, shapes, seen) if len(seen) >= least else (None, [])
    if len(rows) < least:
        counts = len(rows), 0, len(seen), len(wanted), least
        return Found(status=pose_voting.refused("coloured body", *counts))
    T, sigma = fitted(camera, shapes, [seen[i] for i in rows], T)
    basis = f"the coloured body in {len(rows)} of {len(seen)} images that show one"
    return Found(T, np.maximum(sigma, pose_voting.floor(options)), basis)


def read(color, image):
    """Features (5,) of the largest blob of a colour in an image (h, w, 3), if it is all in it."""
    outline = cylinder_silhouette.contour(image, color)
    if (
        outline is None
        or cv2.contourArea(outline.astype(np.float32)) < cylinder_silhouette.MIN_AREA_PX2
    ):
        return None
    height, width = image.shape[:2]
    cut = (outline.min(0) < 1).any() or (outline.max(0) > [width - 2, height - 2]).any()
    return None if cut else features(outline)


def features(outline):
    """Features (5,), px, of the area in an outline (n, 2): its middle, and the symmetric root of
    its second moments (uu, uv, vv), which tells its axis and its size."""
    rough = outline.mean(0)
    p, q = outline - rough, np.roll(outline - rough, -1, 0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    area = cross.sum() / 2
    middle = cross @ (p + q) / (6 * area)
    both = np.einsum("n,nij->ij", cross, _outer(p, p) + _outer(q, q) + _outer(p + q, p + q)) / 24
    values, vectors = np.linalg.eigh(both / area - np.outer(middle, middle))
    root = vectors * np.sqrt(np.maximum(values, 0)) @ vectors.T
    return np.concatenate([rough + middle, root[[0, 0, 1], [0, 1, 1]]])


def _outer(a, b):
    return a[:, :, None] * b[:, None, :]


def misfit(camera, shapes, seen, T_robot_camera):
    """Differences (k, 5) of the blobs' features from those expected, in units of their size."""
    out = np.full((len(seen), 5), HIDDEN)
    for i, (look, blob) in enumerate(seen):
        T = se3.inverse(T_robot_camera) @ look.T_robot_target
        uv, valid = camera.project(se3.transform(T, shapes[look.target].outline_points()))
        if valid.all():
            hull = cv2.convexHull(uv.astype(np.float32), returnPoints=False)[:, 0]
            expected = features(uv[hull])
            out[i] = (expected - blob) / np.linalg.norm(blob[2:])
    return out


def best(camera, shapes, seen):
    """(T_robot_camera (4, 4), rows of the blobs that agree with it) of what fits most blobs best.

    Poses by three blobs are far off when those lie close together: the likeliest are fitted to all.
    """
    starts = sorted(by_three(camera, shapes, seen), key=lambda s: s[0])[:STARTS]
    best, rows, lowest = None, [], np.inf
    for _, start in starts:
        T, _ = fitted(camera, shapes, seen, start)
        size = np.abs(misfit(camera, shapes, seen, T)).max(1)
        if np.minimum(size, AGREES).sum() < lowest:
            best, rows = T, np.flatnonzero(size < AGREES)
            lowest = np.minimum(size, AGREES).sum()
    return best, rows


def by_three(camera, shapes, seen):
    """[(misfit of all blobs, T_robot_camera (4, 4))] of every three blobs."""
    rays, _ = camera.unproject(np.array([blob[:2] for _, blob in seen]))
    middles = [se3.transform(k.T_robot_target, shapes[k.target].centre) for k, _ in seen]
    out = []
    for triple in combinations(range(min(len(seen), TRIPLES)), 3):
        for T in bearing_pnp.three_points(rays[list(triple)], np.array(middles)[list(triple)]):
            size = np.abs(misfit(camera, shapes, seen, T)).max(1)
            out.append((np.minimum(size, 1).sum(), T))
    return out


def fitted(camera, shapes, seen, T_robot_camera):
    """(T_robot_camera (4, 4), σ (6,)) that fits the blobs best, robustly, from a pose near it.

    σ from the scatter of what is left, five numbers per blob.
    """

    def residual(x):
        return misfit(camera, shapes, seen, T_robot_camera @ se3.se3_exp(x)).reshape(-1)

    found = least_squares(residual, np.zeros(6), loss="soft_l1", f_scale=0.02, x_scale="jac")
    scale = 2 * found.cost / max(len(found.fun) - 6, 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * scale
    return T_robot_camera @ se3.se3_exp(found.x), np.sqrt(np.diag(covariance))
