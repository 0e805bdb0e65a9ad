"""The template of a target, for the paper's own comparison of points with points."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from calib.io.status import InputError

MAX_POINTS_ACROSS = 2000  # points of a template along its largest extent


@dataclass(frozen=True)
class PointTemplate:
    """template (n, 3), m, target frame; its typical spacing, m; keypoints: all or corners."""

    xyz: np.ndarray
    spacing: float
    keypoint_mode: str

    @cached_property
    def kd_tree(self):
        """For nearest template points."""
        return cKDTree(self.xyz)

    @cached_property
    def nearest_neighbour(self):
        """Index (n,) of every template point's nearest other."""
        return self.kd_tree.query(self.xyz, k=2)[1][:, 1]


def point_template_from_config(config, shape):
    """Points of the `points` block of a target: sampled from the shape, or read from a file."""
    path, spacing = config.get("template_file"), config["spacing_m"]
    if path is None:
        if max(shape.extents) / spacing > MAX_POINTS_ACROSS:
            raise InputError(
                f"points.spacing_m {spacing:g} is too fine for a target of {max(shape.extents):g} m; "
                f"expected {max(shape.extents) / MAX_POINTS_ACROSS:.2g} m or more"
            )
        return PointTemplate(shape.sample_surface(spacing), spacing, config["keypoints"])
    template = read_template_file(path)
    between = float(np.median(cKDTree(template).query(template, k=2)[0][:, 1]))
    return PointTemplate(template, between, config["keypoints"])


def read_template_file(path):
    """Points (n, 3), m, of a PCD or PLY file; raises InputError where there are none."""
    import open3d as o3d  # 2 s, which only targets with such a file should pay

    if not Path(path).is_file():
        raise InputError(f"{path}: no such template; points.template_file names a .pcd or .ply")
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        template = np.unique(np.asarray(o3d.io.read_point_cloud(str(path)).points), axis=0)
    if len(template) < 4 or not np.isfinite(template).all():
        raise InputError(
            f"{path}: {len(template)} points, or some not finite; expected a cloud of the target "
            "in its own frame, in m, as .pcd or .ply"
        )
    return template
