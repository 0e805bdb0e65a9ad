"""The point template of a target, for the paper's own comparison of points with points."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from scipy.spatial import cKDTree

from calib.io.status import InputError
from calib.targets.template_header import require_true_header

MAX_POINTS_ACROSS = 2000  # points of a template along its largest extent


class SampledShape(Protocol):
    """A shape whose surface can be sampled."""

    @property
    def extents(self) -> np.ndarray: ...

    def sample_surface(self, spacing: float) -> np.ndarray: ...


@dataclass(frozen=True)
class PointTemplate:
    """Points on the surface of a target.

    xyz: (n, 3), m, target frame; spacing: typical distance of neighbours, m; keypoint_mode: `all`
    compares every return, `corners` the outline's corners.
    """

    xyz: np.ndarray
    spacing: float
    keypoint_mode: str

    @cached_property
    def kd_tree(self) -> cKDTree:
        """Search tree of the template points."""
        return cKDTree(self.xyz)

    @cached_property
    def nearest_neighbour(self) -> np.ndarray:
        """Index (n,) of the nearest other point of each template point."""
        return self.kd_tree.query(self.xyz, k=2)[1][:, 1]


def point_template_from_config(config: dict[str, Any], shape: SampledShape) -> PointTemplate:
    """Make the template of a target's `points` block: read from a file, or sampled from the shape.

    Raises InputError if the file has no usable points or the spacing is too fine.
    """
    if config.get("template_file") is not None:
        return load_point_template(config)
    spacing, largest = config["spacing_m"], max(shape.extents)
    if largest / spacing > MAX_POINTS_ACROSS:
        raise InputError(
            f"points.spacing_m {spacing:g} m is too fine for a target of {largest:g} m; "
            f"expected {largest / MAX_POINTS_ACROSS:.2g} m or more. Increase points.spacing_m."
        )
    return PointTemplate(shape.sample_surface(spacing), spacing, config["keypoints"])


def load_point_template(config: dict[str, Any]) -> PointTemplate:
    """Read the template that a `points` block names; its spacing is that of the points."""
    template = read_template_file(config["template_file"])
    spacing = float(np.median(cKDTree(template).query(template, k=2)[0][:, 1]))
    return PointTemplate(template, spacing, config["keypoints"])


def read_template_file(path: str | Path) -> np.ndarray:
    """Read the points (n, 3), m, of a PCD or PLY file; raises InputError if it is not usable."""
    import open3d as o3d  # 2 s, which only targets with such a file should pay

    if not Path(path).is_file():
        raise InputError(
            f"{path}: template file not found. Set points.template_file to a .pcd or .ply file."
        )
    require_true_header(Path(path))
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        template = np.unique(np.asarray(o3d.io.read_point_cloud(Path(path)).points), axis=0)
    if len(template) < 4 or not np.isfinite(template).all():
        raise InputError(
            f"{path}: {len(template)} points, or some not finite; expected 4 or more different, "
            "finite points of the target in its own frame, in m. Write them as .pcd or .ply."
        )
    return template
