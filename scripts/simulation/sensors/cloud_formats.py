"""Cloud formats of lidar drivers.

To add a driver: one line in DRIVERS, and one in FIELDS for each field that is new. The formats are
those that the vendors' drivers publish by default, or when they are asked for times.
"""

from typing import NamedTuple

import numpy as np

from calib.geometry.units import NS_PER_S


class Echoes(NamedTuple):
    """What a lidar measured: xyz (columns, beams, 3), m, lidar frame, distance and grey level
    (columns, beams), whether there is a return, and the columns' times (columns, 1), ns after
    the stamp t, ns."""

    xyz: np.ndarray
    distance_m: np.ndarray
    grey_level: np.ndarray
    has_return: np.ndarray
    column_time_ns: np.ndarray
    stamp_ns: int


class CloudFormat(NamedTuple):
    """Layout of a point; whether a cloud is an image of beams by columns, or a list of the returns
    in the order of firing; x, y, z where there is no return; whether the stamp is that of the last
    column, not of the first; and what fields hold that mean something else to other drivers."""

    point_dtype: np.dtype
    is_organized: bool
    no_return_value: float = 0.0
    has_end_stamp: bool = False
    field_overrides: dict = {}


def _point_dtype(size, **fields):
    """dtype of size bytes; each field is "format offset"."""
    names = list(fields)
    formats, offsets = zip(*(f.split() for f in fields.values()), strict=True)
    offsets = [int(o) for o in offsets]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


def _absolute_time_ns(echoes):
    return (echoes.stamp_ns + echoes.column_time_ns).astype(float)


def _absolute_time_s(echoes):
    return (echoes.stamp_ns + echoes.column_time_ns) / NS_PER_S


XYZ_FIELDS = {"x": "<f4 0", "y": "<f4 4", "z": "<f4 8"}
_VELODYNE_POINT = _point_dtype(22, **XYZ_FIELDS, intensity="<f4 12", ring="<u2 16", time="<f4 18")
_TIMESTAMP_POINT = _point_dtype(
    26, **XYZ_FIELDS, intensity="<f4 12", ring="<u2 16", timestamp="<f8 18"
)
CLOUD_FORMATS = {
    "velodyne": CloudFormat(_VELODYNE_POINT, False),
    # As ros-drivers' velodyne without timestamp_first_packet.
    "velodyne_last": CloudFormat(_VELODYNE_POINT, False, has_end_stamp=True),
    "ouster": CloudFormat(
        _point_dtype(
            48, **XYZ_FIELDS, intensity="<f4 16", t="<u4 20", reflectivity="<u2 24", ring="<u2 26",
            ambient="<u2 28", range="<u4 32",
        ),
        True,
    ),
    "hesai": CloudFormat(_TIMESTAMP_POINT, False, field_overrides={"timestamp": _absolute_time_s}),
    "robosense": CloudFormat(_TIMESTAMP_POINT, True, np.nan, field_overrides={"timestamp": _absolute_time_s}),
    "plain": CloudFormat(_point_dtype(16, **XYZ_FIELDS, intensity="<f4 12"), False),
    "livox": CloudFormat(
        _point_dtype(26, **XYZ_FIELDS, intensity="<f4 12", tag="u1 16", line="u1 17", timestamp="<f8 18"),
        False, field_overrides={"timestamp": _absolute_time_ns},
    ),
    "nebula": CloudFormat(
        _point_dtype(
            32, **XYZ_FIELDS, intensity="u1 12", return_type="u1 13", channel="<u2 14", azimuth="<f4 16",
            elevation="<f4 20", distance="<f4 24", time_stamp="<u4 28",
        ),
        False,
    ),
    "nebula_legacy": CloudFormat(
        _point_dtype(
            48, **XYZ_FIELDS, intensity="<f4 16", ring="<u2 20", azimuth="<f4 24", distance="<f4 28",
            return_type="u1 32", time_stamp="<f8 40",
        ),
        False, field_overrides={"time_stamp": _absolute_time_s},
    ),
    "sick": CloudFormat(
        _point_dtype(
            27, **XYZ_FIELDS, i="<f4 12", t="<u4 16", ts="<f4 20", ring="i1 24", layer="i1 25",
            echo="i1 26",
        ),
        False,
    ),
    "sick_split": CloudFormat(
        _point_dtype(25, **XYZ_FIELDS, i="<f4 12", lidar_sec="<u4 16", lidar_nsec="<u4 20", ring="i1 24"), False
    ),
}  # fmt: skip


def _ring_numbers(echoes):
    return np.arange(echoes.distance_m.shape[1])


def _intensity(echoes):
    return np.where(echoes.has_return, np.round(echoes.grey_level / 2), 0)


FIELD_VALUES = {
    "x": lambda e: e.xyz[..., 0],
    "y": lambda e: e.xyz[..., 1],
    "z": lambda e: e.xyz[..., 2],
    "intensity": _intensity,
    "i": _intensity,
    "reflectivity": _intensity,
    "ring": _ring_numbers,
    "line": _ring_numbers,
    "channel": _ring_numbers,
    "layer": _ring_numbers,
    "time": lambda e: e.column_time_ns * 1e-9,
    "ts": lambda e: e.column_time_ns * 1e-9,
    "t": lambda e: e.column_time_ns,
    "time_stamp": lambda e: e.column_time_ns,
    "lidar_sec": lambda e: (e.stamp_ns + e.column_time_ns) // NS_PER_S,
    "lidar_nsec": lambda e: (e.stamp_ns + e.column_time_ns) % NS_PER_S,
    "range": lambda e: np.round(e.distance_m * 1e3),
    "distance": lambda e: e.distance_m,
    "azimuth": lambda e: np.arctan2(e.xyz[..., 1], e.xyz[..., 0]),
    "elevation": lambda e: np.arctan2(e.xyz[..., 2], np.hypot(e.xyz[..., 0], e.xyz[..., 1])),
    "ambient": lambda e: 20,
    "tag": lambda e: 0,
    "echo": lambda e: 0,
    "return_type": lambda e: 1,
}


def apply_driver_stamp(driver_name, echoes):
    """The Echoes with the stamp that the driver so named gives them, and times after that."""
    if not CLOUD_FORMATS[driver_name].has_end_stamp:
        return echoes
    last = int(echoes.column_time_ns[-1, 0])
    return echoes._replace(
        stamp_ns=echoes.stamp_ns + last, column_time_ns=echoes.column_time_ns - last
    )


def make_point_array(driver_name, echoes):
    """Points (height, width) of the driver so named."""
    layout, organised, nothing, _, holds = CLOUD_FORMATS[driver_name]
    shape = echoes.distance_m.shape
    # Filled in its final order: a copy of a layout with gaps leaves the gaps to chance.
    out = np.zeros(shape[::-1] if organised else shape, layout)
    for name in layout.names:
        values = np.broadcast_to((FIELD_VALUES | holds)[name](echoes), shape)
        if name in XYZ_FIELDS:
            values = np.where(echoes.has_return, values, nothing)
        out[name] = values.T if organised else values
    return out if organised else out[echoes.has_return][None]
