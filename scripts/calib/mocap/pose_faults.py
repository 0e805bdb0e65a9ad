"""What is wrong with the poses of a body as motion capture sent them, by rule."""

import numpy as np

from calib.geometry.units import NS_PER_S

MAX_POSITION_M = 1e5  # no map is as large
MAX_QUAT_NORM_ERROR = 0.01  # by which a quaternion may be off unit
MAX_BODY_SPEED_MPS, MAX_BODY_TURN_RADPS = (
    15.0,
    30.0,
)  # no body that is carried or drives moves faster
JUMP_MARGIN_M, JUMP_MARGIN_RAD = 0.05, 0.2  # by which noise and late stamps may add to that
MAX_JUMP_LOCATIONS = 8  # that a track jumps between
MAX_TRACK_GAP_NS = 500_000_000  # a body unseen for longer may be anywhere
MIN_FROZEN_NS, MIN_FROZEN_REPEATS = (
    50_000_000,
    3,
)  # a pose that is sent again for so long, and so many times
MIN_END_FREEZE_NS = 500_000_000
N_STEPS_BEFORE_FREEZE = 10  # before a pose that tell how a body moved
MIN_UNFREEZE_STEP_M, MIN_UNFREEZE_STEP_RAD = (
    1e-3,
    5e-3,
)  # a body that was lost moved on by more when it is seen again
MAX_BURST_PERIOD_RATIO, MIN_BURST_GAP_RATIO = (
    0.2,
    1.5,
)  # of the usual period: stamps of messages that waited for each other


def flag_poses(t, xyz, quat):
    """What is wrong with each pose of one body in log order ("" = nothing), (n,) of str."""
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
        fine = np.flatnonzero(out == "")
        if len(fine) > 2:
            out[fine[rule(t[fine], xyz[fine], quat[fine])]] = name
    return out


def flag_single_poses(xyz, quat):
    """What is wrong with each pose of one body whatever its time, (n,) of str."""
    out = np.full(len(xyz), "", dtype=object)
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(quat, axis=1)
    out[np.abs(norm - 1) > MAX_QUAT_NORM_ERROR] = "quaternion not unit"
    # A body at the origin all the time is a choice of frames; one that drops there was lost.
    lost = (xyz == 0).all(1) & ((quat == 0).all(1) | (np.abs(quat) == [0, 0, 0, 1]).all(1))
    out[lost & ~lost.all()] = "zeros"
    out[(np.abs(xyz) > MAX_POSITION_M).any(1)] = "out of range"
    out[~(np.isfinite(xyz).all(1) & np.isfinite(quat).all(1))] = "not a number"
    return out


def _find_bad_stamps(t):
    """Stamps (n,) that are no later than one before; or that run ahead, as time goes on from the
    one before as if they had not been."""
    ahead = np.zeros(len(t), bool)
    ahead[1:-1] = (t[1:-1] > t[2:]) & (t[2:] > t[:-2])
    least = np.iinfo(np.int64).min
    newest = np.maximum.accumulate(np.concatenate([[least], np.where(ahead, least, t)[:-1]]))
    return ahead | (t <= newest)


def _step_sizes(xyz, quat, first, second):
    """Distances, m, and angles, rad, between poses by their numbers."""
    turn = np.abs((quat[first] * quat[second]).sum(-1))
    length = np.linalg.norm(quat[first], axis=-1) * np.linalg.norm(quat[second], axis=-1)
    angle = 2 * np.arccos(np.minimum(turn / length, 1.0))
    return np.linalg.norm(xyz[second] - xyz[first], axis=-1), angle


def _find_frozen(t, xyz, quat):
    """Poses that repeat the one before to the last digit while the body moved on: it is elsewhere
    as soon as it is seen again. One that repeats because nothing moves is right as it is."""
    same = (np.diff(np.column_stack([xyz, quat]), axis=0) == 0).all(1)
    edges = np.diff(np.concatenate([[False], same, [False]]).astype(int))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    long = (ends - starts >= MIN_FROZEN_REPEATS) & (t[ends] - t[starts] >= MIN_FROZEN_NS)
    runs = list(zip(starts[long].tolist(), ends[long].tolist(), strict=True))
    lost = [r for r in runs if r[1] < len(t) - 1 and _has_moved_after_freeze(xyz, quat, *r)]
    # Of a body that is not seen again, only its last steps tell whether it came to rest.
    last = runs[-1] if runs else (0, 0)
    if last[1] == len(t) - 1 and t[last[1]] - t[last[0]] >= MIN_END_FREEZE_NS:
        lost += [last] if _is_moving_before_freeze(xyz, quat, last[0]) else []
    out = np.zeros(len(t), bool)
    for first, end in lost:
        out[first + 1 : end + 1] = True
    return out


