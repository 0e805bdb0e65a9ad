"""What stands in export/, which way each transform goes, and what could not be written and why."""

from calib.export.formats.format_registry import FORMATS
from calib.io.urdf_file import urdf_backup_path

README_FILE_NAME = "README.md"


def render_export_readme(scene, status_by_format, verdict, joints_by_urdf):
    """The text. status_by_format: {format: {file: Status}}; joints_by_urdf: {URDF: ({child link: T_parent_child},
    {sensor: Status of why it is not among them})}."""
    lines = [f"# Calibration of {scene.rig}", "", f"Verdict: {verdict['verdict']}."]
    lines += [
        *_format_items(verdict["reasons"]),
        "",
        f"The parent frame is `{scene.parent_frame}`.",
    ]
    lines += [
        *_format_items(scene.notes),
        "",
        "One point of every sensor, and where the parent has it:",
    ]
    lines += ["", *_format_items(scene.describe_worked_points())]
    for name, files in status_by_format.items():
        module = FORMATS[name]
        lines += ["", f"## {name}", "", f"What: {module.TITLE}.", "", f"How: {module.CONVENTION}."]
        lines += [
            "",
            *_format_items(_describe_file(file, status) for file, status in files.items()),
        ]
    for path, (placed, unplaced) in joints_by_urdf.items():
        lines += ["", f"## {path}", "", f"These joints hold it; {_describe_backup(path)}.", ""]
        lines += _format_items(f"the joint above link `{link}`" for link in sorted(placed))
        lines += _format_items(
            f"not for {name}: {status}" for name, status in sorted(unplaced.items())
        )
    return "\n".join(lines) + "\n"


def _format_items(texts):
    return [f"- {' '.join(str(text).split())}" for text in texts]


def _describe_file(name, status):
    return f"`{name}`" if status.ok else f"not written: {name}: {status}"


def _describe_backup(path):
    return f"the file as it was before the first calibration is `{urdf_backup_path(path).name}`"
