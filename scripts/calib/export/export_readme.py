"""README.md of the export folder: files, conventions, and what is not written and why."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from calib.export.calibrated_scene import ExportScene
from calib.export.formats.format_registry import FORMATS
from calib.io.status import Status, escape_control_characters
from calib.io.urdf.sensor_joints import SensorJoints
from calib.io.urdf.urdf_file import urdf_backup_path

README_FILE_NAME = "README.md"
MARKDOWN_PATTERN = re.compile(r"[\\<\[*&]")


def render_export_readme(
    scene: ExportScene,
    status_by_format: Mapping[str, Mapping[str, Status]],
    verdict: dict[str, Any],
    joints_by_urdf: Mapping[Path, SensorJoints],
) -> str:
    """Render the text; status_by_format says of each format and file whether it is written."""
    lines = [f"# Calibration of {scene.rig}", "", f"Verdict: {verdict['verdict']}."]
    lines += _format_items(verdict["reasons"])
    lines += ["", f"The parent frame is `{scene.parent_frame}`."]
    lines += _format_items(scene.notes)
    lines += ["", "One point of every sensor, and the same point in the parent frame:", ""]
    lines += _format_items(scene.describe_worked_points())
    for name, files in status_by_format.items():
        lines += _describe_format(name, files)
    for path, joints in joints_by_urdf.items():
        lines += _describe_urdf(path, joints)
    return "\n".join(lines) + "\n"


def _describe_format(name: str, files: Mapping[str, Status]) -> list[str]:
    module = FORMATS[name]
    head = ["", f"## {name}", "", f"What: {module.TITLE}.", "", f"How: {module.CONVENTION}.", ""]
    return head + _format_items(
        f"`{file}`" if status.ok else f"not written: {file}: {status}"
        for file, status in files.items()
    )


def _describe_urdf(path: Path, joints: SensorJoints) -> list[str]:
    backup = urdf_backup_path(path).name
    head = ["", f"## {escape_markdown(str(path))}", ""]
    kept = escape_markdown(backup)
    head += [f"The calibration is in these joints. {kept} is the file before it.", ""]
    placed = [f"the joint above link `{link}`" for link in sorted(joints.origins)]
    unplaced = [f"not for {name}: {status}" for name, status in sorted(joints.unplaced.items())]
    return head + _format_items(placed + unplaced)


def _format_items(texts: Iterable[str]) -> list[str]:
    return [f"- {escape_markdown(' '.join(text.split()))}" for text in texts]


def escape_markdown(text: str) -> str:
    """Escape what Markdown reads as HTML, a link or emphasis; code in backticks stays code."""
    return MARKDOWN_PATTERN.sub(r"\\\g<0>", escape_control_characters(text))
