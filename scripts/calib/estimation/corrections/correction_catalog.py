"""List the possible errors of targets and sensors that a score test looks for.

To add one: write a subclass of TargetCorrection, SensorCorrection or ModelCorrection (base), a
function that yields its instances for a Setup, and add the function to CORRECTION_SOURCES. A
ModelCorrection can also be estimated with the poses (diagnosis.correction_selection).
"""

from collections.abc import Iterator
from typing import Protocol

from calib.estimation.corrections.base import TestableCorrection
from calib.estimation.corrections.board_shape import make_board_shape_corrections
from calib.estimation.corrections.camera.camera_intrinsics import make_lens_corrections
from calib.estimation.corrections.camera.lens_distortion import make_distortion_corrections
from calib.estimation.corrections.lidar.dark_ranges import make_dark_range_corrections
from calib.estimation.corrections.lidar.intensity_ranges import make_intensity_corrections
from calib.estimation.corrections.lidar.lidar_outline_errors import (
    make_beam_width_corrections,
    make_outline_twist_corrections,
)
from calib.estimation.corrections.lidar.lidar_range_errors import (
    make_beam_corrections,
    make_range_corrections,
)
from calib.estimation.corrections.mocap.knocked_markers import make_knock_corrections
from calib.estimation.corrections.mocap.mocap_scale import make_scale_corrections
from calib.estimation.corrections.slips_and_bumps import (
    make_bump_corrections,
    make_slip_corrections,
)
from calib.estimation.corrections.target_errors import (
    make_cylinder_corrections,
    make_mount_corrections,
    make_outline_corrections,
    make_square_corrections,
)
from calib.estimation.estimation_problem import Setup


class CorrectionSource(Protocol):
    """Yields corrections for the targets or sensors of a Setup, in a fixed order."""

    def __call__(self, setup: Setup) -> Iterator[TestableCorrection]: ...


CORRECTION_SOURCES: tuple[CorrectionSource, ...] = (
    make_square_corrections,
    make_outline_corrections,
    make_board_shape_corrections,
    make_cylinder_corrections,
    make_mount_corrections,
    make_scale_corrections,
    make_lens_corrections,
    make_distortion_corrections,
    make_range_corrections,
    make_beam_corrections,
    make_dark_range_corrections,
    make_intensity_corrections,
    make_beam_width_corrections,
    make_outline_twist_corrections,
)
SESSION_SHIFT_SOURCES: tuple[CorrectionSource, ...] = (
    make_slip_corrections,
    make_bump_corrections,
    make_knock_corrections,
)


def list_testable_corrections(setup: Setup) -> list[TestableCorrection]:
    """Return every correction that a Setup does not estimate already, in a fixed order.

    Shifts within a session are not among them: they have enough values to explain almost anything.
    """
    estimated = {(c.name, c.subject) for c in setup.corrections}
    corrections = [c for source in CORRECTION_SOURCES for c in source(setup)]
    return [c for c in corrections if (c.name, c.subject) not in estimated]


def list_corrections_and_shifts(setup: Setup) -> list[TestableCorrection]:
    """Return the testable corrections, and the possible shifts within a session."""
    shifts = [c for source in SESSION_SHIFT_SOURCES for c in source(setup)]
    return [*list_testable_corrections(setup), *shifts]
