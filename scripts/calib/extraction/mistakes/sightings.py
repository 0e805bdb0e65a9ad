"""The pose of a sensor that its own detections agree on, under a stated setup.

Detections are made in whole images and scans, one per placement, so they do not depend on any
stated pose. A kind of sensor is one class that follows the protocol Sightings, and one line in
SIGHTINGS.
"""

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple, Protocol

import numpy as np

from calib.extraction.mistakes.stated_setup import StatedSetup
from calib.geometry.se3 import invert_pose, mean_pose, transform_points
from calib.initial_guess.camera_from_blobs import (
    MAX_BLOB_MISFIT,
    BlobView,
    blob_misfit,
    count_required_blobs,
    find_best_blob_pose,
    fit_blob_pose,
)
from calib.initial_guess.camera_from_patterns import solve_pattern_poses
from calib.initial_guess.candidate_matches import CandidateMatches, make_match
from calib.initial_guess.lidar_candidates import ShapeSignature, find_candidates, thin_scan
from calib.initial_guess.lidar_matching import match_pose, refine_match_pose
from calib.initial_guess.pose_voting import PoseTolerance, is_decisive, vote_for_pose
from calib.sensors.camera.camera_model import CameraModel
from calib.targets.target_shapes import TargetShape
from calib.views.initial_guess_frames import FrameSample

# Median misfit of blobs at a stated pose, in sizes of a blob, beyond which no fit starts there.
MAX_START_MISFIT = 3.0


class Consensus(NamedTuple):
    """A pose T_robot_sensor (4, 4) that detections agree on, None if they do not.

    n_agreeing: placements that agree, of n_found with a detection; scatter: (6,) rms of the single
    poses about it, m and rad.
    """

    T_robot_sensor: np.ndarray | None
    n_agreeing: int
    n_found: int
    scatter: np.ndarray


class Sightings(Protocol):
    """What one sensor saw of the targets in a session.

    description: what is detected, in words; min_share: of the placements with a detection that must
    agree.
    """

    description: str
    min_share: float

    def agree(self, setup: StatedSetup, /) -> Consensus:
        """Return the pose that the detections agree on, if the setup is right."""


class CameraSightings:
    """Printed patterns in whole images; each of them gives a pose alone."""

    description = "the pattern"
    min_share = 0.7

    def __init__(self, samples: list[FrameSample], options: dict[str, Any]) -> None:
        self._samples, self._tolerance = samples, PoseTolerance.from_options(options)
        self._detect = cache(self._detect_corners)
        self._solve = cache(self._solve_poses)

    def agree(self, setup: StatedSetup) -> Consensus:
        poses, group = [], []
        for i, sample in enumerate(self._samples):
            T_robot_target = setup.T_robot_body[sample.placement] @ setup.mounts[sample.target]
            target = setup.targets[sample.target]
            image = _Image(setup.images[i], setup.is_mirrored)
            for T in self._solve(image, _Pattern(target), setup.model):
                poses.append(T_robot_target @ invert_pose(T))
                group.append(i)
        n_found = len(set(group))
        if not poses:
            return Consensus(None, 0, 0, np.zeros(6))
        T = np.stack(poses)
        vote = vote_for_pose(T, np.array(group), self._tolerance)
        if len(vote.rows) < 2 or not is_decisive(len(vote.rows), vote.n_rival_votes):
            return Consensus(None, len(vote.rows), n_found, np.zeros(6))
        mean, xi = mean_pose(T[vote.rows])
        return Consensus(mean, len(vote.rows), n_found, np.sqrt((xi**2).mean(0)))

    @staticmethod
    def _detect_corners(image: "_Image", pattern: Any) -> np.ndarray | None:
        return pattern.detect_corners_fast(image.pixels())

    def _solve_poses(
        self, image: "_Image", pattern: "_Pattern", camera: CameraModel
    ) -> list[np.ndarray]:
        kind: Any = pattern.target.pattern
        uv = self._detect(image, kind)
        return [] if uv is None else solve_pattern_poses(camera, pattern.target, uv)


