"""A recording after decode and gate, and what stage guess can find in it."""

from dataclasses import dataclass
from typing import Any

from calib.initial_guess.sensor_guess import (
    SensorGuess,
    guess_sensor_pose,
    guess_time_offset,
    with_sensor_metadata,
)
from calib.initial_guess.session_search import SearchForecast
from calib.views.target_placements import Columns, PlacementTable


@dataclass(frozen=True)
class PreflightSession:
    """One recording after decode and gate.

    audit: log.json. frames, poses: columns of frames.parquet and mocap.parquet.
    has_remounted_markers: the robot's markers were re-attached before it. streams: its sensors.
    """

    audit: dict[str, Any]
    frames: Columns
    poses: Columns
    placements: PlacementTable
    has_remounted_markers: bool
    streams: tuple[str, ...]

    @property
    def mocap_notes(self) -> tuple[str, ...]:
        """Return the notes on the noise of motion capture at rest."""
        return self.placements.mocap_notes


def forecast_guess(session: PreflightSession, name: str, options: dict[str, Any]) -> SensorGuess:
    """Return the guess of a sensor by the rules of stage guess, with a forecast of its searches.

    options: of scripts/preflight.py. What the data may give has the source SOURCE_DATA and no
    meaningful value.
    """
    targets = {n: options["targets"][n] for n in sorted(session.placements.target_status)}
    cameras = {n: options["sensors"][n] for n in session.streams}
    guess_options = {
        "name": name,
        "sensor": options["sensors"][name],
        "remounted": session.has_remounted_markers,
        "targets": targets,
        "cameras": {n: block for n, block in cameras.items() if block["kind"] == "camera"},
        **{key: options[key] for key in ("body", "guess", "previous_poses")},
    }
    guess_options = with_sensor_metadata(guess_options, session.audit["sensors"])
    search = SearchForecast(
        log=None,
        frames=session.frames,
        placements=session.placements,
        poses=None,
        options=guess_options,
    )
    time_offset = guess_time_offset(guess_options, None)
    return guess_sensor_pose(guess_options, session.audit, search, time_offset)
