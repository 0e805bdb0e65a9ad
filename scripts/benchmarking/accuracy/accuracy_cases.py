"""The rows of the accuracy table: log, sensor, target, published errors and goal of each.

An error is (mm, deg): the norm of the translation error and the geodesic angle of the rotation
error. The paper is Charron, Waslander and Narasimhan, tables I to III. The errors of its C++ code
were measured with the published version on similar logs, from ten initial guesses with errors up
to ±3 cm and ±5° per axis.
"""

from dataclasses import dataclass, field
from typing import Any

# By method: what a target's config contains in addition to shape and size.
METHOD_CONFIGS: dict[str, dict[str, Any]] = {
    "surface": {"method": "surface"},
    "points": {"method": "points", "points": {"keypoints": "all"}},
    "points, corners": {"method": "points", "points": {"keypoints": "corners"}},
}
DEFAULT_METHOD = "surface"  # the only method with goals
RANGE_NOISE_M = 0.008
LOG_ARGUMENTS = {  # arguments of simulate.py by kind of log
    "round": "--rig round --targets board,cylinder",
    "corners": "--targets board --image-noise 1.8",
    "limbs": "--targets cylinder --image-noise 1.8",
    "noisy": f"--rig round --targets board,cylinder --range-noise-m {RANGE_NOISE_M}"
    " --mcs-noise-m 0.00015 --mcs-noise-deg 0.02",
}
GUESS_ARGUMENTS = "--guess-error-m 0.03 --guess-error-deg 5"
MAX_RMS_RATIO = 1.15  # goal: RMS error of many draws over the reference accuracy
MAX_SINGLE_RATIO = 2.0  # error of one draw over the reference accuracy
COVERAGE_GOAL = (0.93, 0.97)  # share of the 95 % ellipsoids that contain the truth
# Arguments of simulate.py for the small logs that run through the whole pipeline.
FULL_RUN_ARGUMENTS = (
    f"--targets board --placements 5 --hold-s 0.8 --range-noise-m {RANGE_NOISE_M} --image-noise 1.8"
    " --blur-px 0.7 --mcs-noise-m 0.00015 --mcs-noise-deg 0.02"
)


