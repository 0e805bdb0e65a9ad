"""A cloud before anyone has said what its fields mean."""

from typing import NamedTuple

import numpy as np

RANGE_FIELDS = ("range", "distance")  # fields that drivers set to zero where there is no return


class RawCloud(NamedTuple):
    """Stamp, ns; fields by name, each (n,); row and column (n,) of each point in an organised
    cloud, whose shape is (height, width)."""

    stamp_ns: int
    fields: dict
    shape: tuple
    grid_index: tuple


def make_raw_cloud(stamp, fields, shape):
    """Raw of all points of a cloud of that shape."""
    number = np.arange(shape[0] * shape[1])
    return RawCloud(stamp, fields, shape, np.divmod(number, max(shape[1], 1)))


def select_cloud_points(cloud, mask):
    """Raw of the points of a cloud where mask (n,) holds."""
    fields = {k: v[mask] for k, v in cloud.fields.items()}
    return cloud._replace(fields=fields, grid_index=tuple(p[mask] for p in cloud.grid_index))


def stack_xyz(cloud):
    """Points (n, 3), m, sensor frame."""
    return np.stack([cloud.fields[k] for k in "xyz"], -1)


def has_return(cloud):
    """Whether each beam (n,) has a return: drivers mark those without by what is not finite, by the
    origin, or by a range of zero."""
    with np.errstate(over="ignore"):
        p = stack_xyz(cloud).astype(np.float32)
    seen = np.isfinite(p).all(1) & (p != 0).any(1)
    for name in RANGE_FIELDS:
        values = cloud.fields.get(name)
        # A driver that fills none of them says nothing by it.
        if values is not None and np.any(values[seen] != 0):
            seen &= values != 0
    return seen
