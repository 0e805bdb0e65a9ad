"""Try the mistakes of the registry against what a sensor saw, and name the one that works."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.extraction.mistakes.mistake_registry import MISTAKES
from calib.extraction.mistakes.pattern_size import correct_pattern_size, describe_other_markers
from calib.extraction.mistakes.pose_corrections import describe_pose, written_pose
from calib.extraction.mistakes.sightings import Consensus, Sightings
from calib.extraction.mistakes.stated_setup import ConfigCorrection, StatedSetup
from calib.geometry.se3 import invert_pose, se3_log
from calib.geometry.units import DEG_PER_RAD
from calib.io.config_change import any_rig_change
from calib.io.status import Status, failure_status

# A setup is right if the pose that the detections agree on is the stated one within this many σ of
# the guess, as rms over its six components.
MAX_GUESS_DEVIATION = 2.0
# Corrections explain the data alike if their scatter and their distance from the guess differ less.
ALIKE_SCATTER_RATIO, ALIKE_SCATTER = 1.3, np.repeat([0.001, np.radians(0.1)], 3)
ALIKE_DEVIATION = 0.5


class Explanation(NamedTuple):
    """A correction that works, and how well: see Consensus; deviation: from the guess, in σ."""

    correction: ConfigCorrection
    consensus: Consensus
    deviation: float


def find_mistake(stated: StatedSetup, sightings: Sightings, min_placements: int) -> Status | None:
    """Return a status that names the mistake that explains what the sensor saw.

    None if the setup as stated explains it, or no mistake does and no other markers are seen. A
    setup explains it if at least min_placements, and the share `min_share` of those with a
    detection, agree on one pose, which is the stated one (MAX_GUESS_DEVIATION).
    """
    as_stated = _explain(ConfigCorrection(stated, "", ""), sightings, min_placements)
    if as_stated:
        return None
    corrections = (c for mistake in MISTAKES for c in mistake(stated))
    found = [_explain(c, sightings, min_placements) for c in corrections]
    best = choose_explanation([e for e in found if e is not None])
    if best is None:
        best = _explain_by_found_pose(stated, sightings, min_placements)
    if best is None:
        return describe_other_markers(stated)
    return _describe_explanation(best, sightings)


def find_other_pattern(stated: StatedSetup) -> Status | None:
    """Return a status that names the pattern that the images show in place of a stated one.

    For targets whose mount is unknown: without it no pose can confirm a correction.
    """
    for correction in correct_pattern_size(stated):
        return failure_status(
            correction.reason,
            f"that pattern in {len(stated.images)} images",
            "the pattern as the config states it",
            correction.remedy,
            correction.change,
        )
    return describe_other_markers(stated)


def _explain(
    correction: ConfigCorrection, sightings: Sightings, min_placements: int
) -> Explanation | None:
    """Return the explanation by a corrected setup, None if it does not explain what was seen."""
    if not correction.setup.has_image_size:
        return None
    consensus = sightings.agree(correction.setup)
    if consensus.T_robot_sensor is None or not _is_enough(consensus, sightings, min_placements):
        return None
    deviation = guess_deviation(correction.setup, consensus)
    return (
        Explanation(correction, consensus, deviation) if deviation < MAX_GUESS_DEVIATION else None
    )


def _is_enough(consensus: Consensus, sightings: Sightings, min_placements: int) -> bool:
    n_required = max(min_placements, sightings.min_share * consensus.n_found)
    return consensus.n_agreeing >= n_required


def guess_deviation(setup: StatedSetup, consensus: Consensus) -> float:
    """Return the rms by which the pose of a consensus differs from the guess, in σ of both.

    Zero without a stated pose.
    """
    if setup.T_robot_sensor is None:
        return 0.0
    assert consensus.T_robot_sensor is not None
    shift = se3_log(invert_pose(setup.T_robot_sensor) @ consensus.T_robot_sensor)
    sigma = np.hypot(setup.sigma, consensus.scatter / np.sqrt(consensus.n_agreeing))
    return float(np.sqrt(np.mean((shift / sigma) ** 2)))


def choose_explanation(found: list[Explanation]) -> Explanation | None:
    """Return the explanation with most placements, then least scatter, then nearest to the guess.

    Of those that are alike the first one counts.
    """
    if not found:
        return None
    most = max(e.consensus.n_agreeing for e in found)
    found = [e for e in found if e.consensus.n_agreeing == most]
    least = min(found, key=_scatter_size).consensus.scatter
    limit = ALIKE_SCATTER_RATIO * least + ALIKE_SCATTER
    found = [e for e in found if (e.consensus.scatter <= limit).all()]
    nearest = min(e.deviation for e in found)
    return next(e for e in found if e.deviation <= nearest + ALIKE_DEVIATION)


def _scatter_size(explanation: Explanation) -> float:
    return float(np.linalg.norm(explanation.consensus.scatter / ALIKE_SCATTER))


def _explain_by_found_pose(
    stated: StatedSetup, sightings: Sightings, min_placements: int
) -> Explanation | None:
    """Return the pose that the detections agree on with all else as stated, wherever it is."""
    if stated.T_robot_sensor is None:
        return None
    consensus = sightings.agree(replace(stated, T_robot_sensor=None))
    T = consensus.T_robot_sensor
    if T is None:
        return None
    if not _is_enough(consensus, sightings, min_placements):
        return None
    away = invert_pose(stated.T_robot_sensor) @ T
    angle = DEG_PER_RAD * np.linalg.norm(se3_log(away)[3:])
    distance = np.linalg.norm(T[:3, 3] - stated.T_robot_sensor[:3, 3])
    correction = ConfigCorrection(
        replace(stated, T_robot_sensor=T),
        f"T_robot_sensor of {stated.sensor} does not agree with what {stated.sensor} saw, but a "
        f"pose {distance:.2f} m and {angle:.0f} deg away does",
        f"Set sensors.{stated.sensor}.T_robot_sensor to {describe_pose(T)}, or leave it out: it is "
        "then found in the data.",
        any_rig_change(f"sensors.{stated.sensor}.T_robot_sensor", written_pose(T)),
    )
    return Explanation(correction, consensus, 0.0)


def _describe_explanation(best: Explanation, sightings: Sightings) -> Status:
    _, n_agreeing, n_found, _ = best.consensus
    return failure_status(
        best.correction.reason,
        f"{sightings.description} agrees with that at {n_agreeing} of {n_found} placements",
        "the same of the config as it is written",
        best.correction.remedy,
        best.correction.change,
    )