def _has_moved_after_freeze(xyz, quat, first, last):
    """Whether the pose after a run of equal ones is further off than bodies were going."""
    far, turned = _step_sizes(xyz, quat, last, last + 1)
    near = [(first - 1, first)] if first else []
    near += [(last + 1, last + 2)] if last + 2 < len(xyz) else []
    around = np.array([_step_sizes(xyz, quat, *pair) for pair in near]).reshape(-1, 2)
    most = around.max(0, initial=0.0)
    return far > max(MIN_UNFREEZE_STEP_M, 3 * most[0]) or turned > max(
        MIN_UNFREEZE_STEP_RAD, 3 * most[1]
    )


def _is_moving_before_freeze(xyz, quat, last):
    """Whether a body, or its noise, was no slower in the step to a pose than in those before."""
    if last < N_STEPS_BEFORE_FREEZE:
        return False
    before = np.arange(last - N_STEPS_BEFORE_FREEZE, last)
    far, turned = _step_sizes(xyz, quat, before, before + 1)
    return far[-1] > np.median(far) / 2 or turned[-1] > np.median(turned) / 2


def _find_bursts(t, xyz, quat):
    """Poses stamped late, as they waited for the last of their burst, which alone came in time."""
    step = np.diff(t)
    usual = np.median(step)
    close = np.append(step < MAX_BURST_PERIOD_RATIO * usual, False)
    out, waited = np.zeros(len(t), bool), False
    for i in np.flatnonzero(close).tolist():
        after_gap = i > 0 and step[i - 1] > MIN_BURST_GAP_RATIO * usual
        waited = after_gap or (waited and i > 0 and close[i - 1])
        out[i] = waited
    return out


def exceeds_speed(t, xyz, quat):
    """Whether no body can have got from each pose to the next, (n - 1,)."""
    moved, turned = _step_sizes(xyz, quat, slice(None, -1), slice(1, None))
    seconds = np.diff(t) / NS_PER_S
    return (moved > JUMP_MARGIN_M + MAX_BODY_SPEED_MPS * seconds) | (
        turned > JUMP_MARGIN_RAD + MAX_BODY_TURN_RADPS * seconds
    )


def _find_jumps(t, xyz, quat):
    """Poses of the parts of a track that no body can have got to: another's under its name, or a
    wrong fit of the markers. Of each stretch without a gap the place with the most poses holds."""
    jump = exceeds_speed(t, xyz, quat)
    out = np.zeros(len(t), bool)
    apart = np.flatnonzero(np.diff(t) > MAX_TRACK_GAP_NS) + 1
    for stretch in np.split(np.arange(len(t)), apart):
        cuts = np.flatnonzero(jump[stretch[:-1]]) + 1
        if len(cuts):
            parts = np.split(stretch, cuts)
            place = _number_locations(parts, xyz, quat)
            poses = np.bincount(place, [len(p) for p in parts])
            for part, where in zip(parts, place, strict=True):
                out[part] = where != poses.argmax()
    return out


def _number_locations(track_parts, xyz, quat):
    """A number for each part of a track, the same where one goes on from where the other was; only
    the PLACES seen last are looked at."""
    place, ends = [], {}  # place -> number of its last pose, the one seen last at the end
    for part in track_parts:
        first, number = part[0], len(place)
        if ends:
            steps = _combined_distance(xyz, quat, np.array(list(ends.values())), first)
            nearest = list(ends)[int(steps.argmin())]
            if steps.min() < _combined_distance(xyz, quat, first - 1, first) / 2:
                number = nearest
        ends.pop(number, None)
        ends[number] = part[-1]
        if len(ends) > MAX_JUMP_LOCATIONS:
            del ends[next(iter(ends))]
        place.append(number)
    return place


def _combined_distance(xyz, quat, first, second):
    """How far poses are from another, a metre like a radian."""
    return np.add(*_step_sizes(xyz, quat, first, second))
