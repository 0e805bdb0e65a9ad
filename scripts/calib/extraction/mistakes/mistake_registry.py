"""The registry of mistakes of convention.

To add a mistake: write calib/extraction/mistakes/<name>.py with a function that follows the
protocol Mistake, and add one line to MISTAKES. Of mistakes that explain the data alike the first
one is named.
"""

from calib.extraction.mistakes.inverted_pose import correct_inverted_poses
from calib.extraction.mistakes.lens_resolution import correct_lens_resolution
from calib.extraction.mistakes.lost_signs import correct_lost_signs
from calib.extraction.mistakes.mirrored_picture import correct_mirrored_pictures
from calib.extraction.mistakes.pattern_layout import correct_pattern_layout
from calib.extraction.mistakes.pattern_size import correct_pattern_size
from calib.extraction.mistakes.quaternion_order import correct_quaternion_order
from calib.extraction.mistakes.stated_setup import Mistake
from calib.extraction.mistakes.swapped_axes import correct_swapped_axes

MISTAKES: tuple[Mistake, ...] = (
    correct_pattern_layout,
    correct_mirrored_pictures,
    correct_inverted_poses,
    correct_swapped_axes,
    correct_quaternion_order,
    correct_lens_resolution,
    correct_lost_signs,
    correct_pattern_size,
)
