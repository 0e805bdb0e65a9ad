"""The lens that CameraInfo tells of a camera, in all sessions of a rig."""

import numpy as np

from calib.io.parquet_tables import select_rows
from calib.io.status import failure_status
from calib.sensors.sensor_models import with_log_metadata


def with_lens_from_log(sensors, guesses):
    """Sensor blocks by name, completed by the lens of the first of their guess.json that has one;
    guesses: (name, guess) of every sensor and session."""
    out = dict(sensors)
    for name, guess in guesses:
        if "params" not in out[name]:
            out[name] = with_log_metadata(out[name], guess)
    return out


def reject_lens_mismatches(sessions):
    """The sessions, name -> (pairs columns, notes, ...), in which a camera whose CameraInfo differs
    between them has failed and left no measurement."""
    for name, status in _find_lens_mismatches(sessions):
        for session, (pairs, notes, *rest) in sessions.items():
            if name in notes:
                pairs = select_rows(pairs, np.asarray(pairs["sensor"]) != name)
                notes = notes | {name: notes[name] | {"status": status.to_dict()}}
                sessions = sessions | {session: (pairs, notes, *rest)}
    return sessions


def _find_lens_mismatches(sessions):
    """(name, Status) of the cameras that have another lens in some session."""
    seen = {}
    for session, (_, notes, *_) in sorted(sessions.items()):
        for name, note in sorted(notes.items()):
            if note["guess"]["camera"]:
                seen.setdefault(name, []).append((session, note["guess"]["camera"]))
    for name, lenses in seen.items():
        (first, lens), *others = lenses
        other = next((o for o in others if o[1] != lens), None)
        if other:
            yield name, _lens_mismatch_status(name, (first, lens), other)


def _lens_mismatch_status(name, *lenses):
    words = [f"{c['model']} {' '.join(f'{p:g}' for p in c['params'])} in {s}" for s, c in lenses]
    return failure_status(
        f"CameraInfo of {name} differs between sessions",
        " and ".join(words),
        "one lens",
        "Give the camera another name in a rig of its own for each lens, or write params.",
    )
