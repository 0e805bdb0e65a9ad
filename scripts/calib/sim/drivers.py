"""Cloud formats of lidar drivers.

To add a driver: one line in DRIVERS, and one in FIELDS for each field that is new. The formats are
those that the vendors' ROS 2 drivers publish by default.
"""

from typing import NamedTuple

import numpy as np


class Echoes(NamedTuple):
    """What a lidar measured: xyz (columns, beams, 3), m, lidar frame, distance and grey level
    (columns, beams), whether there is a return, and the columns' times (columns, 1), ns after
    the stamp t, ns."""

    xyz: np.ndarray
    distance: np.ndarray
    grey: np.ndarray
    returned: np.ndarray
    after: np.ndarray
    t: int


class Driver(NamedTuple):
    """Layout of a point, and whether a cloud is an image of beams by columns with zeros where
    there is no return, or a list of the returns in the order of firing."""

    point: np.dtype
    organised: bool


def _layout(size, **fields):
    """dtype of size bytes; each field is "format offset"."""
    names = list(fields)
    formats, offsets = zip(*(f.split() for f in fields.values()), strict=True)
    offsets = [int(o) for o in offsets]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


XYZ = {"x": "<f4 0", "y": "<f4 4", "z": "<f4 8"}
DRIVERS = {
    "velodyne": Driver(_layout(22, **XYZ, intensity="<f4 12", ring="<u2 16", time="<f4 18"), False),
    "ouster": Driver(
        _layout(
            48, **XYZ, intensity="<f4 16", t="<u4 20", reflectivity="<u2 24", ring="<u2 26",
            ambient="<u2 28", range="<u4 32",
        ),
        True,
    ),
    "plain": Driver(_layout(16, **XYZ, intensity="<f4 12"), False),
    "livox": Driver(
        _layout(26, **XYZ, intensity="<f4 12", tag="u1 16", line="u1 17", timestamp="<f8 18"), False
    ),
}  # fmt: skip
FIELDS = {
    "x": lambda e: e.xyz[..., 0],
    "y": lambda e: e.xyz[..., 1],
    "z": lambda e: e.xyz[..., 2],
    "intensity": lambda e: np.where(e.returned, np.round(e.grey / 2), 0),
    "reflectivity": lambda e: np.where(e.returned, np.round(e.grey / 2), 0),
    "ring": lambda e: np.arange(e.distance.shape[1]),
    "line": lambda e: np.arange(e.distance.shape[1]),
    "time": lambda e: e.after * 1e-9,
    "t": lambda e: e.after,
    "timestamp": lambda e: (e.t + e.after).astype(float),
    "range": lambda e: np.round(e.distance * 1e3),
    "ambient": lambda e: 20,
    "tag": lambda e: 0,
}


def points(driver, echoes):
    """Points (height, width) of the driver so named."""
    layout, organised = DRIVERS[driver]
    shape = echoes.distance.shape
    # Filled in its final order: a copy of a layout with gaps leaves the gaps to chance.
    out = np.zeros(shape[::-1] if organised else shape, layout)
    for name in layout.names:
        values = np.broadcast_to(FIELDS[name](echoes), shape)
        out[name] = values.T if organised else values
    return out if organised else out[echoes.returned][None]
