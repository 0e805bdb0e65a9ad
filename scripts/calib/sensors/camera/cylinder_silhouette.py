"""A cylinder's silhouette in an image: the largest blob of its colour, its edge to a fraction of a
pixel, and which of its points lie on the straight sides.

Pixels are (u, v) with (0, 0) at the centre of the top-left pixel; colours are BGR, grey levels.
"""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import binary_erosion

from calib.io.status import OK, failure_status
from calib.sensors.camera.subpixel_edges import SubpixelEdges, refine_outline

MIN_BLOB_AREA_PX2, MAX_BLOB_AREA_RATIO, MIN_LIMB_POINTS = 1000, 1.5, 20
CENTRAL_LIMB_SHARE = 0.35  # of the blob's length, to either side of its middle: limbs, never caps
MAX_FLANK_SINE = np.sin(
    np.deg2rad(30)
)  # between a limb's normals and the normal of the blob's axis
MIN_BLOB_AXIS_COSINE = np.cos(np.deg2rad(25))  # between the blob's axis and where the guess has it
MAX_LIMB_DISTANCE_PX, LIMB_END_TRIM_PX = (
    1.5,
    8,
)  # off the plane of a limb; cut off where a limb ends
LIMB_OUTLIER_MARGIN_PX = 0.5  # off the plane of a limb, beyond 2 sigma, of a measured edge


class Silhouette(NamedTuple):
    """The closed edge, in pixels of the whole image, and the side (n,) of each point: that of
    d · (c × a) for its ray d, the axis' direction a and a point c on it; 0 is off the limbs."""

    edges: SubpixelEdges
    side: np.ndarray


def find_cylinder_silhouette(image, offset, color, camera, target, T_camera_target):
    """(Silhouette of a cylinder or None, status) in a region (h, w, 3) uint8 of an image.

    offset (2,): pixel of the image at the region's (0, 0). The pose (4, 4) may be a guess.
    """
    outline = find_color_contour(image, color)
    status = check_color_blob(image, outline, camera, target, T_camera_target)
    if not status.ok:
        return None, status
    edges = refine_outline(image, outline)
    edges = edges._replace(uv=edges.uv + offset)
    side = assign_limb_sides(edges, camera, T_camera_target)
    count = np.count_nonzero(side)
    if count < MIN_LIMB_POINTS:
        return None, failure_status(
            "too little of the cylinder's straight sides is seen",
            f"{count} points",
            f"{MIN_LIMB_POINTS} or more",
            "clear what hides it, or place it before a plain background",
        )
    return Silhouette(edges, side), OK


def find_color_contour(image, color):
    """Border pixels (n, 2) of the largest blob of a colour, holes filled, in order; or None."""
    mask = np.pad(color.mask(image).astype(np.uint8), 2)
    for way in (cv2.MORPH_CLOSE, cv2.MORPH_OPEN):
        mask = cv2.morphologyEx(mask, way, np.ones((3, 3), np.uint8))
    blobs = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    if not blobs:
        return None
    return max(blobs, key=cv2.contourArea)[:, 0].astype(float) - 2


def check_color_blob(image, outline, camera, target, T_camera_target):
    """Status: whether a blob's outline (n, 2) can be the target about where it is expected."""
    if outline is None:
        return failure_status(
            "nothing of the target's colour", "", "", "check `color` of the target, and the light"
        )
    area = cv2.contourArea(outline.astype(np.float32))
    if area < MIN_BLOB_AREA_PX2:
        return failure_status(
            "the blob of the target's colour is too small",
            f"{area:.0f} px²",
            f"{MIN_BLOB_AREA_PX2} px² or more",
            "bring the target nearer, or check `color` of the target",
        )
    height, width = image.shape[:2]
    if (outline.min(0) < 1).any() or (outline.max(0) > [width - 2, height - 2]).any():
        return failure_status(
            "the blob of the target's colour touches the border of the image region",
            "",
            "a target wholly in view",
            "move the target towards the middle of the view",
        )
    expected = _predict_area(camera, target, T_camera_target)
    if not expected / MAX_BLOB_AREA_RATIO < area < expected * MAX_BLOB_AREA_RATIO:
        return failure_status(
            "the blob of the target's colour has not the target's size",
            f"{area:.0f} px²",
            f"{expected:.0f} px² within a factor {MAX_BLOB_AREA_RATIO}",
            "remove other things of that colour and what hides the target, or check the guess",
        )
    return OK


