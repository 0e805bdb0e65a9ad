"""A VLP-16 in a scene: 16 beams, 0.2° steps of azimuth, ten turns a second, clockwise."""

from typing import NamedTuple

import numpy as np

from calib.sim import scene as scenes

ELEVATION = np.deg2rad(np.arange(-15, 16, 2))  # of the rings, from below
AZIMUTH_STEP = np.deg2rad(0.2)
TURN_NS = 100_000_000
RANGE_M = (0.4, 100.0)
POINT = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "ring", "time"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"],
        "offsets": [0, 4, 8, 12, 16, 18],
        "itemsize": 22,
    }
)


class Pattern(NamedTuple):
    """Unit beams (columns, 16, 3), lidar frame, and the time (columns,) of each column, which is
    fired at once, ns after the first."""

    beams: np.ndarray
    after: np.ndarray


def pattern(sector, step=AZIMUTH_STEP):
    """Pattern of azimuths from +sector to -sector, rad, about the lidar's x axis."""
    columns = round(2 * sector / step) + 1
    azimuth = sector - step * np.arange(columns)[:, None]
    flat = np.cos(ELEVATION)
    beams = np.stack(
        np.broadcast_arrays(flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(ELEVATION)), -1
    )
    after = np.round(np.arange(columns) * step / (2 * np.pi) * TURN_NS).astype(np.int64)
    return Pattern(beams, after)


def scan(scene, T_world_surfaces, T_world_lidar, firing, range_noise=0.0, rng=None):
    """Points (POINT) of one turn: the returns, in the order of firing.

    T_world_surfaces by name and T_world_lidar are (4, 4) or (columns, 4, 4), at the columns' times.
    range_noise, m, is the standard deviation along the beam; positions are rounded to float32.
    """
    distance, label = scenes.cast(scene, T_world_surfaces, T_world_lidar, firing.beams)
    room = scenes.index(scene, "room")
    returned = (label != scene.first[room] + scenes.SKY) | (distance == np.inf)
    returned &= (distance > RANGE_M[0]) & (distance < RANGE_M[1])
    if range_noise:
        distance = distance + range_noise * rng.standard_normal(distance.shape)
    column, ring = np.nonzero(returned)
    points = np.zeros(len(column), POINT)
    xyz = firing.beams[column, ring] * distance[column, ring, None]
    points["x"], points["y"], points["z"] = xyz.T
    points["intensity"] = np.round(scene.colors[label[column, ring]].mean(-1) / 2)
    points["ring"], points["time"] = ring, firing.after[column] * 1e-9
    return points
