"""Ranges of colour of a target."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np


@dataclass(frozen=True)
class Color:
    """Ranges (low, high) of hue (rad), saturation and value (0 to 1).

    A hue range runs upwards from low, through 2π if low exceeds high.
    """

    hue: tuple[float, ...]
    saturation: tuple[float, ...]
    value: tuple[float, ...]

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> "Color":
        """Make the ranges of a target's `color` block."""
        hue = tuple(float(h) for h in np.deg2rad(config["hue_deg"]))
        return cls(hue, tuple(config["saturation"]), tuple(config["value"]))

    def mask(self, image: np.ndarray) -> np.ndarray:
        """Return which pixels (h, w) of a BGR image (h, w, 3) uint8 have the colour."""
        hsv = cv2.cvtColor(image.astype(np.float32), cv2.COLOR_BGR2HSV)
        low, high = np.rad2deg(self.hue)
        hue_ranges = [(low, high)] if low <= high else [(low, 360), (0, high)]
        (low_s, high_s), (low_v, high_v) = self.saturation, 255 * np.array(self.value)
        masks = [cv2.inRange(hsv, (a, low_s, low_v), (b, high_s, high_v)) for a, b in hue_ranges]
        return np.any(masks, axis=0)
