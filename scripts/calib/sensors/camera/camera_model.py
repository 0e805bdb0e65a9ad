"""Camera models.

A model is one module with
  PARAMS          the names of its parameters in order; those in OPTIONAL may be left out (zero);
  project(k, x, y, z) -> u, v      pixels, by arithmetic and NumPy functions, so that the same lines
                  serve arrays and CasADi expressions; finite for every finite point;
  domain(k, x, y, z) -> bool       where that pixel means something, never behind the lens;
  unproject(k, u, v) -> x, y, z, ok   unit rays on arrays, and where there is one.

To add a model: write calib/sensors/camera/models/<name>.py and add it to MODELS;
tests/test_cameras.py then
tests it against its own inverse and its own CasADi expression with no further edit.
Pixel (0, 0) is the centre of the top-left pixel; x right, y down, z forward.
"""

from dataclasses import dataclass

import numpy as np

from calib.sensors.camera.models import double_sphere, kannala_brandt, radtan

CAMERA_MODELS = {"radtan": radtan, "kannala_brandt": kannala_brandt, "double_sphere": double_sphere}


@dataclass(frozen=True)
class CameraModel:
    """A camera model with its parameters and image size (width, height), px."""

    model: str
    params: tuple
    size_px: tuple

    def __post_init__(self):
        module = CAMERA_MODELS[self.model]
        most = len(module.PARAMETER_NAMES)
        least = most - len(module.OPTIONAL_PARAMETERS)
        if not least <= len(self.params) <= most:
            raise ValueError(
                f"params: {len(self.params)} numbers, {self.model} takes {' '.join(module.PARAMETER_NAMES)}"
                + (
                    f" ({' '.join(module.OPTIONAL_PARAMETERS)} optional)"
                    if module.OPTIONAL_PARAMETERS
                    else ""
                )
            )
        padded = tuple(self.params) + (0.0,) * (most - len(self.params))
        object.__setattr__(self, "params", tuple(float(p) for p in padded))
        object.__setattr__(self, "size", tuple(int(s) for s in self.size_px))

    def project(self, p_camera):
        """Pixels (n, 2) of points (n, 3), m, and whether the model holds there (n,)."""
        x, y, z = np.asarray(p_camera, float).reshape(-1, 3).T
        module = CAMERA_MODELS[self.model]
        uv = np.stack(module.project(self.params, x, y, z), -1)
        return uv, np.asarray(module.is_in_domain(self.params, x, y, z))

    def unproject(self, uv):
        """Unit rays (n, 3) of pixels (n, 2), and whether the model has one there (n,)."""
        u, v = np.asarray(uv, float).reshape(-1, 2).T
        x, y, z, ok = CAMERA_MODELS[self.model].unproject(self.params, u, v)
        return np.stack([x, y, z], -1), ok

    def is_in_image(self, uv, margin=0.0):
        """Whether pixels (n, 2) lie in the image, margin px or more from its border."""
        width, height = self.size_px
        u, v = np.asarray(uv, float).reshape(-1, 2).T
        inside = (u >= margin - 0.5) & (u <= width - 0.5 - margin)
        return inside & (v >= margin - 0.5) & (v <= height - 0.5 - margin)
