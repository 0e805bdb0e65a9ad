"""A cloud before its fields are interpreted."""

from typing import NamedTuple

import numpy as np

RANGE_FIELDS = ("range", "distance")  # fields that drivers set to zero where there is no return
INTENSITY_FIELDS = ("intensity", "reflectivity", "i", "signal")  # the first that differs counts


class RawCloud(NamedTuple):
    """The points of one message.

    stamp_ns: of the message; fields: by name, each (n,); shape: (height, width) of an organised
    cloud; grid_index: row (n,) and column (n,) of each point in it.
    """

    stamp_ns: int
    fields: dict[str, np.ndarray]
    shape: tuple[int, int]
    grid_index: tuple[np.ndarray, ...]

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.grid_index[0])


def make_raw_cloud(
    stamp_ns: int, fields: dict[str, np.ndarray], shape: tuple[int, int]
) -> RawCloud:
    """Return all points of a cloud of that shape (height, width)."""
    index = np.arange(shape[0] * shape[1])
    return RawCloud(stamp_ns, fields, shape, np.divmod(index, max(shape[1], 1)))


def select_cloud_points(cloud: RawCloud, mask: np.ndarray) -> RawCloud:
    """Return the points of a cloud where mask (n,) holds."""
    fields = {k: v[mask] for k, v in cloud.fields.items()}
    return cloud._replace(fields=fields, grid_index=tuple(p[mask] for p in cloud.grid_index))


def stack_xyz(cloud: RawCloud) -> np.ndarray:
    """Return the points (n, 3), m, sensor frame."""
    return np.stack([cloud.fields[k] for k in "xyz"], -1)


def has_return(cloud: RawCloud) -> np.ndarray:
    """Return whether each beam (n,) has a return.

    Drivers mark those without one by values that are not finite, by the origin, or by a zero range.
    """
    with np.errstate(over="ignore"):
        p = stack_xyz(cloud).astype(np.float32)
    is_return = np.isfinite(p).all(1) & (p != 0).any(1)
    for name in RANGE_FIELDS:
        values = cloud.fields.get(name)
        # A driver that leaves the whole field at zero does not mark beams by it.
        if values is not None and np.any(values[is_return] != 0):
            is_return &= values != 0
    return is_return


def read_intensity(cloud: RawCloud) -> np.ndarray:
    """Return the intensity (n,) float32 of a cloud's points, NaN where it is unknown.

    A field with one value throughout tells nothing: drivers fill fields that they do not know.
    """
    for name in INTENSITY_FIELDS:
        values = cloud.fields.get(name)
        known = np.zeros(0) if values is None else values[np.isfinite(values)]
        if values is not None and len(known) and known.max() > known.min():
            return np.where(np.isfinite(values), values, np.nan).astype(np.float32)
    return np.full(cloud.n_points, np.nan, np.float32)
