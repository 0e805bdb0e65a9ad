"""What a lidar's scan pattern, noise and beams are."""

from dataclasses import dataclass

import numpy as np

from calib.geometry.se3 import se3_exp, transform_points


@dataclass(frozen=True)
class LidarModel:
    """Steps and limits of the scan pattern, rad; range limits and starting noise, m.

    What its beams may do to its data, as far as it was estimated: range_bias, m, by which all
    ranges are too long, and range_offsets, those of ring 0, 1, … beside it; beam_width (m, rad):
    outlines are seen wider all round by the first, and by the second times the range. The sigmas
    are those of their priors: of one beam's range and of a width, m. apart (6,): twist from
    where the lidar is to where the outlines in its scans put it.
    """

    azimuth_step: float
    elevation_step: float
    azimuth_limits: tuple | None
    elevation_limits: tuple | None
    range_limits: tuple
    range_sigma: float
    beam_range_sigma: float = 0.02
    beam_width_sigma: float = 0.01
    range_bias: float = 0.0
    range_offsets: tuple = ()
    beam_width: tuple = (0.0, 0.0)
    outline_twist: tuple = (0.0,) * 6

    def correct_ranges(self, xyz, ring):
        """Returns xyz (n, 3) of rings (n,), sensor frame, where they should be."""
        if self.range_bias or self.range_offsets:
            offsets = np.append(self.range_offsets, 0.0)
            known = (ring >= 0) & (ring < len(self.range_offsets))
            longer = self.range_bias + offsets[np.where(known, ring, -1)]
            xyz = xyz * (1 - longer / np.linalg.norm(xyz, axis=1))[:, None]
        return xyz

    def correct_rays(self, ray, ranges):
        """Where unit rays (n, 3), sensor frame, that meet something at ranges (n,) should point."""
        if not any(self.outline_twist):
            return ray
        there = transform_points(se3_exp(np.array(self.outline_twist)), ray * ranges[:, None])
        return there / np.linalg.norm(there, axis=1)[:, None]

    def outline_dilation(self, ranges):
        """Angle (n,), rad, by which an outline at ranges (n,), m, is seen outside of itself."""
        width, divergence = self.beam_width
        return width / ranges + divergence

    @classmethod
    def from_config(cls, config):
        """The Lidar of a sensor block; angles converted to rad."""
        limits = {
            f"{k}_limits": tuple(np.radians(config[f"{k}_deg"])) if f"{k}_deg" in config else None
            for k in ("azimuth", "elevation")
        }
        return cls(
            azimuth_step=np.radians(config["azimuth_step_deg"]),
            elevation_step=np.radians(config["elevation_step_deg"]),
            range_limits=tuple(config["range_m"]),
            range_sigma=config["range_sigma_m"],
            beam_range_sigma=config["beam_range_sigma_m"],
            beam_width_sigma=config["beam_width_sigma_m"],
            **limits,
        )