def _predict_area(camera, target, T_camera_target):
    """Area, px², of the target's outline; 0 where the lens cannot see all of it."""
    points = target.outline_points() @ T_camera_target[:3, :3].T + T_camera_target[:3, 3]
    uv, ok = camera.project(points)
    return cv2.contourArea(cv2.convexHull(uv.astype(np.float32))) if ok.all() else 0.0


def assign_limb_sides(edges, camera, T_camera_target):
    """Side (n,), -1 or 1, of the edges (in pixels of the image) on a limb, 0 elsewhere.

    A limb lies in a plane through the camera, whatever the lens. Each is fitted to the points on
    one side of the blob's own main axis; the guess only says which of its ends is which. All are 0
    where the axis is seen so much from its end that the blob is not longest along it.
    """
    side = np.zeros(len(edges.uv), int)
    middle, axis, aligned = _main_axis(edges.uv, camera, T_camera_target)
    rays, ok = camera.unproject(edges.uv)
    beside, ok_beside = camera.unproject(edges.uv + edges.normal)
    along = (edges.uv - middle) @ axis
    ends = camera.unproject(middle + 0.2 * np.outer([-1, 1], np.ptp(along) * axis))[0]
    half = np.where(rays @ np.cross(*ends) > 0, 1, -1)
    seen = ok & ok_beside & aligned
    sure = seen & edges.is_measured & (np.abs(edges.normal @ axis) < MAX_FLANK_SINE)
    sure &= np.abs(along - (along.max() + along.min()) / 2) < CENTRAL_LIMB_SHARE * np.ptp(along)
    for sign in (-1, 1):
        if np.count_nonzero(sure & (half == sign)) >= MIN_LIMB_POINTS:
            off = np.abs(_off_plane(rays, beside, sure & (half == sign)))
            straight = _trim_limb_ends(seen & (half == sign) & (off < MAX_LIMB_DISTANCE_PX))
            side[
                straight & edges.is_measured & (off < LIMB_OUTLIER_MARGIN_PX + 2 * edges.sigma)
            ] = sign
    return side


def _main_axis(uv, camera, T_camera_target):
    """Middle (2,), px, and main axis (2,) of the area in an outline uv (n, 2), towards the end that
    the guess puts at +x, and whether they agree on its direction."""
    m = cv2.moments(uv.astype(np.float32))
    spread = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]])
    axis = np.linalg.eigh(spread)[1][:, 1]
    half = T_camera_target[:3, 0] * 0.01 * np.linalg.norm(T_camera_target[:3, 3])
    low, high = camera.project(T_camera_target[:3, 3] + np.outer([-1, 1], half))[0]
    cosine = axis @ (high - low) / max(np.linalg.norm(high - low), 1e-9)
    middle = np.array([m["m10"], m["m01"]]) / m["m00"]
    return middle, np.copysign(1, cosine) * axis, abs(cosine) > MIN_BLOB_AXIS_COSINE


def _off_plane(rays, rays_outward, is_start):
    """Distances (n,), px outwards, of rays (n, 3) from the plane through most of those at start.

    rays_outward (n, 3) are the rays one pixel outwards, which turn angles into pixels.
    """
    weight = is_start.astype(float)
    off = np.zeros(len(rays))
    for scale in (None, 3.0, 1.0, 0.5, 0.3, 0.3):
        if scale is not None:
            weight = is_start * np.clip(1 - (off / (3 * scale)) ** 2, 0, None) ** 2
        normal = np.linalg.eigh((rays * weight[:, None]).T @ rays)[1][:, 0]
        off = rays @ normal / np.maximum(np.abs((rays_outward - rays) @ normal), 1e-12)
    return off


def _trim_limb_ends(straight):
    """Those of a closed row of flags (n,) that stand END_PX or more from the next that is not."""
    row = np.concatenate([straight[-LIMB_END_TRIM_PX:], straight, straight[:LIMB_END_TRIM_PX]])
    return binary_erosion(row, np.ones(2 * LIMB_END_TRIM_PX + 1))[
        LIMB_END_TRIM_PX:-LIMB_END_TRIM_PX
    ]
