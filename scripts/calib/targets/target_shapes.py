"""The registry of target shapes.

To add a shape: write calib/targets/<name>.py with a frozen dataclass that has the members of
TargetShape and a field point_template, and add one line to TARGET_SHAPES.
"""

from dataclasses import replace
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from calib.geometry.numpy_or_casadi import ArrayOrExpression
from calib.targets.board import Board
from calib.targets.color import Color
from calib.targets.cylinder import Cylinder
from calib.targets.patterns.pattern_registry import TargetPattern
from calib.targets.point_template import PointTemplate, point_template_from_config
from calib.targets.template_cloud import TemplateCloud


class TargetShape(Protocol):
    """A target as every stage sees it; lengths in m, points in the target frame."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> Self:
        """Make the shape of config/targets/<name>.yaml."""

    @property
    def name(self) -> str:
        """The shape's word in messages."""

    @property
    def pattern(self) -> TargetPattern | None:
        """The printed pattern that a camera finds."""

    @property
    def color(self) -> Color | None:
        """The colour that a camera finds."""

    @property
    def symmetry_axes(self) -> tuple[int, ...]:
        """Axes of the frame, 0 to 2, about which a rotation cannot be seen."""

    @property
    def point_template(self) -> PointTemplate | None:
        """The template if measurements are compared with its points; for methods of the paper."""

    @property
    def uses_exact_surface(self) -> bool:
        """Whether measurements are compared with the exact surface, not with template points."""

    @property
    def centre(self) -> np.ndarray:
        """Middle (3,)."""

    @property
    def bounding_radius(self) -> float:
        """Radius of the ball around the centre that holds the target."""

    @property
    def extents(self) -> np.ndarray:
        """Extents (k,), largest first."""

    @property
    def area(self) -> float:
        """Area, m², seen face on."""

    def outline_points(self) -> np.ndarray:
        """Return the points (n, 3) that must be inside an image for the target to be in view."""

    def required_image_points(self) -> np.ndarray:
        """Return the points (n, 3) that an image must hold to be used; none if a camera cannot
        find the target."""

    def sample_surface(self, spacing: float) -> np.ndarray:
        """Return points (n, 3) all over the surface, spacing apart or a little less."""

    def outline_edges(self) -> np.ndarray:
        """Return the straight outline edges (n, 2, 3) over which a scan line can leave."""

    def check_facing(self, sensor_position: np.ndarray) -> tuple[bool, float]:
        """Return whether a sensor at (3,) sees the surface, and its cosine of incidence."""

    def fit_inliers(
        self,
        points: np.ndarray,
        T_sensor_target: np.ndarray,
        margin: np.ndarray,
        *,
        range_sigma: float,
        seed: int,
    ) -> np.ndarray:
        """Return the indices of the returns (n, 3) of one cluster that lie on the target.

        points: sensor frame; T_sensor_target (4, 4): expected pose; margin (6,): how far it may be
        off, rotation last, rad; range_sigma: noise of a range; seed: of random sampling.
        """


class ExactSurface(Protocol):
    """What a shape also has if measurements can be compared with its exact surface."""

    def surface_distance(
        self, x: ArrayOrExpression, y: ArrayOrExpression, z: ArrayOrExpression
    ) -> ArrayOrExpression:
        """Return the signed distance of points to the surface."""

    def distance_along_beam(
        self, points: ArrayOrExpression, beam: ArrayOrExpression
    ) -> tuple[ArrayOrExpression, ArrayOrExpression]:
        """Return how far a return (3, ...) lies before the surface along its unit beam (3, ...),
        and the cosine of incidence."""

    def distance_inside_rim(self, points: np.ndarray) -> np.ndarray:
        """Return how far (n,) points (n, 3) lie inside the rim of the surface, negative outside."""

    def is_near_cap(self, points: np.ndarray, reach: float) -> np.ndarray:
        """Return which points (n, 3) lie within reach of a flat end."""


TARGET_SHAPES: dict[str, type[TargetShape]] = {
    "board": Board,
    "cloud": TemplateCloud,
    "cylinder": Cylinder,
}


def target_from_config(config: dict[str, Any]) -> TargetShape:
    """Make the target of config/targets/<name>.yaml.

    Raises InputError if its point template is not usable.
    """
    shape = TARGET_SHAPES[config["shape"]].from_config(config)
    if not shape.uses_exact_surface or not is_compared_by_points(config):
        return shape
    return replace(shape, point_template=point_template_from_config(config["points"], shape))


def is_compared_by_points(config: dict[str, Any]) -> bool:
    """Return whether a target is compared by the points of a template (method `points`)."""
    return config.get("method", "surface") == "points"
