"""Scan patterns: where a lidar's beams point, and when.

To add a pattern: write a class with the fields and methods of Spinning and a line in PATTERNS.
All patterns take 0.1 s and are clipped to azimuths within ±sector, rad, about the lidar's x axis.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

SCAN_PERIOD_NS = 100_000_000
FLAT_ELEVATION_STEP_DEG = 0.5  # across the only beam of a 2-D scanner


class Firing(NamedTuple):
    """Unit beams (columns, beams, 3), lidar frame, and the time (columns,) of each column, which is
    fired at once, ns after the first."""

    beam_directions: np.ndarray
    column_time_ns: np.ndarray


class SpinningPattern(NamedTuple):
    """Elevations, deg, of the beams in the driver's order, and columns of a whole turn, clockwise
    from above."""

    elevation_deg: tuple
    n_columns: int

    @property
    def n_beams(self):
        return len(self.elevation_deg)

    @property
    def angular_steps_deg(self):
        """Between columns and between beams."""
        beams = (*self.elevation_deg, *self.elevation_deg[:1])
        return 360 / self.n_columns, abs(beams[1] - beams[0]) or FLAT_ELEVATION_STEP_DEG

    def make_firing(self, sector_rad, scan_number):
        """Firing of the turn of that number; all turns are alike."""
        return make_turn_firing(sector_rad, 2 * np.pi / self.n_columns, self.elevation_deg)


class RosettePattern(NamedTuple):
    """Lines, abreast in elevation, that trace a rosette which never closes: two prisms turn at
    incommensurate rates, Hz. It is stretched to ±sector by ±half_elevation_deg."""

    n_lines: int
    n_columns: int
    half_elevation_deg: float
    prism_rates_hz: tuple
    line_spacing_deg: float = 0.4

    @property
    def n_beams(self):
        return self.n_lines

    @property
    def elevation_deg(self):
        return -self.half_elevation_deg, self.half_elevation_deg

    @property
    def angular_steps_deg(self):
        """About the distance to the next beam where 0.1 s leaves the widest gaps."""
        return 1.0, 1.0

    def make_firing(self, sector_rad, scan_number):
        """Firing of the scan of that number; the next one goes on where it ends."""
        after = np.arange(self.n_columns) * (SCAN_PERIOD_NS // self.n_columns)
        turn = (
            2
            * np.pi
            * np.outer(self.prism_rates_hz, after * 1e-9 + scan_number * SCAN_PERIOD_NS * 1e-9)
        )
        offset = np.deg2rad(self.line_spacing_deg) * (
            np.arange(self.n_lines) - (self.n_lines - 1) / 2
        )
        height = np.deg2rad(self.half_elevation_deg) - offset[-1]
        azimuth = sector_rad * np.cos(turn).mean(0)[:, None]
        return Firing(_unit_rays(azimuth, height * np.sin(turn).mean(0)[:, None] + offset), after)


@cache
def make_turn_firing(sector_rad, step_rad, elevation_deg):
    """Firing of a turn from azimuth +sector to -sector in steps, rad, at those elevations, deg."""
    columns = np.arange(round(2 * sector_rad / step_rad) + 1)
    beams = _unit_rays(sector_rad - step_rad * columns[:, None], np.deg2rad(elevation_deg))
    return Firing(
        beams, np.round(columns * step_rad / (2 * np.pi) * SCAN_PERIOD_NS).astype(np.int64)
    )


def coarse_beam_directions(pattern, sector_rad):
    """Unit beams (columns, beams, 3), every 1° by 2°, over the field of a pattern."""
    low, high = min(pattern.elevation_deg), max(pattern.elevation_deg)
    elevation = tuple(np.arange(low, high + 0.5, 2).tolist())
    return make_turn_firing(sector_rad, np.deg2rad(1.0), elevation).beam_directions


def _unit_rays(azimuth, elevation):
    flat = np.cos(elevation)
    x, y = flat * np.cos(azimuth), flat * np.sin(azimuth)
    return np.stack(np.broadcast_arrays(x, y, np.sin(elevation)), -1)


SCAN_PATTERNS = {
    "beams16": SpinningPattern(tuple(range(-15, 16, 2)), 1800),
    "beams32": SpinningPattern(tuple(np.linspace(16.6, -16.6, 32).tolist()), 1024),
    "flat": SpinningPattern((0.0,), 1440),
    "rosette": RosettePattern(6, 4000, 15.0, (71.3, -44.07)),
}
