"""The scan pattern, noise and beams of a lidar."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.geometry.se3 import se3_exp, transform_points


@dataclass(frozen=True)
class LidarModel:
    """A lidar: angles in rad, lengths in m.

    Scan pattern: steps and limits of azimuth and elevation, limits of the range. Noise:
    range_sigma, the initial value. Corrections, as far as estimated: range_bias, by which all
    ranges are too long; range_offsets, those of ring 0, 1, … in addition; beam_width (m, rad), by
    which outlines appear wider all round: the first, plus the second times the range; outline_twist
    (6,), from the lidar's pose to the pose that the outlines in its scans give; dark_ranges, by
    which the ranges of dark squares are too long, of each colour if nobody says which is dark;
    intensity_ranges: (m, low, high), by which returns of intensity low are longer than those of
    high, and in proportion between and beyond them, without a change half-way.
    beam_range_sigma and beam_width_sigma are the priors of one beam's range and of the width.
    beam_divergence: full angle of a beam.
    """

    azimuth_step: float
    elevation_step: float
    azimuth_limits: tuple[float, ...] | None
    elevation_limits: tuple[float, ...] | None
    range_limits: tuple[float, ...]
    range_sigma: float
    beam_range_sigma: float = 0.02
    beam_width_sigma: float = 0.01
    range_bias: float = 0.0
    range_offsets: tuple[float, ...] = ()
    beam_width: tuple[float, ...] = (0.0, 0.0)
    outline_twist: tuple[float, ...] = (0.0,) * 6
    dark_ranges: tuple[float, ...] = ()
    intensity_ranges: tuple[float, ...] = ()
    beam_divergence: float = 0.0

    def correct_ranges(self, returns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return xyz (n, 3), sensor frame, of returns without the estimated range errors.

        returns: xyz (n, 3); feature_index (n,), the ring; intensity (n,), NaN where unknown, which
        only an estimate of intensity_ranges needs.
        """
        xyz, ring = returns["xyz"], returns["feature_index"]
        if not (self.range_bias or self.range_offsets or self.intensity_ranges):
            return xyz
        offsets = np.append(self.range_offsets, 0.0)
        has_offset = (ring >= 0) & (ring < len(self.range_offsets))
        excess = self.range_bias + offsets[np.where(has_offset, ring, -1)]
        if self.intensity_ranges:
            excess = excess + self._intensity_excess(returns["intensity"])
        return xyz * (1 - excess / np.linalg.norm(xyz, axis=1))[:, None]

    def _intensity_excess(self, intensity: np.ndarray) -> np.ndarray:
        """Return by how much, m, the ranges of returns (n,) are too long, by their intensity."""
        longer, low, high = self.intensity_ranges
        return np.nan_to_num(longer * ((low + high) / 2 - intensity) / (high - low))

    def correct_rays(self, rays: np.ndarray, ranges: np.ndarray) -> np.ndarray:
        """Return unit rays (n, 3), sensor frame, to an outline at ranges (n,) by outline_twist."""
        if not any(self.outline_twist):
            return rays
        moved = transform_points(se3_exp(np.array(self.outline_twist)), rays * ranges[:, None])
        return moved / np.linalg.norm(moved, axis=1)[:, None]

    def outline_dilation(self, ranges: np.ndarray) -> np.ndarray:
        """Return the angle (n,), rad, by which an outline at ranges (n,), m, appears too wide."""
        width, divergence = self.beam_width
        return width / ranges + divergence

    def spot_radius(self, ranges: np.ndarray) -> np.ndarray:
        """Return the radius (n,), m, of the spots of beams at ranges (n,), m."""
        return ranges * self.beam_divergence / 2

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> "LidarModel":
        """Make the lidar of a sensor block."""

        def angle_limits(key: str) -> tuple[float, ...] | None:
            return tuple(np.radians(config[key])) if key in config else None

        return cls(
            azimuth_step=np.radians(config["azimuth_step_deg"]),
            elevation_step=np.radians(config["elevation_step_deg"]),
            azimuth_limits=angle_limits("azimuth_deg"),
            elevation_limits=angle_limits("elevation_deg"),
            range_limits=tuple(config["range_m"]),
            range_sigma=config["range_sigma_m"],
            beam_range_sigma=config["beam_range_sigma_m"],
            beam_width_sigma=config["beam_width_sigma_m"],
            beam_divergence=np.radians(config["beam_divergence_deg"]),
        )
