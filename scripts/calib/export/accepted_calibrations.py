"""Calibrations of a rig that were accepted, in the order in which they were.

An entry is one file, named after its content: {"previous": name or null, "calibration": as in
calibration.json}. Each names the one before it, so that their order needs no clock, a file is
never written twice, and what is accepted again without a change adds nothing.
"""

import hashlib
import json
from pathlib import Path

from calib.io.atomic_files import write_file
from calib.io.status import InputError

N_HASH_DIGITS = 16  # of the SHA-256 in a name


def accept_calibration(folder, calibration):
    """Add a calibration to the history in a folder, unless the newest is the same; its name."""
    known = read_accepted_calibrations(folder)
    if known and known[-1][1] == calibration:
        return known[-1][0]
    content = {"previous": known[-1][0] if known else None, "calibration": calibration}
    text = json.dumps(content, indent=1, sort_keys=True, allow_nan=False) + "\n"
    name = _hash_content(text.encode())
    write_file(Path(folder) / f"{name}.json", text)
    return name


def read_earlier_calibrations(folder, calibration):
    """[(name, calibration)] that were accepted before a calibration, the oldest first: whether or
    not that has been accepted itself by now."""
    known = read_accepted_calibrations(folder)
    return known[:-1] if known and known[-1][1] == calibration else known


def read_accepted_calibrations(folder):
    """[(name, calibration)] of the history in a folder, the oldest first; where it forks, the
    longest line, then the first by name.

    Raises InputError for an entry that is not what it was named after, or whose forerunner is gone.
    """
    entries = {path.stem: _read_entry(path) for path in sorted(Path(folder).glob("*.json"))}
    lines = [
        _trace_back_names(name, entries, folder)
        for name in sorted(set(entries) - _previous_names(entries))
    ]
    names = max(lines, key=len, default=[])
    return [(name, entries[name]["calibration"]) for name in names]


def _previous_names(entries):
    return {entry["previous"] for entry in entries.values()}


def _trace_back_names(name, entries, folder):
    """Names from the oldest to this one."""
    names = [name]
    while (previous := entries[names[-1]]["previous"]) is not None:
        if previous not in entries:
            raise InputError(
                f"{folder}/{names[-1]}.json follows {previous}.json, which is gone; put it back, "
                "or remove the folder to begin the history anew"
            )
        names.append(previous)
    return names[::-1]


def _read_entry(path):
    """An entry, if it is what its name says."""
    content = path.read_bytes()
    if _hash_content(content) != path.stem:
        raise InputError(
            f"{path} is not as it was written: its content gives {_hash_content(content)}; put it back, or "
            "remove the folder to begin the history anew"
        )
    return json.loads(content)


def _hash_content(content):
    return hashlib.sha256(content).hexdigest()[:N_HASH_DIGITS]
