"""Ask the whole images and scans of a session which mistake in the config explains them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calib.extraction.mistakes.mistake_search import find_mistake, find_other_pattern
from calib.extraction.mistakes.sightings import (
    BlobSightings,
    CameraSightings,
    LidarSightings,
    Sightings,
)
from calib.extraction.mistakes.stated_setup import StatedSetup
from calib.geometry.se3 import mean_pose
from calib.initial_guess.camera_from_blobs import BlobView, read_blob
from calib.initial_guess.initial_guess import SOURCE_DATA
from calib.initial_guess.session_search import SessionSearch
from calib.io.status import Status
from calib.mocap.body_trajectory import target_trajectories
from calib.sensors.camera.images.image_messages import to_grey
from calib.sensors.sensor_models import sensor_model_from_config
from calib.targets.patterns.checkerboard import Checkerboard
from calib.targets.patterns.opencv_grids import find_grid_by_sectors
from calib.targets.target_shapes import TargetShape, target_from_config
from calib.views.initial_guess_frames import FrameSample, read_samples
from calib.views.sensor_croppers import FrameReader
from calib.views.target_placements import Columns, find_still_rows, mounts_from_guess

READ_AS_WXYZ = "quaternions read as w, x, y, z"  # note of calib.mocap.pose_conventions
MAX_POSES_AVERAGED = 50  # of a placement


def explain_lost_agreement(
    session: SessionSearch,
    target_names: list[str],
    *,
    guess_json: Mapping[str, Any],
    poses: Columns,
    mocap_notes: list[str],
) -> Status | None:
    """Return a status that names the mistake in the config that explains what the sensor saw.

    session: its options are those of extract, with the sensor completed by the log. target_names:
    those that the sensor does not agree with. poses: columns of mocap.parquet. mocap_notes: what
    decode inferred of the motion capture. None if no mistake of the registry explains it.
    """
    options = session.options
    mounts = mounts_from_guess(options["targets"], guess_json)
    targets = {n: target_from_config(options["targets"][n]) for n in target_names}
    if options["sensor"]["kind"] == "camera":
        targets = _select_visible_targets(targets)
        if not set(targets) & set(mounts):
            return _find_other_pattern(session, targets, guess_json)
    targets = {name: target for name, target in targets.items() if name in mounts}
    bodies = {name: np.eye(4) for name in targets}
    samples, read_frame = session.sample_frames(options["name"], options["sensor"], bodies)
    if not samples:
        return None
    stated = _state_setup(options, targets, mounts, guess_json, samples)
    stated = _with_other_quaternions(stated, session, poses, mocap_notes)
    stated, sightings = _SIGHTING_READERS[options["sensor"]["kind"]](
        stated, samples, read_frame, options["guess"]
    )
    return find_mistake(stated, sightings, options["guess"]["min_placements"])


def _select_visible_targets(targets: dict[str, TargetShape]) -> dict[str, TargetShape]:
    """Return the targets with a pattern; if none has one, those with a colour."""
    patterned = {name: target for name, target in targets.items() if target.pattern}
    return patterned or {name: target for name, target in targets.items() if target.color}


def _find_other_pattern(
    session: SessionSearch, targets: dict[str, TargetShape], guess_json: Mapping[str, Any]
) -> Status | None:
    """Return a status on the pattern that the images show, of targets whose mount is unknown."""
    options = session.options
    unmounted = {name: np.eye(4) for name in targets}
    samples, read_frame = session.sample_frames(options["name"], options["sensor"], unmounted)
    if not samples:
        return None
    stated = _state_setup(options, targets, unmounted, guess_json, samples)
    stated, _ = _read_camera(stated, samples, read_frame, options["guess"])
    return find_other_pattern(stated) if stated.images else None


def _state_setup(
    options: dict[str, Any],
    targets: dict[str, TargetShape],
    mounts: dict[str, np.ndarray],
    guess_json: Mapping[str, Any],
    samples: list[FrameSample],
) -> StatedSetup:
    """Return what the config states of the sensor and the targets it does not agree with."""
    is_stated = guess_json["T_robot_sensor"] and guess_json["source"] != SOURCE_DATA
    T = np.array(guess_json["T_robot_sensor"]["matrix"]) if is_stated else None
    return StatedSetup(
        sensor=options["name"],
        model=sensor_model_from_config(options["sensor"]),
        targets=targets,
        mounts={name: mounts[name] for name in targets},
        T_robot_body={sample.placement: sample.T_robot_target for sample in samples},
        T_robot_sensor=T,
        sigma=np.array(guess_json["sigma"]),
        has_camera_info="camera_info" in options["sensor"],
    )


def _with_other_quaternions(
    stated: StatedSetup, session: SessionSearch, poses: Columns, mocap_notes: list[str]
) -> StatedSetup:
    """Return the setup with T_robot_body by quaternions in the other order."""
    assert session.placements is not None
    options, placements = session.options, session.placements.columns
    was_rolled = options["quaternions"] == "wxyz" or any(
        note.startswith(READ_AS_WXYZ) for note in mocap_notes
    )
    rolled = poses | {"quat": np.roll(poses["quat"], 1 if was_rolled else -1, axis=1)}
    bodies = {name: options["targets"][name]["body"] for name in stated.targets}
    trajectories = target_trajectories(rolled, options["body"], bodies, options["max_gap_s"])
    other = {}
    for name, trajectory in trajectories.items():
        for k in set(find_still_rows(placements, name).tolist()) & set(stated.T_robot_body):
            span = placements["start_ns"][k], placements["end_ns"][k]
            first, last = np.searchsorted(trajectory.stamps_ns, span)
            inside = trajectory.poses[first:last]
            if len(inside):
                step = max(1, len(inside) // MAX_POSES_AVERAGED)
                other[k] = mean_pose(inside[::step])[0]
    if set(other) != set(stated.T_robot_body):
        return stated
    return replace(stated, other_quaternions=other, other_order="xyzw" if was_rolled else "wxyz")


def _read_camera(
    stated: StatedSetup,
    samples: list[FrameSample],
    read_frame: FrameReader,
    options: dict[str, Any],
) -> tuple[StatedSetup, Sightings]:
    """Read images that may show a pattern, one placement of each target after the other."""
    if not any(target.pattern for target in stated.targets.values()):
        return _read_blobs(stated, samples, read_frame, options)
    kept: list[FrameSample] = []
    images: list[np.ndarray] = []
    for sample, image in read_samples(_in_turn(samples), read_frame):
        grey = to_grey(image)
        is_alike = not images or grey.shape == images[0].shape
        if is_alike and _may_show_pattern(stated.targets[sample.target], grey):
            kept.append(sample)
            images.append(grey)
        if len(images) >= options["max_pattern_images"]:
            break
    return replace(stated, images=tuple(images)), CameraSightings(kept, options)


def _read_blobs(
    stated: StatedSetup,
    samples: list[FrameSample],
    read_frame: FrameReader,
    options: dict[str, Any],
) -> tuple[StatedSetup, Sightings]:
    """Read images that show a coloured body, one placement of each target after the other."""
    blobs: list[BlobView] = []
    images: list[np.ndarray] = []
    for sample, image in read_samples(_in_turn(samples), read_frame):
        color = stated.targets[sample.target].color
        features = None if color is None else read_blob(color, image)
        if features is not None and (not images or image.shape[:2] == images[0].shape):
            blobs.append(BlobView(sample, features))
            images.append(to_grey(image))
        if len(blobs) >= options["max_pattern_images"]:
            break
    return replace(stated, images=tuple(images)), BlobSightings(blobs, options)


def _in_turn(samples: list[FrameSample]) -> list[FrameSample]:
    """Return the samples in the order of their rank among those of their target."""
    ranks: dict[str, int] = {}
    keys = []
    for sample in samples:
        ranks[sample.target] = ranks.get(sample.target, -1) + 1
        keys.append(ranks[sample.target])
    return [samples[i] for i in np.argsort(keys, kind="stable")]


def _may_show_pattern(target: TargetShape, grey: np.ndarray) -> bool:
    """Return whether an image (h, w) shows any grid, for a checkerboard; markers may be unknown."""
    return not isinstance(target.pattern, Checkerboard) or find_grid_by_sectors(grey) is not None


def _read_lidar(
    stated: StatedSetup,
    samples: list[FrameSample],
    read_frame: FrameReader,
    options: dict[str, Any],
) -> tuple[StatedSetup, Sightings]:
    """Read a scan of every placement."""
    found = [(sample, scan.xyz.astype(float)) for sample, scan in read_samples(samples, read_frame)]
    kept, scans = [sample for sample, _ in found], [xyz for _, xyz in found]
    return stated, LidarSightings(kept, scans, stated, options)


_SIGHTING_READERS = {"camera": _read_camera, "lidar": _read_lidar}
