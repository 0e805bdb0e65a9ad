"""Faults of the poses of a body as motion capture sent them."""

from typing import TypeAlias

import numpy as np

from calib.geometry.mask_runs import find_runs
from calib.geometry.units import NS_PER_S

Rows: TypeAlias = int | slice | np.ndarray

MAX_POSITION_M = 1e8  # no map is as large: UTM and earth-centred ones reach 1e7
MAX_QUAT_NORM_ERROR = 0.01
# A carried or driving body does not move faster.
MAX_BODY_SPEED_MPS, MAX_BODY_TURN_RADPS = 15.0, 30.0
JUMP_MARGIN_M, JUMP_MARGIN_RAD = 0.05, 0.2  # added to that for noise and late stamps
MAX_JUMP_LOCATIONS = 8  # places that a track can jump between
MAX_TRACK_GAP_NS = 500_000_000  # after a longer gap a body may be anywhere
MIN_FROZEN_NS, MIN_FROZEN_REPEATS = 50_000_000, 3  # of a frozen pose
MIN_END_FREEZE_NS = 500_000_000  # of a frozen pose at the end of the track
N_STEPS_BEFORE_FREEZE = 10  # steps that show how a body moved before
# A body that was lost has moved by more when it is seen again.
MIN_UNFREEZE_STEP_M, MIN_UNFREEZE_STEP_RAD = 1e-3, 5e-3
# Steps within a burst and the gap before it, relative to the usual period.
MAX_BURST_PERIOD_RATIO, MIN_BURST_GAP_RATIO = 0.2, 1.5


