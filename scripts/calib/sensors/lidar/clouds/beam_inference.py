"""Which beam of a lidar measured each point: by a field, or by the elevation that beams keep."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.sensors.lidar.clouds.raw_cloud import RawCloud, stack_xyz

BEAM_FIELDS = ("ring", "channel", "line", "layer", "laser_id", "laser_number", "ring_id", "beam")
MAX_BEAMS = 512
ELEVATION_BIN_DEG = 0.02  # of the histogram of elevations whose peaks are beams
MAX_SINGLE_BEAM_STEP_DEG = 5.0  # of a scanner with a single beam
MIN_EXPLAINED_VARIANCE = 0.9  # of the variance of elevation, by the numbers of beams
MAX_BEAM_WIDTH_SHARE = 0.3  # of the step between beams: largest width of the elevations of one
MIN_SHARE_IN_BEAMS = 0.9  # of the points
CLOUD_AXES = ("row", "column")


@dataclass(frozen=True)
class BeamSource:
    """What numbers the beams; only one of the three is set.

    field: of the cloud; axis: row or column of an organised cloud; elevation_deg: of the beams,
    ascending.
    """

    field: str = ""
    axis: str = ""
    elevation_deg: tuple[float, ...] = ()


def assign_beams(cloud: RawCloud, beam_source: BeamSource | None) -> np.ndarray:
    """Return the ring (n,) int32 of a cloud's points, -1 where unknown."""
    n = cloud.n_points
    if beam_source is None or (beam_source.field and beam_source.field not in cloud.fields):
        return np.full(n, -1, np.int32)
    if beam_source.field:
        return cloud.fields[beam_source.field].astype(np.int32)
    if beam_source.axis:
        return cloud.grid_index[CLOUD_AXES.index(beam_source.axis)].astype(np.int32)
    return _nearest_beam(point_elevations_deg(cloud), np.array(beam_source.elevation_deg))


def point_elevations_deg(cloud: RawCloud) -> np.ndarray:
    """Return the elevation (n,), deg, of the points above the x-y plane."""
    x, y, z = stack_xyz(cloud).astype(float).T
    return np.degrees(np.arctan2(z, np.hypot(x, y)))


def _nearest_beam(elevation_deg: np.ndarray, beams_deg: np.ndarray) -> np.ndarray:
    """Return the beam (n,) nearest in elevation; -1 if it is half a step away or more."""
    beam = np.searchsorted((beams_deg[1:] + beams_deg[:-1]) / 2, elevation_deg)
    step = min(np.diff(beams_deg), default=MAX_SINGLE_BEAM_STEP_DEG)
    is_far = np.abs(elevation_deg - beams_deg[beam]) >= step / 2
    return np.where(is_far, -1, beam).astype(np.int32)


def infer_beams(clouds: Sequence[RawCloud]) -> tuple[BeamSource | None, str]:
    """Infer the beams from the returns of a few clouds, and describe them.

    Without beams the description says what that costs.
    """
    elevation = np.concatenate([point_elevations_deg(c) for c in clouds])
    field, text = _infer_beam_field(clouds, elevation)
    if field is not None:
        return field, text
    if len(elevation) and np.ptp(elevation) < ELEVATION_BIN_DEG:
        beam = BeamSource(elevation_deg=(round(float(np.median(elevation)), 4),))
        return beam, "a 2-D scanner: one line, with little information across it"
    organised = [a for a in CLOUD_AXES if _has_constant_elevation(clouds, elevation, a)]
    if organised:
        return BeamSource(axis=organised[0]), f"{text}, inferred: each {organised[0]} is one beam"
    beams = _elevation_peaks_deg(elevation)
    if len(beams):
        text += f", inferred: {len(beams)} beams, {beams[0]:.2f} to {beams[-1]:.2f}° high"
        return BeamSource(elevation_deg=tuple(np.round(beams, 4).tolist())), text
    return None, (
        f"{text}, and the points lie on no lines of one elevation, as of a solid-state lidar: "
        "a board's outline is not used, only its plane. Tilt boards to all sides."
    )


def _infer_beam_field(
    clouds: Sequence[RawCloud], elevation: np.ndarray
) -> tuple[BeamSource | None, str]:
    """Return the first field that numbers the beams, or None, and describe it."""
    text = "no ring"
    for name in (f for f in BEAM_FIELDS if f in clouds[0].fields):
        values = np.concatenate([c.fields[name] for c in clouds])
        if values.dtype.kind not in "iu":
            continue
        kind, count = values.dtype.name, len(np.unique(values))
        text = f"{name} ({kind}) does not number the beams: it has {count} values"
        if 1 < count <= MAX_BEAMS:
            if _explained_variance(values, elevation) > MIN_EXPLAINED_VARIANCE:
                return BeamSource(field=name), f"{name} ({kind}), {count} beams"
            text = f"the {count} lines of {name} ({kind}) sweep up and down"
    return None, text


def _explained_variance(number: np.ndarray, elevation: np.ndarray) -> float:
    """Return the share of the variance of elevations (n,) that the means of the beams explain."""
    beam = np.unique(number, return_inverse=True)[1]
    means = np.bincount(beam, elevation) / np.bincount(beam)
    return np.var(means[beam]) / max(np.var(elevation), 1e-12)


def _has_constant_elevation(clouds: Sequence[RawCloud], elevation: np.ndarray, axis: str) -> bool:
    """Whether each row or column of organised clouds has one elevation."""
    number = np.concatenate([c.grid_index[CLOUD_AXES.index(axis)] for c in clouds])
    if min(clouds[0].shape) < 2 or len(np.unique(number)) > MAX_BEAMS or not len(number):
        return False
    order = np.argsort(number, kind="stable")
    groups = np.split(elevation[order], np.flatnonzero(np.diff(number[order])) + 1)
    middles = np.sort([np.median(g) for g in groups])
    if len(middles) < 2:
        return False
    width = np.median([np.subtract(*np.quantile(g, (0.9, 0.1))) for g in groups])
    return bool(width < MAX_BEAM_WIDTH_SHARE * np.median(np.diff(middles)))


def _elevation_peaks_deg(elevation: np.ndarray) -> np.ndarray:
    """Return the elevations, deg, ascending, on which points lie; none if they lie on all."""
    if not len(elevation):
        return np.zeros(0)
    number, count = np.unique(
        np.floor(elevation / ELEVATION_BIN_DEG).astype(int), return_counts=True
    )
    # A beam is a run of filled bins; a bin that holds a stray point or two is none.
    least = max(2, 0.01 * np.quantile(count, 0.9))
    number, count = number[count > least], count[count > least]
    if not len(number):
        return np.zeros(0)
    runs = np.split(np.arange(len(number)), np.flatnonzero(np.diff(number) > 1) + 1)
    middles = (
        np.array([np.average(number[r] + 0.5, weights=count[r]) for r in runs]) * ELEVATION_BIN_DEG
    )
    if not 1 < len(runs) <= MAX_BEAMS or count.sum() < MIN_SHARE_IN_BEAMS * len(elevation):
        return np.zeros(0)
    # The mean over points of the width of their run.
    n_bins = np.average([len(r) for r in runs], weights=[count[r].sum() for r in runs])
    max_width = MAX_BEAM_WIDTH_SHARE * np.median(np.diff(middles))
    return middles if n_bins * ELEVATION_BIN_DEG < max_width else np.zeros(0)
