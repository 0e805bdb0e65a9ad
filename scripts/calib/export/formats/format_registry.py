"""List the export formats, and define what a format is.

Every file states its convention and one worked point. A format that cannot express something, such
as a camera model, gives a failed Status with the reason in place of the content.

To add a format: write calib/export/formats/<name>.py and add it to FORMATS;
tests/unit/export/test_formats.py then asks for a reader of it.
"""

from fnmatch import fnmatchcase
from typing import Protocol

from calib.export.calibrated_scene import ExportScene
from calib.export.formats import (
    autoware,
    foxglove,
    kalibr,
    koide3,
    mrcal,
    opencv,
    ros2_launch,
    ros2_static_transforms,
    ros_camera_info,
    tf_static,
    urdf,
    xacro,
)
from calib.io.status import Status


class ExportFormat(Protocol):
    """A module that writes one format."""

    TITLE: str
    """What the files are and who loads them."""
    FILE_PATTERNS: tuple[str, ...]
    """Names of the files (fnmatch), so that a later run may remove them."""
    CONVENTION: str
    """Which way the transforms go, in one line for README.md and the files."""

    def render_files(self, scene: ExportScene) -> dict[str, str | bytes | Status]:
        """Render the files by name; a Status says why a file, or a part of it, is missing."""
        ...


FORMATS: dict[str, ExportFormat] = {
    "ros2_static_transforms": ros2_static_transforms,
    "ros2_launch": ros2_launch,
    "urdf": urdf,
    "xacro": xacro,
    "tf_static": tf_static,
    "ros_camera_info": ros_camera_info,
    "opencv": opencv,
    "kalibr": kalibr,
    "mrcal": mrcal,
    "koide3": koide3,
    "autoware": autoware,
    "foxglove": foxglove,
}


def is_export_file(name: str) -> bool:
    """Return whether a format writes a file of this path, relative to the folder of exports."""
    return any(
        fnmatchcase(name, pattern) and name.count("/") == pattern.count("/")
        for export_format in FORMATS.values()
        for pattern in export_format.FILE_PATTERNS
    )
