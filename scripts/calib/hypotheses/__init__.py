"""What may be wrong about targets and sensors though nobody estimates it, one Hypothesis each.

A hypothesis has a few numbers θ that are zero if all is as configured. Its derivative says how the
standardised residuals of a group change with θ. To add one: write a function that yields Hypothesis
objects of a Setup and add it to SOURCES.
"""

from calib.hypotheses import of_sensors, of_targets
from calib.hypotheses.base import View

__all__ = ["View", "all_of"]
SOURCES = (
    of_targets.squares,
    of_targets.outlines,
    of_targets.cylinders,
    of_targets.frames,
    of_sensors.lenses,
    of_sensors.ranges,
    of_sensors.beams,
    of_sensors.widths,
)


def all_of(setup):
    """Every Hypothesis of a Setup, in a fixed order."""
    return [h for source in SOURCES for h in source(setup)]
