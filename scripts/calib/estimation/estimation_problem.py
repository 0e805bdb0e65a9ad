"""Input of the estimation: placements, groups of keypoints, and the order of the unknowns."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from calib.mocap.moving_pose_fit import MovingView
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel

if TYPE_CHECKING:  # corrections are defined in terms of a Setup
    from calib.estimation.corrections.base import EstimableCorrection

SensorModel = CameraModel | LidarModel


class SlowNoise(NamedTuple):
    """Slow noise of motion capture in a placement: of the robot's pose, then of the body's.

    sigma: (2, 6) that it leaves in the mean poses; time_s: (2, 6) time constants; duration_s: of
    the placement.
    """

    sigma: np.ndarray
    time_s: np.ndarray
    duration_s: float


@dataclass(frozen=True)
class Placement:
    """A target at rest relative to the robot, or one view of a target in motion.

    T_robot_body: (4, 4) mean of the measured poses, or at the time of the view; mocap_sigma: (6,)
    σ of the error of the body's pose, of a moving view of the part that all moving views share;
    robot_mocap_sigma: the same of the robot's pose, None if equal; robot_rest: number of the
    robot's rest in the session. Targets that rest at the same time share it, and the error of the
    robot's pose. None: shared with no other. moving_view: None for a target at rest. start_ns,
    end_ns: of the rest. slow_noise: None where motion capture has none.
    """

    session: str
    target: str
    T_robot_body: np.ndarray
    T_body_target: np.ndarray
    mocap_sigma: np.ndarray
    robot_rest: int | None = None
    moving_view: MovingView | None = None
    start_ns: int = 0
    end_ns: int = 0
    robot_mocap_sigma: np.ndarray | None = None
    slow_noise: SlowNoise | None = None


@dataclass(frozen=True)
class MeasurementGroup:
    """Keypoints of one kind by one sensor in one placement or moving view.

    placement: index into Setup.placements; keypoints: columns of keypoints.parquet;
    initial_features: (n,) features that stage associate assigned, -1 for none; None: solve assigns
    them itself.
    """

    sensor: str
    placement: int
    kind: str
    keypoints: dict[str, np.ndarray] = field(repr=False)
    is_moving: bool = False
    initial_features: np.ndarray | None = field(default=None, repr=False)


@dataclass(frozen=True)
class Setup:
    """The estimation problem.

    models: by sensor; targets: shapes by name; placements: those at rest before moving views;
    associate_options: block `associate` of the config; sensor_priors: (T (4, 4), sigma (6,)) of
    sensors whose pose is known beforehand; initial_mounts: T_body_target (4, 4) of the targets
    whose mount is estimated; mount_sigma: σ (6,) of the configured mounts, where stated;
    corrections: estimated beside the poses, values θ; estimable_intrinsics: how many parameters of
    a camera can be estimated, or why none; log_starts_ns: when the log of a session starts, of the
    sessions that are not parts of a cut one: from_s, to_s and remounted_at_s count from there.

    The unknowns, in order: twists of the sensors and of the estimated mounts, each by name; errors
    of the motion capture poses, in units of their σ: of the robot per rest, of the body per
    placement, then one per session of the robot and of each body in motion; θ in units of the σ of
    its priors. The error that belongs to one moving view alone is eliminated (see Factor).
    """

    models: dict[str, SensorModel]
    targets: dict[str, Any]
    placements: list[Placement]
    groups: list[MeasurementGroup]
    associate_options: dict[str, Any]
    sensor_priors: dict[str, tuple[np.ndarray, np.ndarray]]
    initial_mounts: dict[str, np.ndarray] = field(default_factory=dict)
    mount_sigma: dict[str, np.ndarray] = field(default_factory=dict)
    corrections: tuple["EstimableCorrection", ...] = ()
    estimable_intrinsics: dict[str, int | str] = field(default_factory=dict)
    log_starts_ns: dict[str, int] = field(default_factory=dict)

    @cached_property
    def robot_error_index(self) -> np.ndarray:
        """Index (k,) of the robot's motion capture error of every placement."""
        return self._mocap_error_index[0]

    @cached_property
    def body_error_index(self) -> np.ndarray:
        """Index (k,) of the body's motion capture error of every placement."""
        return self._mocap_error_index[1]

    @cached_property
    def _mocap_error_index(self) -> tuple[np.ndarray, np.ndarray]:
        still, moving = self.placements[: self.n_still], self.placements[self.n_still :]
        rests = [
            (p.session, -1 - i if p.robot_rest is None else p.robot_rest)
            for i, p in enumerate(still)
        ]
        robots = _number_keys(rests)
        bodies = robots.max(initial=-1) + 1 + np.arange(len(still))
        first = len(bodies) + robots.max(initial=-1) + 1
        moving_robots = first + _number_keys([p.session for p in moving])
        first = moving_robots.max(initial=first - 1) + 1
        moving_bodies = first + _number_keys([(p.session, p.target) for p in moving])
        return np.concatenate([robots, moving_robots]), np.concatenate([bodies, moving_bodies])

    @cached_property
    def mocap_sigma(self) -> np.ndarray:
        """σ (r, 6) of the errors of the motion capture poses."""
        sigma = np.reshape([p.mocap_sigma for p in self.placements], (-1, 6))
        robot_sigma = np.reshape(
            [
                p.mocap_sigma if p.robot_mocap_sigma is None else p.robot_mocap_sigma
                for p in self.placements
            ],
            (-1, 6),
        )
        last = max(self.body_error_index.max(initial=-1), self.robot_error_index.max(initial=-1))
        out = np.zeros((last + 1, 6))
        np.maximum.at(out, self.robot_error_index, robot_sigma)
        np.maximum.at(out, self.body_error_index, sigma)
        return out

    @cached_property
    def n_still(self) -> int:
        """Number of placements that are not moving views."""
        return sum(p.moving_view is None for p in self.placements)

    @property
    def n_pose_unknowns(self) -> int:
        """Number of unknowns of sensors and mounts; index of the first motion capture error."""
        return 6 * (len(self.models) + len(self.initial_mounts))

    @property
    def n_chain_unknowns(self) -> int:
        """Number of unknowns of the pose chains: all but θ."""
        return self.n_pose_unknowns + self.mocap_sigma.size

    @property
    def n_unknowns(self) -> int:
        """Number of all unknowns."""
        return self.n_chain_unknowns + sum(c.n_values for c in self.corrections)

    @cached_property
    def correction_sigma(self) -> np.ndarray:
        """σ (p,) of the priors of θ."""
        return np.concatenate([np.zeros(0), *(c.prior_sigma for c in self.corrections)])

    def correction_index(self, group: MeasurementGroup) -> np.ndarray:
        """Index (q,) into θ of the values that the residuals of a group may depend on."""
        parts = [
            np.arange(self.n_unknowns)[part]
            for correction, part in self.correction_slices
            if correction.affects(self, group)
        ]
        return np.concatenate([np.zeros(0, int), *parts])

    @cached_property
    def correction_slices(self) -> list[tuple["EstimableCorrection", slice]]:
        """The corrections, each with its slice of θ."""
        ends = np.cumsum([0] + [c.n_values for c in self.corrections]).tolist()
        slices = [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
        return list(zip(self.corrections, slices, strict=True))

    def at_placements(self, indices: Sequence[int]) -> "Setup":
        """Return the Setup of some placements, by index, and of the sensors that see them.

        Corrections of what is left out are left out too.
        """
        new_index = {k: i for i, k in enumerate(indices)}
        placements = [self.placements[k] for k in indices]
        groups = [
            replace(g, placement=new_index[g.placement])
            for g in self.groups
            if g.placement in new_index
        ]
        sensors, targets = {g.sensor for g in groups}, {p.target for p in placements}
        subjects = sensors | targets | {p.session for p in placements}
        return replace(
            self,
            models={n: m for n, m in self.models.items() if n in sensors},
            placements=placements,
            groups=groups,
            initial_mounts={n: T for n, T in self.initial_mounts.items() if n in targets},
            corrections=tuple(c for c in self.corrections if c.subject in subjects),
        )

    def correction_slice(self, name: str, subject: str) -> slice | None:
        """Return the slice of θ of a correction, or None if it is not estimated."""
        for correction, part in self.correction_slices:
            if (correction.name, correction.subject) == (name, subject):
                return part
        return None


def _number_keys(keys: Sequence[Any]) -> np.ndarray:
    """Number keys (k,) from 0 in sorted order; equal keys get equal numbers."""
    numbers = {key: i for i, key in enumerate(sorted(set(keys)))}
    return np.array([numbers[key] for key in keys], int)
