"""Printed patterns.

A pattern is one module with a frozen dataclass that has
  from_config(config)     from the `pattern` block of a target;
  corners()               (n, 3), m, target frame;
  detect(grey)            (n, 2) pixels of all corners in the detector's own order, or None: quick,
                          to about a third of a pixel;
  locate(grey, camera, offset)   (Corners, Status): thorough, checked, each corner with its error;
  labellings()            (m, n) every way in which the detector's order can stand for corners;
  expected                in words, what a detection must find;
  share                   of its corners that must be in an image;
  scaled(factor)          the pattern so much larger about its own middle.

To add a pattern: write calib/targets/patterns/<kind>.py and add it to PATTERNS.
"""

from calib.targets.patterns.charuco import Charuco
from calib.targets.patterns.checkerboard import Checkerboard

TARGET_PATTERNS = {"checkerboard": Checkerboard, "charuco": Charuco}


def pattern_from_config(config):
    """The pattern of a target's `pattern` block."""
    return TARGET_PATTERNS[config["kind"]].from_config(config)