@dataclass(frozen=True, eq=False)
class AccuracyRow:
    """One row of the table, measured at every number of placements.

    goals, paper_errors: (mm, deg) by number of placements; goals None: MAX_RMS_RATIO times the
    reference accuracy. cpp_errors: the same by method. source_row_key: row whose noise-free
    recordings get the noise of this row; default its own.
    """

    key: str
    title: str
    log_kind: str
    sensor: str
    target: str
    placement_counts: tuple[int, ...]
    methods: tuple[str, ...]
    goals: dict[int, tuple[float, float]] | None
    paper_errors: dict[int, tuple[float, float]] = field(default_factory=dict)
    cpp_errors: dict[str, dict[int, tuple[float, float]]] = field(default_factory=dict)
    source_row_key: str = ""

    @property
    def is_noise_free(self) -> bool:
        """Whether the sensor data have no noise."""
        return self.log_kind == "round"

    @property
    def is_camera(self) -> bool:
        """Whether the sensor is a camera; drawing images takes longer than drawing scans."""
        return self.sensor == "camera"

    def count_draws(self, n_placements: int, max_draws: int) -> int:
        """Return the number of noise draws at n_placements.

        max_draws for lidars; fewer for cameras if a draw needs many images.
        """
        return (
            -(-max_draws * self.placement_counts[-1] // n_placements)
            if self.is_camera
            else max_draws
        )


EXACT_GOALS = {n: (0.001, 0.0001) for n in (30, 15, 5)}
ACCURACY_ROWS = (
    AccuracyRow(
        key="diamond-lidar",
        title="diamond, lidar, no range noise",
        log_kind="round",
        sensor="velodyne",
        target="board",
        placement_counts=(30, 15, 5),
        methods=("surface", "points", "points, corners"),
        goals=EXACT_GOALS,
        paper_errors={30: (0.1, 0.0018), 15: (0.1, 0.0024), 5: (0.3, 0.0038)},
        cpp_errors={
            "points": {30: (0.52, 0.036), 15: (0.48, 0.044), 5: (0.57, 0.072)},
            "points, corners": {30: (3.5, 0.55), 15: (4.6, 0.57), 5: (5.0, 0.60)},
        },
    ),
    AccuracyRow(
        key="cylinder-lidar",
        title="cylinder, lidar, no range noise",
        log_kind="round",
        sensor="velodyne",
        target="cylinder",
        placement_counts=(30, 15, 5),
        methods=("surface", "points"),
        goals=EXACT_GOALS,
        paper_errors={30: (4.6, 0.047), 15: (7.4, 0.1), 5: (88, 1.6)},
        cpp_errors={"points": {30: (0.44, 0.036), 15: (0.42, 0.043), 5: (1.23, 0.051)}},
    ),
    AccuracyRow(
        key="diamond-camera",
        title="diamond, camera, image noise 1.8",
        log_kind="corners",
        sensor="camera",
        target="board",
        placement_counts=(30, 15, 5),
        methods=("surface",),
        goals={30: (0.004, 0.0001), 15: (0.006, 0.0002), 5: (0.01, 0.0003)},
        paper_errors={30: (0.11, 0.035), 15: (0.07, 0.035), 5: (0.14, 0.034)},
        cpp_errors={"surface": {30: (0.004, 0.0001), 15: (0.005, 0.0002), 5: (0.007, 0.0002)}},
    ),
    AccuracyRow(
        key="cylinder-camera",
        title="cylinder, camera, image noise 1.8",
        log_kind="limbs",
        sensor="camera",
        target="cylinder",
        placement_counts=(10, 5),
        methods=("surface", "points"),
        goals={10: (0.3, 0.005), 5: (0.6, 0.012)},
    ),
    AccuracyRow(
        key="diamond-lidar-noisy",
        title="diamond, lidar, 8 mm range noise, MCS noise 0.15 mm 0.02°",
        log_kind="noisy",
        sensor="velodyne",
        target="board",
        placement_counts=(30, 15, 5),
        methods=("surface", "points", "points, corners"),
        goals=None,
        source_row_key="diamond-lidar",
        cpp_errors={
            "points": {30: (0.41, 0.034), 15: (0.38, 0.044), 5: (1.0, 0.067)},
            "points, corners": {30: (4.7, 0.68), 15: (5.9, 0.70), 5: (6.5, 0.75)},
        },
    ),
    AccuracyRow(
        key="cylinder-lidar-noisy",
        title="cylinder, lidar, 8 mm range noise, MCS noise 0.15 mm 0.02°",
        log_kind="noisy",
        sensor="velodyne",
        target="cylinder",
        placement_counts=(30, 15, 5),
        methods=("surface", "points"),
        goals=None,
        source_row_key="cylinder-lidar",
        cpp_errors={"points": {30: (0.76, 0.040), 15: (0.59, 0.039), 5: (2.5, 0.093)}},
    ),
)
UNMEASURED_GOALS = (
    "MCS stamps 25 ms late, target frame off by 6 mm and 1°: estimated, not yet measured here",
)


@dataclass(frozen=True)
class AccuracyCase:
    """One calibration: a row of the table, by one method, from one log."""

    row: AccuracyRow
    method: str
    n_placements: int
    seed: int

    @property
    def case_name(self) -> str:
        """Name of the rig and of the session."""
        method = self.method.replace(", ", "-")
        return f"{self.row.key}-{method}-n{self.n_placements}-s{self.seed}"

    @property
    def log_key(self) -> tuple[str, int, int]:
        """Kind (key of LOG_ARGUMENTS), number of placements and seed of the log."""
        return self.row.log_kind, self.n_placements, self.seed

    @property
    def target_name(self) -> str:
        """Name of the target's config; all methods have the same target body."""
        return "-".join([self.row.target, *self.method.split(", ")])


def list_accuracy_cases(is_quick: bool) -> list[AccuracyCase]:
    """Return all cases; if is_quick, only those with the fewest placements of every row."""
    return [
        AccuracyCase(row, method, n, 1)
        for row in ACCURACY_ROWS
        for n in (row.placement_counts[-1:] if is_quick else row.placement_counts)
        for method in row.methods
    ]


def find_draw_source(row: AccuracyRow, n_placements: int) -> AccuracyCase | None:
    """Return the case whose recording gets the noise draws of a row, None if it has no noise."""
    if row.is_noise_free:
        return None
    key = row.source_row_key or row.key
    return AccuracyCase(
        next(r for r in ACCURACY_ROWS if r.key == key), DEFAULT_METHOD, n_placements, 1
    )
