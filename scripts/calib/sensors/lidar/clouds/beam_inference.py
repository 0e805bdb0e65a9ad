"""Which beam of a lidar measured each point: by a field, or by the elevation that beams keep."""

from dataclasses import dataclass

import numpy as np

from calib.sensors.lidar.clouds.raw_cloud import stack_xyz

BEAM_FIELDS = ("ring", "channel", "line", "layer", "laser_id", "laser_number", "ring_id", "beam")
MAX_BEAMS = 512
ELEVATION_BIN_DEG = 0.02  # of the elevations whose peaks are beams
MAX_SINGLE_BEAM_STEP_DEG = 5.0  # of a scanner with a single beam
MIN_EXPLAINED_VARIANCE = 0.9  # of the variance of elevation that the numbers of beams must explain
MAX_BEAM_WIDTH_SHARE = 0.3  # of the step between beams: how wide the elevations of one may be
MIN_SHARE_IN_BEAMS = 0.9  # of the points that lie in beams
CLOUD_AXES = ("row", "column")


@dataclass(frozen=True)
class BeamSource:
    """The field that numbers the beams; or row or column of an organised cloud; or the elevations,
    deg, of the beams, ascending. Only one of them is given."""

    field: str = ""
    axis: str = ""
    elevation_deg: tuple = ()


def assign_beams(cloud, beam_source):
    """Ring (n,) int32 of a raw.Raw's points, -1 where unknown."""
    n = len(cloud.grid_index[0])
    if beam_source is None or (beam_source.field and beam_source.field not in cloud.fields):
        return np.full(n, -1, np.int32)
    if beam_source.field:
        return cloud.fields[beam_source.field].astype(np.int32)
    if beam_source.axis:
        return cloud.grid_index[CLOUD_AXES.index(beam_source.axis)].astype(np.int32)
    return _nearest_beam(point_elevations_deg(cloud), np.array(beam_source.elevation_deg))


def point_elevations_deg(cloud):
    """Elevation (n,), deg, of the points above the x-y plane."""
    x, y, z = stack_xyz(cloud).astype(float).T
    return np.degrees(np.arctan2(z, np.hypot(x, y)))


def _nearest_beam(elevation, beams):
    """The beam (n,) nearest in elevation; -1 where it is half a step away or more."""
    beam = np.searchsorted((beams[1:] + beams[:-1]) / 2, elevation)
    far = (
        np.abs(elevation - beams[beam]) >= min(np.diff(beams), default=MAX_SINGLE_BEAM_STEP_DEG) / 2
    )
    return np.where(far, -1, beam).astype(np.int32)


def infer_beams(clouds):
    """(Ring or None, in words how it was found, or what it costs that there is none).

    clouds: a few raw.Raw of returns.
    """
    height = np.concatenate([point_elevations_deg(c) for c in clouds])
    field, told = _infer_beam_field(clouds, height)
    if field is not None:
        return field, told
    if len(height) and np.ptp(height) < ELEVATION_BIN_DEG:
        one = (round(float(np.median(height)), 4),)
        return BeamSource(
            elevation_deg=one
        ), "a 2-D scanner: one line, which tells little across itself"
    organised = [a for a in CLOUD_AXES if _has_constant_elevation(clouds, height, a)]
    if organised:
        return BeamSource(axis=organised[0]), f"{told}, inferred: each {organised[0]} is one beam"
    beams = _elevation_peaks_deg(height)
    if len(beams):
        words = f"{told}, inferred: {len(beams)} beams, {beams[0]:.2f} to {beams[-1]:.2f}° high"
        return BeamSource(elevation_deg=tuple(np.round(beams, 4).tolist())), words
    return None, (
        f"{told}, and the points keep to no lines of one elevation, as of a solid-state lidar: "
        "a board's outline is not used, only its plane; tilt boards to all sides"
    )


def _infer_beam_field(clouds, height):
    """(Ring, words) of the first field that tells beams apart, or (None, words)."""
    told = "no ring"
    for name in (f for f in BEAM_FIELDS if f in clouds[0].fields):
        values = np.concatenate([c.fields[name] for c in clouds])
        if values.dtype.kind not in "iu":
            continue
        kind, count = values.dtype.name, len(np.unique(values))
        told = f"{name} ({kind}) tells no beams apart, it has {count} values"
        if 1 < count <= MAX_BEAMS:
            if _explained_variance(values, height) > MIN_EXPLAINED_VARIANCE:
                return BeamSource(field=name), f"{name} ({kind}), {count} beams"
            told = f"the {count} lines of {name} ({kind}) sweep up and down"
    return None, told


def _explained_variance(number, height):
    """Share of the variance of elevations (n,) that the beams' own means explain."""
    beam = np.unique(number, return_inverse=True)[1]
    means = np.bincount(beam, height) / np.bincount(beam)
    return np.var(means[beam]) / max(np.var(height), 1e-12)


def _has_constant_elevation(clouds, height, axis):
    """Whether each row or column of organised clouds keeps its elevation."""
    number = np.concatenate([c.grid_index[CLOUD_AXES.index(axis)] for c in clouds])
    if min(clouds[0].shape) < 2 or len(np.unique(number)) > MAX_BEAMS or not len(number):
        return False
    order = np.argsort(number, kind="stable")
    groups = np.split(height[order], np.flatnonzero(np.diff(number[order])) + 1)
    middles = np.sort([np.median(g) for g in groups])
    if len(middles) < 2:
        return False
    wide = np.median([np.subtract(*np.quantile(g, (0.9, 0.1))) for g in groups])
    return wide < MAX_BEAM_WIDTH_SHARE * np.median(np.diff(middles))


def _elevation_peaks_deg(height):
    """Elevations, deg, ascending, on which the points lie; none where they lie on all."""
    if not len(height):
        return np.zeros(0)
    number, count = np.unique(np.floor(height / ELEVATION_BIN_DEG).astype(int), return_counts=True)
    # A beam is a run of filled bins; a bin that holds a stray point or two is none.
    least = max(2, 0.01 * np.quantile(count, 0.9))
    number, count = number[count > least], count[count > least]
    if not len(number):
        return np.zeros(0)
    runs = np.split(np.arange(len(number)), np.flatnonzero(np.diff(number) > 1) + 1)
    middles = (
        np.array([np.average(number[r] + 0.5, weights=count[r]) for r in runs]) * ELEVATION_BIN_DEG
    )
    # Of the run in which a point lies, in the mean.
    wide = (
        np.average([len(r) for r in runs], weights=[count[r].sum() for r in runs])
        * ELEVATION_BIN_DEG
    )
    held = count.sum() >= MIN_SHARE_IN_BEAMS * len(height)
    discrete = 1 < len(runs) <= MAX_BEAMS and wide < MAX_BEAM_WIDTH_SHARE * np.median(
        np.diff(middles)
    )
    return middles if held and discrete else np.zeros(0)
