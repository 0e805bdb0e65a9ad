"""Lay out points as lidar drivers do.

To add a driver: one entry in CLOUD_FORMATS, and one in FIELD_VALUES for each new field. The
formats are those that the vendors' drivers publish by default, or with point times switched on.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from calib.geometry.units import NS_PER_S


class Echoes(NamedTuple):
    """What a lidar measured: xyz (columns, beams, 3), m, lidar frame; distance, grey level and
    whether there is a return (columns, beams); column_time_ns (columns, 1) after the stamp."""

    xyz: np.ndarray
    distance_m: np.ndarray
    grey_level: np.ndarray
    has_return: np.ndarray
    column_time_ns: np.ndarray
    stamp_ns: int


FieldValues = Callable[[Echoes], np.ndarray | int]
NO_OVERRIDES: Mapping[str, FieldValues] = MappingProxyType({})


class CloudFormat(NamedTuple):
    """The cloud of a driver.

    is_organized: an image of beams by columns, not a list of the returns in the order of firing;
    no_return_value: x, y and z without a return; has_end_stamp: the stamp is that of the last
    column; field_overrides: fields that mean something else to other drivers.
    """

    point_dtype: np.dtype
    is_organized: bool
    no_return_value: float = 0.0
    has_end_stamp: bool = False
    field_overrides: Mapping[str, FieldValues] = NO_OVERRIDES


def _point_dtype(size: int, **fields: str) -> np.dtype:
    """Make a dtype of size bytes; each field is "format offset"."""
    formats, offsets = zip(*(text.split() for text in fields.values()), strict=True)
    return np.dtype(
        {
            "names": list(fields),
            "formats": list(formats),
            "offsets": [int(offset) for offset in offsets],
            "itemsize": size,
        }
    )


def _absolute_time_ns(echoes: Echoes) -> np.ndarray:
    return (echoes.stamp_ns + echoes.column_time_ns).astype(float)


def _absolute_time_s(echoes: Echoes) -> np.ndarray:
    return (echoes.stamp_ns + echoes.column_time_ns) / NS_PER_S


XYZ_FIELDS = {"x": "<f4 0", "y": "<f4 4", "z": "<f4 8"}
_VELODYNE_POINT = _point_dtype(22, **XYZ_FIELDS, intensity="<f4 12", ring="<u2 16", time="<f4 18")
_TIMESTAMP_POINT = _point_dtype(
    26, **XYZ_FIELDS, intensity="<f4 12", ring="<u2 16", timestamp="<f8 18"
)
CLOUD_FORMATS: dict[str, CloudFormat] = {
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
    "robosense": CloudFormat(
        _TIMESTAMP_POINT, True, np.nan, field_overrides={"timestamp": _absolute_time_s}
    ),
    "plain": CloudFormat(_point_dtype(16, **XYZ_FIELDS, intensity="<f4 12"), False),
    "livox": CloudFormat(
        _point_dtype(
            26, **XYZ_FIELDS, intensity="<f4 12", tag="u1 16", line="u1 17", timestamp="<f8 18"
        ),
        False, field_overrides={"timestamp": _absolute_time_ns},
    ),
    "nebula": CloudFormat(
        _point_dtype(
            32, **XYZ_FIELDS, intensity="u1 12", return_type="u1 13", channel="<u2 14",
            azimuth="<f4 16", elevation="<f4 20", distance="<f4 24", time_stamp="<u4 28",
        ),
        False,
    ),
    "nebula_legacy": CloudFormat(
        _point_dtype(
            48, **XYZ_FIELDS, intensity="<f4 16", ring="<u2 20", azimuth="<f4 24",
            distance="<f4 28", return_type="u1 32", time_stamp="<f8 40",
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
        _point_dtype(
            25, **XYZ_FIELDS, i="<f4 12", lidar_sec="<u4 16", lidar_nsec="<u4 20", ring="i1 24"
        ),
        False,
    ),
}  # fmt: skip


def _ring_numbers(echoes: Echoes) -> np.ndarray:
    return np.arange(echoes.distance_m.shape[1])


def _intensity(echoes: Echoes) -> np.ndarray:
    return np.where(echoes.has_return, np.round(echoes.grey_level / 2), 0)


FIELD_VALUES: dict[str, FieldValues] = {
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


def apply_driver_stamp(driver_name: str, echoes: Echoes) -> Echoes:
    """Return the echoes with the stamp that a driver gives them, and column times after it."""
    if not CLOUD_FORMATS[driver_name].has_end_stamp:
        return echoes
    last = int(echoes.column_time_ns[-1, 0])
    return echoes._replace(
        stamp_ns=echoes.stamp_ns + last, column_time_ns=echoes.column_time_ns - last
    )


def make_point_array(driver_name: str, echoes: Echoes) -> np.ndarray:
    """Make the structured points (height, width) of a driver."""
    cloud_format, shape = CLOUD_FORMATS[driver_name], echoes.distance_m.shape
    field_values = {**FIELD_VALUES, **cloud_format.field_overrides}
    is_organized = cloud_format.is_organized
    # Zeros in its final order: a copy of a layout with gaps leaves the gaps to chance.
    list_shape = (1, np.count_nonzero(echoes.has_return))
    points = np.zeros(shape[::-1] if is_organized else list_shape, cloud_format.point_dtype)
    for name in cloud_format.point_dtype.names or ():
        values = np.broadcast_to(field_values[name](echoes), shape)
        if name in XYZ_FIELDS:
            values = np.where(echoes.has_return, values, cloud_format.no_return_value)
        points[name] = values.T if is_organized else values[echoes.has_return]
    return points
