"""Scan patterns: where a lidar's beams point, and when.

To add a pattern: write a class that fits the protocol ScanPattern and add it to SCAN_PATTERNS.
All patterns take 0.1 s and are clipped to azimuths within ±sector, rad, about the lidar's x axis.
"""

from functools import cache
from typing import NamedTuple, Protocol

import numpy as np

SCAN_PERIOD_NS = 100_000_000
FLAT_ELEVATION_STEP_DEG = 0.5  # across the only beam of a 2-D scanner


class Firing(NamedTuple):
    """Unit beams (columns, beams, 3), lidar frame, and the time (columns,) of each column, ns after
    the first; the beams of a column leave at once."""

    beam_directions: np.ndarray
    column_time_ns: np.ndarray


class ScanPattern(Protocol):
    """How a lidar scans."""

    @property
    def n_beams(self) -> int: ...

    @property
    def elevation_deg(self) -> tuple[float, ...]:
        """Elevations of the beams, or the lowest and the highest."""
        ...

    @property
    def angular_steps_deg(self) -> tuple[float, float]:
        """Steps between neighbouring columns and between neighbouring beams."""
        ...

    def make_firing(self, sector_rad: float, scan_number: int) -> Firing:
        """Make the firing of the scan of a number."""
        ...


class SpinningPattern(NamedTuple):
    """A lidar that turns, clockwise from above: elevations of the beams in the driver's order, and
    columns of a whole turn."""

    elevation_deg: tuple[float, ...]
    n_columns: int

    @property
    def n_beams(self) -> int:
        return len(self.elevation_deg)

    @property
    def angular_steps_deg(self) -> tuple[float, float]:
        beams = (*self.elevation_deg, *self.elevation_deg[:1])
        return 360 / self.n_columns, abs(beams[1] - beams[0]) or FLAT_ELEVATION_STEP_DEG

    def make_firing(self, sector_rad: float, scan_number: int) -> Firing:
        """Make the firing of a turn; all turns are alike."""
        return make_turn_firing(sector_rad, 2 * np.pi / self.n_columns, self.elevation_deg)


class RosettePattern(NamedTuple):
    """Lines side by side in elevation that trace a rosette which never closes.

    Two prisms turn at incommensurate rates. The rosette is as wide as the sector and
    ±half_elevation_deg high.
    """

    n_lines: int
    n_columns: int
    half_elevation_deg: float
    prism_rates_hz: tuple[float, float]
    line_spacing_deg: float = 0.4

    @property
    def n_beams(self) -> int:
        return self.n_lines

    @property
    def elevation_deg(self) -> tuple[float, float]:
        return -self.half_elevation_deg, self.half_elevation_deg

    @property
    def angular_steps_deg(self) -> tuple[float, float]:
        """Return about the distance to the next beam where 0.1 s leaves the widest gaps."""
        return 1.0, 1.0

    def make_firing(self, sector_rad: float, scan_number: int) -> Firing:
        """Make the firing of a scan; the next one goes on where it ends."""
        time_ns = np.arange(self.n_columns) * (SCAN_PERIOD_NS // self.n_columns)
        time_s = time_ns * 1e-9 + scan_number * SCAN_PERIOD_NS * 1e-9
        turn = 2 * np.pi * np.outer(self.prism_rates_hz, time_s)
        offset = np.deg2rad(self.line_spacing_deg) * (
            np.arange(self.n_lines) - (self.n_lines - 1) / 2
        )
        height = np.deg2rad(self.half_elevation_deg) - offset[-1]
        azimuth = sector_rad * np.cos(turn).mean(0)[:, None]
        elevation = height * np.sin(turn).mean(0)[:, None] + offset
        return Firing(_unit_rays(azimuth, elevation), time_ns)


@cache
def make_turn_firing(
    sector_rad: float, step_rad: float, elevation_deg: tuple[float, ...]
) -> Firing:
    """Make the firing of a turn from azimuth +sector to -sector at the elevations of the beams."""
    columns = np.arange(round(2 * sector_rad / step_rad) + 1)
    beams = _unit_rays(sector_rad - step_rad * columns[:, None], np.deg2rad(elevation_deg))
    return Firing(
        beams, np.round(columns * step_rad / (2 * np.pi) * SCAN_PERIOD_NS).astype(np.int64)
    )


def coarse_beam_directions(pattern: ScanPattern, sector_rad: float) -> np.ndarray:
    """Return unit beams (columns, beams, 3), every 1° by 2°, over the field of a pattern."""
    low, high = min(pattern.elevation_deg), max(pattern.elevation_deg)
    elevation = tuple(np.arange(low, high + 0.5, 2).tolist())
    return make_turn_firing(sector_rad, np.deg2rad(1.0), elevation).beam_directions


def _unit_rays(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    flat = np.cos(elevation)
    x, y = flat * np.cos(azimuth), flat * np.sin(azimuth)
    return np.stack(np.broadcast_arrays(x, y, np.sin(elevation)), -1)


SCAN_PATTERNS: dict[str, ScanPattern] = {
    "beams16": SpinningPattern(tuple(range(-15, 16, 2)), 1800),
    "beams32": SpinningPattern(tuple(np.linspace(16.6, -16.6, 32).tolist()), 1024),
    "flat": SpinningPattern((0.0,), 1440),
    "rosette": RosettePattern(6, 4000, 15.0, (71.3, -44.07)),
}
