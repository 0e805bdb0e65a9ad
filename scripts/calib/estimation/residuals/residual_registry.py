"""The kinds of measurement: what each is assigned to, and its residual.

To add a kind: write calib/estimation/residuals/<kind>.py with the members of ResidualKind and add
it to RESIDUAL_KINDS. Every kind decides which measurements are inliers, for extract and solve
alike. Change the formula of a residual in both places, `assign` (arrays) and `residual` (CasADi).
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from calib.estimation.residuals import (
    board_outline,
    cylinder_cap,
    cylinder_limb,
    pattern_corner,
    target_surface,
    template_silhouette,
)
from calib.estimation.residuals.assignment import (
    Assignment,
    Keypoints,
    Noise,
    ResidualExpression,
)
from calib.estimation.residuals.nearest_point import TEMPLATE_POINT, TEMPLATE_VERTEX


class AssignFirst(Protocol):
    """Assigns keypoints of one sensor in one placement to features of the target.

    model: CameraModel or LidarModel of the sensor; target: its shape; noise: the current one, in
    units of the keypoints' own σ; options: block `associate` of the config.
    """

    def __call__(
        self,
        model: Any,
        target: Any,
        T_sensor_target: np.ndarray,
        keypoints: Keypoints,
        *,
        options: Mapping[str, Any],
        noise: Noise,
    ) -> Assignment: ...


class Assign(Protocol):
    """As AssignFirst. features (n,): assigned before (stage associate), -1 for none."""

    def __call__(
        self,
        model: Any,
        target: Any,
        T_sensor_target: np.ndarray,
        keypoints: Keypoints,
        *,
        options: Mapping[str, Any],
        noise: Noise,
        features: np.ndarray | None = None,
    ) -> Assignment: ...


class ResidualKind(Protocol):
    """A kind of measurement; implemented by a module or an instance.

    UNIT: of the residuals, px, m or rad; MIN_SIGMA: resolution of the data, in UNIT, below which no
    noise is estimated, None if σ is the step of a scan pattern, which noise can only exceed;
    DATA_COLUMNS: names of the data of one measurement; the last, `weight`, is 1/σ or, for outliers,
    0; USES_TEMPLATE_POINTS: whether features are points of a template, found as the nearest.
    """

    @property
    def UNIT(self) -> str: ...

    @property
    def MIN_SIGMA(self) -> float | None: ...

    @property
    def DATA_COLUMNS(self) -> tuple[str, ...]: ...

    @property
    def USES_TEMPLATE_POINTS(self) -> bool: ...

    @property
    def assign(self) -> Assign:
        """Assign keypoints at the current estimate."""

    @property
    def assign_first(self) -> AssignFirst:
        """Assign keypoints at the initial guess, before anything is solved."""

    def residual(self, model: Any, target: Any) -> ResidualExpression:
        """Return the CasADi expression of the residual in units of σ."""


RESIDUAL_KINDS: dict[str, ResidualKind] = {
    "cylinder_cap": cylinder_cap,
    "pattern_corner": pattern_corner,
    "board_outline": board_outline,
    "cylinder_limb": cylinder_limb,
    "template_point": TEMPLATE_POINT,
    "template_silhouette": template_silhouette,
    "target_surface": target_surface,
    "template_vertex": TEMPLATE_VERTEX,
}


def uses_template_points(kind: str) -> bool:
    """Return whether features of a kind are the nearest points of a template."""
    return RESIDUAL_KINDS[kind].USES_TEMPLATE_POINTS
