"""What may be wrong about targets and sensors though nobody estimates it, one Hypothesis each.

A hypothesis has a few numbers θ that are zero if all is as configured. Its derivative says how the
standardised residuals of a group change with θ. To add one: write a function that yields Hypothesis
objects of a Setup and add it to SOURCES. One that states how a sensor's model is mended may be
estimated along with the poses (refinement.py).
"""

from calib.estimation.corrections.sensor_errors import (
    make_beam_corrections,
    make_beam_width_corrections,
    make_lens_corrections,
    make_outline_twist_corrections,
    make_range_corrections,
)
from calib.estimation.corrections.session_shifts import make_bump_corrections, make_slip_corrections
from calib.estimation.corrections.target_errors import (
    make_cylinder_corrections,
    make_mount_corrections,
    make_outline_corrections,
    make_square_corrections,
)

CORRECTION_SOURCES = (
    make_square_corrections,
    make_outline_corrections,
    make_cylinder_corrections,
    make_mount_corrections,
    make_lens_corrections,
    make_range_corrections,
    make_beam_corrections,
    make_beam_width_corrections,
    make_outline_twist_corrections,
)
SESSION_SHIFT_SOURCES = (make_slip_corrections, make_bump_corrections)


def list_testable_corrections(setup):
    """Every Hypothesis of a Setup that it does not estimate already, in a fixed order; without
    those of what moved within a session, which have numbers enough to explain much of anything."""
    known = {(h.name, h.subject) for h in setup.corrections}
    found = [h for source in CORRECTION_SOURCES for h in source(setup)]
    return [h for h in found if (h.name, h.subject) not in known]


def list_corrections_and_shifts(setup):
    """Those of all_of, and what may have moved within a session."""
    return [
        *list_testable_corrections(setup),
        *(h for source in SESSION_SHIFT_SOURCES for h in source(setup)),
    ]
