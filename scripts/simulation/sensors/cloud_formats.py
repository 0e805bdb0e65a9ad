"""Cloud formats of lidar drivers.

To add a driver: one line in DRIVERS, and one in FIELDS for each field that is new. The formats are
those that the vendors' drivers publish by default, or when they are asked for times.
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
    """Layout of a point; whether a cloud is an image of beams by columns, or a list of the returns
    in the order of firing; x, y, z where there is no return; whether the stamp is that of the last
    column, not of the first; and what fields hold that mean something else to other drivers."""

    point: np.dtype
    organised: bool
    nothing: float = 0.0
    at_end: bool = False
    holds: dict = {}


def _layout(size, **fields):
    """dtype of size bytes; each field is "format offset"."""
    names = list(fields)
    formats, offsets = zip(*(f.split() for f in fields.values()), strict=True)
    offsets = [int(o) for o in offsets]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


def _clock_ns(e):
    return (e.t + e.after).astype(float)


def _clock_s(e):
    return (e.t + e.after) / 1e9


XYZ = {"x": "<f4 0", "y": "<f4 4", "z": "<f4 8"}
_VELODYNE = _layout(22, **XYZ, intensity="<f4 12", ring="<u2 16", time="<f4 18")
_TIMESTAMP = _layout(26, **XYZ, intensity="<f4 12", ring="<u2 16", timestamp="<f8 18")
DRIVERS = {
    "velodyne": Driver(_VELODYNE, False),
    # As ros-drivers' velodyne without timestamp_first_packet.
    "velodyne_last": Driver(_VELODYNE, False, at_end=True),
    "ouster": Driver(
        _layout(
            48, **XYZ, intensity="<f4 16", t="<u4 20", reflectivity="<u2 24", ring="<u2 26",
            ambient="<u2 28", range="<u4 32",
        ),
        True,
    ),
    "hesai": Driver(_TIMESTAMP, False, holds={"timestamp": _clock_s}),
    "robosense": Driver(_TIMESTAMP, True, np.nan, holds={"timestamp": _clock_s}),
    "plain": Driver(_layout(16, **XYZ, intensity="<f4 12"), False),
    "livox": Driver(
        _layout(26, **XYZ, intensity="<f4 12", tag="u1 16", line="u1 17", timestamp="<f8 18"),
        False, holds={"timestamp": _clock_ns},
    ),
    "nebula": Driver(
        _layout(
            32, **XYZ, intensity="u1 12", return_type="u1 13", channel="<u2 14", azimuth="<f4 16",
            elevation="<f4 20", distance="<f4 24", time_stamp="<u4 28",
        ),
        False,
    ),
    "nebula_legacy": Driver(
        _layout(
            48, **XYZ, intensity="<f4 16", ring="<u2 20", azimuth="<f4 24", distance="<f4 28",
            return_type="u1 32", time_stamp="<f8 40",
        ),
        False, holds={"time_stamp": _clock_s},
    ),
    "sick": Driver(
        _layout(
            27, **XYZ, i="<f4 12", t="<u4 16", ts="<f4 20", ring="i1 24", layer="i1 25",
            echo="i1 26",
        ),
        False,
    ),
    "sick_split": Driver(
        _layout(25, **XYZ, i="<f4 12", lidar_sec="<u4 16", lidar_nsec="<u4 20", ring="i1 24"), False
    ),
}  # fmt: skip


def _number(e):
    return np.arange(e.distance.shape[1])


def _brightness(e):
    return np.where(e.returned, np.round(e.grey / 2), 0)


FIELDS = {
    "x": lambda e: e.xyz[..., 0],
    "y": lambda e: e.xyz[..., 1],
    "z": lambda e: e.xyz[..., 2],
    "intensity": _brightness,
    "i": _brightness,
    "reflectivity": _brightness,
    "ring": _number,
    "line": _number,
    "channel": _number,
    "layer": _number,
    "time": lambda e: e.after * 1e-9,
    "ts": lambda e: e.after * 1e-9,
    "t": lambda e: e.after,
    "time_stamp": lambda e: e.after,
    "lidar_sec": lambda e: (e.t + e.after) // 10**9,
    "lidar_nsec": lambda e: (e.t + e.after) % 10**9,
    "range": lambda e: np.round(e.distance * 1e3),
    "distance": lambda e: e.distance,
    "azimuth": lambda e: np.arctan2(e.xyz[..., 1], e.xyz[..., 0]),
    "elevation": lambda e: np.arctan2(e.xyz[..., 2], np.hypot(e.xyz[..., 0], e.xyz[..., 1])),
    "ambient": lambda e: 20,
    "tag": lambda e: 0,
    "echo": lambda e: 0,
    "return_type": lambda e: 1,
}


def stamped(driver, echoes):
    """The Echoes with the stamp that the driver so named gives them, and times after that."""
    if not DRIVERS[driver].at_end:
        return echoes
    last = int(echoes.after[-1, 0])
    return echoes._replace(t=echoes.t + last, after=echoes.after - last)


def points(driver, echoes):
    """Points (height, width) of the driver so named."""
    layout, organised, nothing, _, holds = DRIVERS[driver]
    shape = echoes.distance.shape
    # Filled in its final order: a copy of a layout with gaps leaves the gaps to chance.
    out = np.zeros(shape[::-1] if organised else shape, layout)
    for name in layout.names:
        values = np.broadcast_to((FIELDS | holds)[name](echoes), shape)
        if name in XYZ:
            values = np.where(echoes.returned, values, nothing)
        out[name] = values.T if organised else values
    return out if organised else out[echoes.returned][None]
