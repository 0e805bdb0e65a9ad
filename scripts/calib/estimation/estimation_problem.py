"""What an estimate is made from, and the order of its unknowns."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Placement:
    """A still target: mean T_robot_body (4, 4) and the σ (6,) of the two poses it came from; or, of
    a target in motion, what is known of one view of it (motion.Moving), T_robot_body there, and the
    σ (6,) of what its two poses err by in common with those of all other views in motion.

    rest: number of the robot's rest in the session; targets that are still at the same time share
    it, and with it the error of the robot's pose. None: nobody shares it. start, ns.
    """

    session: str
    target: str
    T_robot_body: np.ndarray
    T_body_target: np.ndarray
    mocap_sigma: np.ndarray
    robot_rest: int | None = None
    moving_view: object = None
    start_ns: int = 0


@dataclass(frozen=True)
class MeasurementGroup:
    """Keypoints (columns) of one kind by one sensor in one placement, or in one view of a target in
    motion."""

    sensor: str
    placement: int
    kind: str
    keypoints: dict = field(repr=False)
    is_moving: bool = False


@dataclass(frozen=True)
class Setup:
    """What is being estimated from: sensors and targets by name, placements, those in motion after
    all others, and groups of keypoints.

    models: name -> Camera or rig.Lidar; prior: name -> (T (4, 4), sigma (6,)), for a sensor
    whose pose is known beforehand; mounts: name -> T_body_target (4, 4) to start from, of the
    targets whose place in their body is estimated too; alignment: name -> σ (6,) of where it is
    said to be, for those that have a say; corrections: Hypothesis objects whose numbers θ are
    estimated; lenses: name -> how many parameters of a camera may be, or why they are not.

    The unknowns are twists of the sensors and of those mounts, by name, then the errors of the MCS
    poses of the robot at its rests and of the body in every placement, those of the robot and of
    the bodies in motion, one per session, then θ, all but twists in units of their σ. What a view
    in motion errs by alone is eliminated (parts.Part).
    """

    models: dict
    targets: dict
    placements: list
    groups: list
    associate_options: dict
    sensor_priors: dict
    initial_mounts: dict = field(default_factory=dict)
    mount_sigma: dict = field(default_factory=dict)
    corrections: tuple = ()
    estimable_intrinsics: dict = field(default_factory=dict)

    @cached_property
    def robot_error_index(self):
        """(k,) index, among the errors of MCS poses, of that of the robot in every placement."""
        return self._mocap_error_index[0]

    @cached_property
    def body_error_index(self):
        """(k,) likewise of the body."""
        return self._mocap_error_index[1]

    @cached_property
    def _mocap_error_index(self):
        still, moving = self.placements[: self.n_still], self.placements[self.n_still :]
        rests = [
            (p.session, -1 - i if p.robot_rest is None else p.robot_rest)
            for i, p in enumerate(still)
        ]
        robots = _index_keys(rests)
        bodies = robots.max(initial=-1) + 1 + np.arange(len(still))
        first = len(bodies) + robots.max(initial=-1) + 1
        robots_moving = first + _index_keys([p.session for p in moving])
        first = robots_moving.max(initial=first - 1) + 1
        bodies_moving = first + _index_keys([(p.session, p.target) for p in moving])
        return np.concatenate([robots, robots_moving]), np.concatenate([bodies, bodies_moving])

    @cached_property
    def mocap_sigma(self):
        """(r, 6) σ of the errors of MCS poses."""
        own = np.reshape([p.mocap_sigma for p in self.placements], (-1, 6))
        out = np.zeros(
            (
                max(self.body_error_index.max(initial=-1), self.robot_error_index.max(initial=-1))
                + 1,
                6,
            )
        )
        np.maximum.at(out, self.robot_error_index, own)
        np.maximum.at(out, self.body_error_index, own)
        return out

    @cached_property
    def n_still(self):
        """How many of the placements are no views in motion."""
        return sum(p.moving_view is None for p in self.placements)

    @property
    def n_pose_unknowns(self):
        """Index of the first unknown of the MCS poses."""
        return 6 * (len(self.models) + len(self.initial_mounts))

    @property
    def n_chain_unknowns(self):
        """How many unknowns the chains of poses have: all but θ."""
        return self.n_pose_unknowns + self.mocap_sigma.size

    @property
    def n_unknowns(self):
        """How many unknowns there are."""
        return self.n_chain_unknowns + sum(h.n_values for h in self.corrections)

    @cached_property
    def correction_sigma(self):
        """(p,) σ of the priors of θ."""
        return np.concatenate([np.zeros(0), *(h.prior_sigma for h in self.corrections)])

    def correction_index(self, group):
        """Which of θ (q,) the residuals of a group may depend on."""
        own = [
            np.arange(self.n_unknowns)[at]
            for h, at in self.correction_slices
            if h.affects(self, group)
        ]
        return np.concatenate([np.zeros(0, int), *own])

    @cached_property
    def correction_slices(self):
        """[(Hypothesis, slice of θ)] of the corrections."""
        ends = np.cumsum([0] + [h.n_values for h in self.corrections]).tolist()
        slices = [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
        return list(zip(self.corrections, slices, strict=True))

    def correction_slice(self, name, subject):
        """The slice of θ of the correction of that name, or None where there is none."""
        return next(
            (at for h, at in self.correction_slices if (h.name, h.subject) == (name, subject)), None
        )


def _index_keys(keys):
    """(k,): equal keys by equal numbers, from 0 on, in order."""
    numbers = {key: i for i, key in enumerate(sorted(set(keys)))}
    return np.array([numbers[key] for key in keys], int)
