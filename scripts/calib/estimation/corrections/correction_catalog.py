"""What may be wrong about targets and sensors though nobody estimates it, one Hypothesis each.

A hypothesis has a few numbers θ that are zero if all is as configured. Its derivative says how the
standardised residuals of a group change with θ. To add one: write a function that yields Hypothesis
objects of a Setup and add it to SOURCES. One that states how a sensor's model is mended may be
estimated along with the poses (refinement.py).
"""

from calib.estimation.corrections import sensor_errors, session_shifts, target_errors

SOURCES = (
    target_errors.squares,
    target_errors.outlines,
    target_errors.cylinders,
    target_errors.frames,
    sensor_errors.lenses,
    sensor_errors.ranges,
    sensor_errors.beams,
    sensor_errors.widths,
    sensor_errors.disagreements,
)
MOVES = (session_shifts.slips, session_shifts.bumps)


def all_of(setup):
    """Every Hypothesis of a Setup that it does not estimate already, in a fixed order; without
    those of what moved within a session, which have numbers enough to explain much of anything."""
    known = {(h.name, h.of) for h in setup.corrections}
    found = [h for source in SOURCES for h in source(setup)]
    return [h for h in found if (h.name, h.of) not in known]


def with_moves(setup):
    """Those of all_of, and what may have moved within a session."""
    return [*all_of(setup), *(h for source in MOVES for h in source(setup))]
