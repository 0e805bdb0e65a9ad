"""The registry of printed patterns.

To add a pattern: write calib/targets/patterns/<kind>.py with a frozen dataclass that has the
members of TargetPattern, and add one line to TARGET_PATTERNS.
"""

from typing import Any, Protocol, Self

import numpy as np

from calib.io.status import Status
from calib.targets.patterns.charuco import Charuco
from calib.targets.patterns.checkerboard import Checkerboard
from calib.targets.patterns.detected_corners import DetectedCorners
from calib.targets.patterns.image_region import CameraProjection


class TargetPattern(Protocol):
    """A pattern in the plane z = 0 of the target frame; lengths in m."""

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> Self:
        """Make the pattern of a target's `pattern` block."""

    @property
    def name(self) -> str:
        """The pattern's word in messages."""

    @property
    def min_visible_share(self) -> float:
        """Smallest share of the corners that an image must show."""

    @property
    def expected_description(self) -> str:
        """What a detection must find, in words."""

    @property
    def square_m(self) -> float:
        """Side of a square."""

    @property
    def outline(self) -> np.ndarray:
        """Corners (4, 2) of the area that the squares fill."""

    @property
    def print_description(self) -> str:
        """What is printed, with sizes, in words."""

    def black_rectangles(self) -> np.ndarray:
        """Return the black areas (n, 2, 2) of the print: low and high corner of rectangles."""

    def corners(self) -> np.ndarray:
        """Return all corners (n, 3)."""

    def corner_orders(self) -> np.ndarray:
        """Return (k, n) indices into corners(): each row a way to read the detected order."""

    def darkness(self, xy: np.ndarray) -> np.ndarray:
        """Return how dark (n, 1), from 0 to 1, the print is at points (n, 2); 0 beside it.

        (n, 2) if the config does not say which colour is black: 1 on squares of each colour.
        """

    def with_scale(self, factor: float) -> Self:
        """Return the pattern enlarged by a factor about its own middle."""

    def detect_corners_fast(self, grey: np.ndarray) -> np.ndarray | None:
        """Return the pixels (n, 2) of all corners in the detected order, or None.

        grey: (h, w) uint8. Quick, and accurate to about a third of a pixel.
        """

    def locate_corners(
        self, grey: np.ndarray, camera: CameraProjection, offset: np.ndarray
    ) -> tuple[DetectedCorners | None, Status]:
        """Return the verified corners in an image region with their covariance, or None and why.

        grey: (h, w) uint8; offset: (2,) pixel of the camera's image at the region's (0, 0).
        """


TARGET_PATTERNS: dict[str, type[TargetPattern]] = {
    "checkerboard": Checkerboard,
    "charuco": Charuco,
}


def pattern_from_config(config: dict[str, Any]) -> TargetPattern:
    """Make the pattern of a target's `pattern` block."""
    return TARGET_PATTERNS[config["kind"]].from_config(config)
