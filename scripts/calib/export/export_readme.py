"""What stands in export/, which way each transform goes, and what could not be written and why."""

from calib.export.formats import format_registry
from calib.io import urdf_file

FILE = "README.md"


def render(scene, written, judged, mounted):
    """The text. written: {format: {file: Status}}; mounted: {URDF: ({child link: T_parent_child},
    {sensor: Status of why it is not among them})}."""
    lines = [f"# Calibration of {scene.rig}", "", f"Verdict: {judged['verdict']}."]
    lines += [*_items(judged["reasons"]), "", f"The parent frame is `{scene.parent}`."]
    lines += [*_items(scene.notes), "", "One point of every sensor, and where the parent has it:"]
    lines += ["", *_items(scene.worked())]
    for name, files in written.items():
        module = format_registry.FORMATS[name]
        lines += ["", f"## {name}", "", f"What: {module.TITLE}.", "", f"How: {module.CONVENTION}."]
        lines += ["", *_items(_file(file, status) for file, status in files.items())]
    for path, (placed, unplaced) in mounted.items():
        lines += ["", f"## {path}", "", f"These joints hold it; {_backup(path)}.", ""]
        lines += _items(f"the joint above link `{link}`" for link in sorted(placed))
        lines += _items(f"not for {name}: {status}" for name, status in sorted(unplaced.items()))
    return "\n".join(lines) + "\n"


def _items(texts):
    return [f"- {' '.join(str(text).split())}" for text in texts]


def _file(name, status):
    return f"`{name}`" if status.ok else f"not written: {name}: {status}"


def _backup(path):
    return f"the file as it was before the first calibration is `{urdf_file.backup_of(path).name}`"
