"""The lens that CameraInfo tells of a camera, in all sessions of a rig."""

from collections.abc import Mapping
from typing import Any

from calib.io.status import Status, failure_status
from calib.sensors.sensor_models import with_log_metadata


def with_lens_from_log(sensors, guesses):
    """Sensor blocks by name, completed by the lens of the first of their guess.json that has one;
    guesses: (name, guess) of every sensor and session."""
    out = dict(sensors)
    for name, guess in guesses:
        if "params" not in out[name]:
            out[name] = with_log_metadata(out[name], guess)
    return out


def find_lens_mismatches(
    guesses_by_session: Mapping[str, Mapping[str, dict[str, Any]]],
) -> dict[str, Status]:
    """Return a failed Status for each camera whose CameraInfo differs between sessions.

    guesses_by_session: guess.json by sensor, by session.
    """
    lenses: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for session, guesses in sorted(guesses_by_session.items()):
        for name, guess in sorted(guesses.items()):
            if guess["camera"]:
                lenses.setdefault(name, []).append((session, guess["camera"]))
    out = {}
    for name, ((session, lens), *others) in lenses.items():
        other = next((o for o in others if o[1] != lens), None)
        if other:
            out[name] = _lens_mismatch_status(name, (session, lens), other)
    return out


def _lens_mismatch_status(name, *lenses):
    words = [f"{c['model']} {' '.join(f'{p:g}' for p in c['params'])} in {s}" for s, c in lenses]
    return failure_status(
        f"CameraInfo of {name} differs between sessions",
        " and ".join(words),
        "one lens",
        "Give the camera another name in a rig of its own for each lens, or write params.",
    )
