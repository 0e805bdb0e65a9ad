"""Scan patterns: where a lidar's beams point, and when.

To add a pattern: write a class with the fields and methods of Spinning and a line in PATTERNS.
All patterns take 0.1 s and are clipped to azimuths within ±sector, rad, about the lidar's x axis.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

TURN_NS = 100_000_000
FLAT_DEG = 0.5  # across the only beam of a 2-D scanner


class Firing(NamedTuple):
    """Unit beams (columns, beams, 3), lidar frame, and the time (columns,) of each column, which is
    fired at once, ns after the first."""

    beams: np.ndarray
    after: np.ndarray


class Spinning(NamedTuple):
    """Elevations, deg, of the beams in the driver's order, and columns of a whole turn, clockwise
    from above."""

    elevation_deg: tuple
    columns: int

    @property
    def beams(self):
        return len(self.elevation_deg)

    @property
    def steps_deg(self):
        """Between columns and between beams."""
        beams = (*self.elevation_deg, *self.elevation_deg[:1])
        return 360 / self.columns, abs(beams[1] - beams[0]) or FLAT_DEG

    def firing(self, sector, number):
        """Firing of the turn of that number; all turns are alike."""
        return spin(sector, 2 * np.pi / self.columns, self.elevation_deg)


class Rosette(NamedTuple):
    """Lines, abreast in elevation, that trace a rosette which never closes: two prisms turn at
    incommensurate rates, Hz. It is stretched to ±sector by ±half_elevation_deg."""

    lines: int
    columns: int
    half_elevation_deg: float
    rates: tuple
    apart_deg: float = 0.4

    @property
    def beams(self):
        return self.lines

    @property
    def elevation_deg(self):
        return -self.half_elevation_deg, self.half_elevation_deg

    @property
    def steps_deg(self):
        """About the distance to the next beam where 0.1 s leaves the widest gaps."""
        return 1.0, 1.0

    def firing(self, sector, number):
        """Firing of the scan of that number; the next one goes on where it ends."""
        after = np.arange(self.columns) * (TURN_NS // self.columns)
        turn = 2 * np.pi * np.outer(self.rates, after * 1e-9 + number * TURN_NS * 1e-9)
        offset = np.deg2rad(self.apart_deg) * (np.arange(self.lines) - (self.lines - 1) / 2)
        height = np.deg2rad(self.half_elevation_deg) - offset[-1]
        azimuth = sector * np.cos(turn).mean(0)[:, None]
        return Firing(_rays(azimuth, height * np.sin(turn).mean(0)[:, None] + offset), after)


@cache
def spin(sector, step, elevation_deg):
    """Firing of a turn from azimuth +sector to -sector in steps, rad, at those elevations, deg."""
    columns = np.arange(round(2 * sector / step) + 1)
    beams = _rays(sector - step * columns[:, None], np.deg2rad(elevation_deg))
    return Firing(beams, np.round(columns * step / (2 * np.pi) * TURN_NS).astype(np.int64))


def coarse(pattern, sector):
    """Unit beams (columns, beams, 3), every 1° by 2°, over the field of a pattern."""
    low, high = min(pattern.elevation_deg), max(pattern.elevation_deg)
    elevation = tuple(np.arange(low, high + 0.5, 2).tolist())
    return spin(sector, np.deg2rad(1.0), elevation).beams


def _rays(azimuth, elevation):
    flat = np.cos(elevation)
    x, y = flat * np.cos(azimuth), flat * np.sin(azimuth)
    return np.stack(np.broadcast_arrays(x, y, np.sin(elevation)), -1)


PATTERNS = {
    "beams16": Spinning(tuple(range(-15, 16, 2)), 1800),
    "beams32": Spinning(tuple(np.linspace(16.6, -16.6, 32).tolist()), 1024),
    "flat": Spinning((0.0,), 1440),
    "rosette": Rosette(6, 4000, 15.0, (71.3, -44.07)),
}
