"""A camera: a lens model with its parameters, and the registry of lens models.

To add a lens model: write calib/sensors/camera/models/<name>.py with the members of LensModel, and
add one line to CAMERA_MODELS; tests/unit/sensors/camera/test_camera_models.py then tests it.
Pixel (0, 0) is the centre of the top-left pixel; x right, y down, z forward.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calib.geometry.numpy_or_casadi import ArrayOrExpression
from calib.sensors.camera.models import double_sphere, kannala_brandt, radtan


class LensModel(Protocol):
    """A lens model, as one module; k are its parameters in the order of PARAMETER_NAMES.

    The last of them, OPTIONAL_PARAMETERS, may be left out and are then zero.
    """

    PARAMETER_NAMES: tuple[str, ...]
    OPTIONAL_PARAMETERS: tuple[str, ...]

    def project(
        self,
        k: ArrayOrExpression,
        x: ArrayOrExpression,
        y: ArrayOrExpression,
        z: ArrayOrExpression,
    ) -> tuple[ArrayOrExpression, ArrayOrExpression]:
        """Return the pixels u, v of points, by arithmetic and NumPy functions alone.

        So the same lines serve arrays and CasADi expressions. Finite for every finite point.
        """

    def is_in_domain(
        self, k: tuple[float, ...], x: np.ndarray, y: np.ndarray, z: np.ndarray
    ) -> np.ndarray:
        """Return whether the pixel of a point is valid (n,); never behind the lens."""

    def unproject(
        self, k: tuple[float, ...], u: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the unit rays x, y, z of pixels, and whether there is one (n,)."""


CAMERA_MODELS: dict[str, LensModel] = {
    "radtan": radtan,
    "kannala_brandt": kannala_brandt,
    "double_sphere": double_sphere,
}


@dataclass(frozen=True)
class CameraModel:
    """A lens model by name with its parameters, and the image size (width, height), px.

    Optional parameters may be left out. Raises ValueError for a wrong number of parameters.
    """

    model: str
    params: tuple[float, ...]
    size_px: tuple[int, ...]

    def __post_init__(self) -> None:
        lens = CAMERA_MODELS[self.model]
        most = len(lens.PARAMETER_NAMES)
        least = most - len(lens.OPTIONAL_PARAMETERS)
        if not least <= len(self.params) <= most:
            optional = f" ({' '.join(lens.OPTIONAL_PARAMETERS)} optional)" if least < most else ""
            raise ValueError(
                f"params: found {len(self.params)} numbers; {self.model} takes "
                f"{' '.join(lens.PARAMETER_NAMES)}{optional}"
            )
        padded = tuple(self.params) + (0.0,) * (most - len(self.params))
        object.__setattr__(self, "params", tuple(float(p) for p in padded))
        object.__setattr__(self, "size_px", tuple(int(s) for s in self.size_px))

    @property
    def lens(self) -> LensModel:
        """The module of the lens model."""
        return CAMERA_MODELS[self.model]

    def project(self, p_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixels (n, 2) of points (n, 3), m, and whether the model is valid (n,)."""
        x, y, z = np.asarray(p_camera, float).reshape(-1, 3).T
        uv = np.stack(self.lens.project(self.params, x, y, z), -1)
        return uv, np.asarray(self.lens.is_in_domain(self.params, x, y, z))

    def unproject(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the unit rays (n, 3) of pixels (n, 2), and whether there is one (n,)."""
        u, v = np.asarray(uv, float).reshape(-1, 2).T
        x, y, z, is_valid = self.lens.unproject(self.params, u, v)
        return np.stack([x, y, z], -1), is_valid

    def is_in_image(self, uv: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Return whether pixels (n, 2) lie in the image, margin px or more from its border."""
        width, height = self.size_px
        u, v = np.asarray(uv, float).reshape(-1, 2).T
        is_inside = (u >= margin - 0.5) & (u <= width - 0.5 - margin)
        return is_inside & (v >= margin - 0.5) & (v <= height - 0.5 - margin)
