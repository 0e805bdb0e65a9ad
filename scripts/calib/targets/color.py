"""Ranges of colour of a target."""

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class Color:
    """Ranges (low, high): hue, rad, upwards from low through 2π if need be; saturation and value
    from 0 to 1."""

    hue: tuple
    saturation: tuple
    value: tuple

    @classmethod
    def from_config(cls, config):
        hue = tuple(float(h) for h in np.deg2rad(config["hue_deg"]))
        return cls(hue, tuple(config["saturation"]), tuple(config["value"]))

    def mask(self, image):
        """Which pixels (h, w) of an image (h, w, 3) uint8 have the colour."""
        hsv = cv2.cvtColor(image.astype(np.float32), cv2.COLOR_BGR2HSV)
        low, high = np.rad2deg(self.hue)
        arcs = [(low, high)] if low <= high else [(low, 360), (0, high)]
        (dull, vivid), (dark, bright) = self.saturation, 255 * np.array(self.value)
        masks = [cv2.inRange(hsv, (a, dull, dark), (b, vivid, bright)) for a, b in arcs]
        return np.any(masks, axis=0)
