"""The lens of a camera from CameraInfo, in all sessions of a rig."""

from collections.abc import Iterable, Mapping
from typing import Any

from calib.io.status import Status, failure_status
from calib.sensors.sensor_models import with_log_metadata


def with_lens_from_log(
    sensors: Mapping[str, dict[str, Any]], guesses: Iterable[tuple[str, dict[str, Any]]]
) -> dict[str, dict[str, Any]]:
    """Return the sensor blocks by name, completed by the first lens in their guess.json.

    guesses: name and guess.json of every sensor and session.
    """
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


def _lens_mismatch_status(name: str, *lenses: tuple[str, dict[str, Any]]) -> Status:
    """Return the status of a camera with different lenses, by session."""
    texts = [f"{c['model']} {' '.join(f'{p:g}' for p in c['params'])} in {s}" for s, c in lenses]
    return failure_status(
        f"CameraInfo of {name} differs between sessions",
        " and ".join(texts),
        "one lens",
        "Use one rig with a camera name of its own for each lens, or write params.",
    )
