"""Corners of a target's pattern, or the contour of its colour."""

import numpy as np

from calib.extraction.extraction_inputs import make_keypoint_columns
from calib.extraction.working_pose import (
    LOOSE_GATES,
    check_kept_views,
    estimate_working_pose,
    iterate_working_pose,
)
from calib.io.parquet_tables import concatenate_columns
from calib.io.status import OK
from calib.io.table_schemas import KEYPOINTS_SCHEMA
from calib.sensors.camera.cylinder_silhouette import find_cylinder_silhouette
from calib.sensors.camera.images.image_messages import decode_png, to_grey
from calib.views.field_of_view import check_camera_visibility
from calib.views.windows import pixel_margin

CAMERA_NOISE_FACTOR = (
    100.0  # times σ: what the working pose starts from; errors of the MCS exceed a corner's σ
)


def extract_camera_keypoints(context, views):
    """Keypoints of a camera's views (calib.extraction.extractor_registry)."""
    kept = np.flatnonzero(views["kept"])
    first = {i: extract_camera_view(context, views, i, context.T_robot_sensor) for i in kept}
    keypoints = concatenate_columns([p for p, s in first.values() if s.ok], KEYPOINTS_SCHEMA)
    if len(keypoints["view"]) == 0:
        outcomes = [(int(views["view"][i]), status) for i, (_, status) in first.items()]
        return keypoints, outcomes, None
    centre = context.predict_target_pose(int(keypoints["placement"][0]))[:3, 3]
    wide = pixel_margin(context.model, centre, context.pose_margin) / keypoints["sigma"].min()
    T = estimate_working_pose(
        context, keypoints, context.T_robot_sensor, context.associate_options | LOOSE_GATES, wide
    )
    return iterate_working_pose(
        context,
        lambda at: camera_keypoints_at_pose(context, views, at, first),
        T,
        CAMERA_NOISE_FACTOR,
    )


def extract_camera_view(context, views, i, T_robot_sensor):
    """(keypoint columns, status) of one view."""
    image = decode_png(views["png"][i])
    if context.targets[views["target"][i]].pattern:
        return extract_pattern_corners(context, views, i, image)
    return extract_color_contour(context, views, i, image, T_robot_sensor)


def list_camera_view_parts(context, views, i, T_robot_sensor):
    """(parts of keypoint columns, status) of one view."""
    part, status = extract_camera_view(context, views, i, T_robot_sensor)
    return [part] if status.ok else [], status


def camera_keypoints_at_pose(context, views, T_robot_sensor, first_results):
    """(parts of the keypoints, outcomes) of the views that count at a pose of the sensor.

    first_results: (columns, status) of every view from the guess, which has no part in finding corners.
    """
    counts = check_kept_views(context, views, T_robot_sensor, check_camera_visibility)
    parts, outcomes = [], []
    for i, found in first_results.items():
        part, status = None, counts[i]
        if status.ok:
            pattern = context.targets[views["target"][i]].pattern
            part, status = (
                found if pattern else extract_camera_view(context, views, i, T_robot_sensor)
            )
        parts += [part] if status.ok else []
        outcomes.append((int(views["view"][i]), status))
    return parts, outcomes


def extract_pattern_corners(context, views, i, image):
    """(keypoint columns, status) of the pattern in one view's region (h, w, 3)."""
    pattern = context.targets[views["target"][i]].pattern
    offset = np.array([views["u0"][i], views["v0"][i]])
    found, status = pattern.locate_corners(to_grey(image), context.model, offset)
    if not status.ok:
        return None, status
    errors = {"sigma": found.sigma, "whitening": found.whitening}
    return make_keypoint_columns(
        views, i, "pattern_corner", found.corner_index, uv=found.uv, **errors
    ), status


def extract_color_contour(context, views, i, image, T_robot_sensor=None):
    """(keypoint columns, status) of the coloured blob in one view's region (h, w, 3): its sides, or
    all of its contour where the target is compared by points."""
    target = context.targets[views["target"][i]]
    where = context.predict_target_pose(int(views["placement"][i]), T_robot_sensor)
    offset = np.array([views["u0"][i], views["v0"][i]])
    found, status = find_cylinder_silhouette(
        image, offset, target.color, context.model, target, where
    )
    if not status.ok:
        return None, status
    edges, on_limb = found.edges, np.flatnonzero(found.side)
    if not target.uses_exact_surface:
        index, sigma = np.zeros(len(edges.uv)), edges.sigma
        return make_keypoint_columns(
            views, i, "template_silhouette", index, uv=edges.uv, sigma=sigma
        ), OK
    uv, sigma = edges.uv[on_limb], edges.sigma[on_limb]
    return make_keypoint_columns(
        views, i, "cylinder_limb", found.side[on_limb], uv=uv, sigma=sigma
    ), OK