class BlobSightings:
    """Coloured bodies in whole images.

    They are compared near the stated pose; without one, a pose that fits most of them is searched.
    """

    description = "the coloured body"
    min_share = 0.7

    def __init__(self, blobs: list[BlobView], options: dict[str, Any]) -> None:
        self._blobs, self._n_required = blobs, count_required_blobs(options)

    def agree(self, setup: StatedSetup) -> Consensus:
        blobs, camera = [self._with_setup(blob, setup) for blob in self._blobs], setup.model
        nothing = Consensus(None, 0, len(blobs), np.zeros(6))
        if not isinstance(camera, CameraModel) or len(blobs) < self._n_required:
            return nothing
        T = setup.T_robot_sensor
        if T is None:
            T = find_best_blob_pose(camera, setup.targets, blobs).T_robot_camera
        elif np.median(self._misfit(setup, blobs, T)) > MAX_START_MISFIT:
            return nothing
        if T is None:
            return nothing
        fit = fit_blob_pose(camera, setup.targets, blobs, T)
        n = int((self._misfit(setup, blobs, fit.T_robot_camera) < MAX_BLOB_MISFIT).sum())
        return Consensus(fit.T_robot_camera, n, len(blobs), fit.sigma * np.sqrt(max(n, 1)))

    @staticmethod
    def _with_setup(blob: BlobView, setup: StatedSetup) -> BlobView:
        """Return a blob with the pose of its target, and mirrored if the images are."""
        sample, features = blob
        T = setup.T_robot_body[sample.placement] @ setup.mounts[sample.target]
        if setup.is_mirrored:
            u, v, uu, uv, vv = features
            features = np.array([setup.images[0].shape[1] - 1 - u, v, uu, -uv, vv])
        return BlobView(replace(sample, T_robot_target=T), features)

    @staticmethod
    def _misfit(setup: StatedSetup, blobs: list[BlobView], T: np.ndarray) -> np.ndarray:
        assert isinstance(setup.model, CameraModel)
        return np.abs(blob_misfit(setup.model, setup.targets, blobs, T)).max(1)


class _Image:
    """An image, or its mirror image; equal if it is the same array."""

    def __init__(self, grey: np.ndarray, is_mirrored: bool) -> None:
        self._grey, self._key = grey, (id(grey), is_mirrored)

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Image) and self._key == other._key

    def pixels(self) -> np.ndarray:
        """Return the image (h, w) uint8 as it is taken."""
        return np.ascontiguousarray(self._grey[:, ::-1]) if self._key[1] else self._grey


class _Pattern:
    """A target with a pattern; equal by the pattern."""

    def __init__(self, target: TargetShape) -> None:
        self.target = target

    def __hash__(self) -> int:
        return hash(self.target.pattern)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Pattern) and self.target.pattern == other.target.pattern


class LidarSightings:
    """Things like the targets in whole scans.

    They are compared near the stated pose; without one, a pose that fits most of them is searched.
    """

    description = "a thing like the target"
    min_share = 0.5

    def __init__(
        self,
        samples: list[FrameSample],
        scans: list[np.ndarray],
        setup: StatedSetup,
        options: dict[str, Any],
    ) -> None:
        self._samples, self._options = samples, options
        self._tolerance = PoseTolerance.from_options(options)
        self._signatures = {n: ShapeSignature.from_target(t) for n, t in setup.targets.items()}
        lidar: Any = setup.model
        self._candidates = [
            find_candidates(
                lidar,
                setup.targets[sample.target],
                self._signatures[sample.target],
                thin_scan(lidar, xyz),
                options,
            )
            for sample, xyz in zip(samples, scans, strict=True)
        ]

    def agree(self, setup: StatedSetup) -> Consensus:
        matches, T, reach = self.match(setup), setup.T_robot_sensor, self._reach(setup)
        n_found = len(np.unique(matches.placement))
        if T is None and n_found:
            found = match_pose(matches, len(self._samples), self.description, self._options)
            T, reach = found.value, self._tolerance
        if T is None or n_found == 0:
            return Consensus(None, 0, n_found, np.zeros(6))
        refined = refine_match_pose(matches, T, reach)
        rows = refined.rows
        if len(rows) < 2:
            return Consensus(None, len(rows), n_found, np.zeros(6))
        shift = transform_points(refined.T_robot_sensor, matches.centre[rows])
        spread = np.sqrt(np.mean((shift - matches.target_centre[rows]) ** 2))
        scatter = np.append(np.full(3, spread), np.full(3, self._tolerance.turn_rad / 3))
        return Consensus(refined.T_robot_sensor, len(rows), n_found, scatter)

    def match(self, setup: StatedSetup) -> CandidateMatches:
        """Return every candidate as the target of its placement."""
        rows = [
            make_match(
                candidate,
                self._signatures[sample.target],
                setup.T_robot_body[sample.placement] @ setup.mounts[sample.target],
                number,
            )
            for number, sample in enumerate(self._samples)
            for candidate in self._candidates[number]
        ]
        return CandidateMatches.from_rows(rows)

    def _reach(self, setup: StatedSetup) -> PoseTolerance:
        """Return how far a candidate may be from its target at the stated pose."""
        shift, turn = 3 * setup.sigma[:3].max(), 3 * setup.sigma[3:].max()
        # A turn of the sensor moves what it sees some metres away.
        reach = PoseTolerance(shift + 2 * turn, turn + self._tolerance.turn_rad)
        return PoseTolerance(*np.maximum(reach, self._tolerance))