def flag_poses(t: np.ndarray, xyz: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Return the fault of each pose of one body in log order, (n,) of str; "" means none.

    t: (n,) stamps, ns; xyz: (n, 3), m; quat: (n, 4), xyzw.
    """
    out = np.full(len(t), "", dtype=object)
    if len(t) == 0:
        return out
    out[_find_bad_stamps(t)] = "stamp not increasing"
    single = flag_single_poses(xyz, quat)
    out[single != ""] = single[single != ""]
    for name, rule in (
        ("frozen", _find_frozen),
        ("stamp in a burst", _find_bursts),
        ("jump", _find_jumps),
    ):
        good = np.flatnonzero(out == "")
        if len(good) > 2:
            out[good[rule(t[good], xyz[good], quat[good])]] = name
    return out


def flag_single_poses(xyz: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Return the fault of each pose by itself, whatever its time, (n,) of str."""
    out = np.full(len(xyz), "", dtype=object)
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(quat, axis=1)
    out[np.abs(norm - 1) > MAX_QUAT_NORM_ERROR] = "quaternion not unit"
    # A body that is always at the origin defines the map; one that drops there was lost.
    lost = (xyz == 0).all(1) & ((quat == 0).all(1) | (np.abs(quat) == [0, 0, 0, 1]).all(1))
    out[lost & ~lost.all()] = "zeros"
    out[(np.abs(xyz) > MAX_POSITION_M).any(1)] = "out of range"
    out[~(np.isfinite(xyz).all(1) & np.isfinite(quat).all(1))] = "not a number"
    return out


def _find_bad_stamps(t: np.ndarray) -> np.ndarray:
    """Return where stamps do not increase, (n,) bool.

    A stamp that runs ahead is bad too: those after it continue from the one before it.
    """
    ahead = np.zeros(len(t), bool)
    ahead[1:-1] = (t[1:-1] > t[2:]) & (t[2:] > t[:-2])
    least = np.iinfo(np.int64).min
    newest = np.maximum.accumulate(np.concatenate([[least], np.where(ahead, least, t)[:-1]]))
    return ahead | (t <= newest)


def _step_sizes(
    xyz: np.ndarray, quat: np.ndarray, first: Rows, second: Rows
) -> tuple[np.ndarray, np.ndarray]:
    """Return distances, m, and angles, rad, between the poses of two sets of rows."""
    turn = np.abs((quat[first] * quat[second]).sum(-1))
    length = np.linalg.norm(quat[first], axis=-1) * np.linalg.norm(quat[second], axis=-1)
    angle = 2 * np.arccos(np.minimum(turn / length, 1.0))
    return np.linalg.norm(xyz[second] - xyz[first], axis=-1), angle


def _find_frozen(t: np.ndarray, xyz: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Return where poses repeat the one before exactly while the body moved on, (n,) bool.

    The body moved on if it is elsewhere when it is seen again. A pose that repeats because nothing
    moves is correct.
    """
    same = (np.diff(np.column_stack([xyz, quat]), axis=0) == 0).all(1)
    starts, ends = (find_runs(same) + [0, 1]).T  # a step ends at the next pose
    long = (ends - starts >= MIN_FROZEN_REPEATS) & (t[ends] - t[starts] >= MIN_FROZEN_NS)
    runs = list(zip(starts[long].tolist(), ends[long].tolist(), strict=True))
    lost = [r for r in runs if r[1] < len(t) - 1 and _has_moved_after_freeze(xyz, quat, *r)]
    # If a body is not seen again, only its last steps show whether it came to rest.
    last = runs[-1] if runs else (0, 0)
    if last[1] == len(t) - 1 and t[last[1]] - t[last[0]] >= MIN_END_FREEZE_NS:
        lost += [last] if _is_moving_before_freeze(xyz, quat, last[0]) else []
    out = np.zeros(len(t), bool)
    for first, end in lost:
        out[first + 1 : end + 1] = True
    return out


def _has_moved_after_freeze(xyz: np.ndarray, quat: np.ndarray, first: int, last: int) -> bool:
    """Return whether the step after a run of equal poses is larger than the steps around it."""
    distance, angle = _step_sizes(xyz, quat, last, last + 1)
    steps_around = [(first - 1, first)] if first else []
    steps_around += [(last + 1, last + 2)] if last + 2 < len(xyz) else []
    around = np.array([_step_sizes(xyz, quat, *step) for step in steps_around]).reshape(-1, 2)
    max_distance, max_angle = around.max(0, initial=0.0)
    return bool(
        distance > max(MIN_UNFREEZE_STEP_M, 3 * max_distance)
        or angle > max(MIN_UNFREEZE_STEP_RAD, 3 * max_angle)
    )


def _is_moving_before_freeze(xyz: np.ndarray, quat: np.ndarray, last: int) -> bool:
    """Return whether the step to a pose is not much smaller than the steps before it."""
    if last < N_STEPS_BEFORE_FREEZE:
        return False
    before = np.arange(last - N_STEPS_BEFORE_FREEZE, last)
    distances, angles = _step_sizes(xyz, quat, before, before + 1)
    return bool(distances[-1] > np.median(distances) / 2 or angles[-1] > np.median(angles) / 2)


def _find_bursts(t: np.ndarray, xyz: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Return where poses were stamped late, because they waited in a burst, (n,) bool.

    Only the last pose of a burst has a correct stamp.
    """
    step = np.diff(t)
    usual = np.median(step)
    close = np.append(step < MAX_BURST_PERIOD_RATIO * usual, False)
    out, waited = np.zeros(len(t), bool), False
    for i in np.flatnonzero(close).tolist():
        after_gap = i > 0 and step[i - 1] > MIN_BURST_GAP_RATIO * usual
        waited = after_gap or (waited and i > 0 and close[i - 1])
        out[i] = waited
    return out


def exceeds_speed(t: np.ndarray, xyz: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Return whether no body can move from each pose to the next, (n - 1,) bool."""
    distances, angles = _step_sizes(xyz, quat, slice(None, -1), slice(1, None))
    seconds = np.diff(t) / NS_PER_S
    return (distances > JUMP_MARGIN_M + MAX_BODY_SPEED_MPS * seconds) | (
        angles > JUMP_MARGIN_RAD + MAX_BODY_TURN_RADPS * seconds
    )


def _find_jumps(t: np.ndarray, xyz: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """Return where poses are at places that the body cannot have reached, (n,) bool.

    Another body under this name, or a wrong fit of the markers. In each stretch of the track
    without a gap the place with the most poses is correct.
    """
    jump = exceeds_speed(t, xyz, quat)
    out = np.zeros(len(t), bool)
    gaps = np.flatnonzero(np.diff(t) > MAX_TRACK_GAP_NS) + 1
    for stretch in np.split(np.arange(len(t)), gaps):
        cuts = np.flatnonzero(jump[stretch[:-1]]) + 1
        if len(cuts):
            parts = np.split(stretch, cuts)
            locations = _number_locations(parts, xyz, quat)
            n_poses = np.bincount(locations, [len(p) for p in parts])
            for part, location in zip(parts, locations, strict=True):
                out[part] = location != n_poses.argmax()
    return out


def _number_locations(
    track_parts: list[np.ndarray], xyz: np.ndarray, quat: np.ndarray
) -> list[int]:
    """Return the number of the place of each part of a track.

    A part that continues an earlier part has its number. Only the MAX_JUMP_LOCATIONS places seen
    last are compared.
    """
    locations: list[int] = []
    last_rows: dict[int, int] = {}  # row of the last pose by location, latest location at the end
    for part in track_parts:
        first, location = part[0], len(locations)
        if last_rows:
            steps = _combined_distance(xyz, quat, np.array(list(last_rows.values())), first)
            if steps.min() < _combined_distance(xyz, quat, first - 1, first) / 2:
                location = list(last_rows)[int(steps.argmin())]
        last_rows.pop(location, None)
        last_rows[location] = part[-1]
        if len(last_rows) > MAX_JUMP_LOCATIONS:
            del last_rows[next(iter(last_rows))]
        locations.append(location)
    return locations


def _combined_distance(xyz: np.ndarray, quat: np.ndarray, first: Rows, second: Rows) -> np.ndarray:
    """Return distances between poses, with a metre equal to a radian."""
    return np.add(*_step_sizes(xyz, quat, first, second))
