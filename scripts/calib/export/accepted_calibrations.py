"""The history of a rig: one numbered file for each accepted calibration, history/0007.json.

A file holds {"previous": name of the file before it or null, "calibration": as calibration.json}.
The order follows `previous`, so files that earlier versions named after their content are read too.
"""

import json
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calib.io.atomic_files import write_file
from calib.io.config import MAX_ABS_NUMBER
from calib.io.safe_names import plain_text
from calib.io.status import InputError

# A number, or the 16 hexadecimal digits that earlier versions used.
ENTRY_NAME_PATTERN = re.compile(r"\d{4,8}|[0-9a-f]{16}")
MAX_ENTRY_BYTES = 1 << 26  # calibration.json of 64 sensors takes about 2 MB
POSE_BLOCK_SHAPES = {"xyz_m": (3,), "quat_xyzw": (4,), "matrix": (4, 4)}
ENTRY_KEYS = {"previous", "calibration"}


class AcceptedCalibration(NamedTuple):
    """An accepted calibration: the name of its file without .json, and its calibration.json."""

    name: str
    calibration: dict[str, Any]


class HistoryFileError(Exception):
    """What is wrong with one file of a history, in words."""


def accept_calibration(folder: Path, calibration: dict[str, Any]) -> str:
    """Add a calibration to the history in a folder; returns the name of its file without .json.

    Writes nothing if the newest one is the same. Raises InputError if the history is damaged.
    """
    history = read_accepted_calibrations(folder)
    if history and history[-1].calibration == calibration:
        return history[-1].name
    numbers = [int(entry.name) for entry in history if len(entry.name) < 16]
    name = f"{max(numbers, default=0) + 1:04d}"
    content = {"previous": history[-1].name if history else None, "calibration": calibration}
    text = json.dumps(content, indent=1, sort_keys=True, allow_nan=False) + "\n"
    write_file(Path(folder) / f"{name}.json", text)
    return name


def read_earlier_calibrations(
    folder: Path, calibration: dict[str, Any]
) -> list[AcceptedCalibration]:
    """Read what was accepted before a calibration, the oldest first.

    The result does not depend on whether the calibration itself is accepted already.
    """
    history = read_accepted_calibrations(folder)
    if history and history[-1].calibration == calibration:
        return history[:-1]
    return history


def read_accepted_calibrations(folder: Path) -> list[AcceptedCalibration]:
    """Read the history in a folder, the oldest first.

    Raises InputError that lists every file that is damaged, foreign or missing.
    """
    entries, problems = {}, []
    for path in sorted(Path(folder).glob("[!.]*.json")):
        try:
            entries[path.stem] = _read_entry(path)
        except HistoryFileError as error:
            problems.append(f"{plain_text(path.name)} {error}")
    names, order_problems = _order_entries(entries)
    if problems or order_problems:
        raise InputError(
            f"{folder}: {'; '.join(problems or order_problems)}. Put the right file back, or move "
            "this folder away to start a new history"
        )
    return [AcceptedCalibration(name, entries[name]["calibration"]) for name in names]


def _read_entry(path: Path) -> dict[str, Any]:
    """Read one file; raises HistoryFileError if it is not one of a history."""
    if not ENTRY_NAME_PATTERN.fullmatch(path.stem):
        raise HistoryFileError("does not belong here: expected names such as 0001.json")
    try:
        if path.stat().st_size > MAX_ENTRY_BYTES:
            raise HistoryFileError(f"has more than {MAX_ENTRY_BYTES} bytes")
        entry = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise HistoryFileError(f"cannot be read ({plain_text(str(error))})") from error
    if not isinstance(entry, dict) or set(entry) != ENTRY_KEYS:
        raise HistoryFileError("is no accepted calibration: expected {previous, calibration}")
    if not isinstance(entry["previous"], str | None):
        raise HistoryFileError(
            f"follows {plain_text(repr(entry['previous']))}, expected a name or null"
        )
    calibration = entry["calibration"]
    if not isinstance(calibration, dict) or not isinstance(calibration.get("sensors"), dict):
        raise HistoryFileError("holds no calibration with sensors")
    for name, sensor in calibration["sensors"].items():
        _require_sensor(plain_text(name), sensor)
    return entry


def _require_sensor(name: str, sensor: Any) -> None:
    """Raise HistoryFileError unless an accepted sensor has a pose and a covariance, or neither."""
    if sensor == {}:
        return
    if not isinstance(sensor, dict) or not {"T_robot_sensor", "covariance"} <= set(sensor):
        raise HistoryFileError(f"holds no pose and covariance of {name}")
    pose, covariance = sensor["T_robot_sensor"], sensor["covariance"]
    if pose is None:
        return
    if not isinstance(pose, dict) or not set(POSE_BLOCK_SHAPES) <= set(pose):
        raise HistoryFileError(f"holds no pose of {name}: expected {', '.join(POSE_BLOCK_SHAPES)}")
    for key, shape in POSE_BLOCK_SHAPES.items():
        _require_numbers(f"{key} of {name}", pose[key], shape)
    _require_numbers(f"covariance of {name}", covariance, (6, 6))
    if np.linalg.eigvalsh(covariance)[0] <= 0:
        raise HistoryFileError(f"holds a covariance of {name} that is not positive")


def _require_numbers(what: str, value: Any, shape: tuple[int, ...]) -> None:
    """Raise HistoryFileError unless a value is an array of finite numbers of a shape."""
    try:
        numbers = np.array(value, float)
    except (TypeError, ValueError, OverflowError):
        numbers = np.zeros(0)
    if numbers.shape != shape or not (np.abs(numbers) < MAX_ABS_NUMBER).all():
        expected = " x ".join(map(str, shape))
        raise HistoryFileError(f"holds {what} of a wrong shape, expected {expected} finite numbers")


def _order_entries(entries: dict[str, dict[str, Any]]) -> tuple[list[str], list[str]]:
    """Order the names of entries from the oldest to the newest; returns (names, problems)."""
    problems = [
        f"{name}.json follows {entry['previous']}.json, which is missing"
        for name, entry in entries.items()
        if entry["previous"] is not None and entry["previous"] not in entries
    ]
    followers: dict[str | None, list[str]] = {}
    for name, entry in entries.items():
        followers.setdefault(entry["previous"], []).append(name)
    for previous, names in followers.items():
        if len(names) > 1:
            files = " and ".join(f"{name}.json" for name in names)
            problems.append(f"{files} both follow {previous or 'no file'}: expected one of them")
    ordered: list[str] = []
    while following := followers.get(ordered[-1] if ordered else None):
        ordered.append(following[0])
    if not problems and len(ordered) < len(entries):
        loose = sorted(set(entries) - set(ordered))
        problems.append(f"{', '.join(f'{name}.json' for name in loose)} follow each other")
    return ordered, problems
