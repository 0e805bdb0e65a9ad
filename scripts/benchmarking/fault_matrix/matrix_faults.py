"""The faults of the matrix as data.

To add one: one entry in MATRIX_FAULTS. Its causes are patterns of the text and the remedy of the
finding that names it.
"""

from dataclasses import dataclass

from benchmarking.fault_matrix import config_mistakes as written
from benchmarking.fault_matrix import message_changes as recorded
from benchmarking.fault_matrix.config_mistakes import ConfigMistake
from benchmarking.fault_matrix.message_changes import MessageChange
from benchmarking.room_rigs import ROOM_NOISE

SINGLE_SESSION = (
    "--rig sim --placements 8 --hold-s 1.5 --move-s 0.7 --sector-deg 80 --camera-hz 2 "
    f"--encoding mono8 --seed 11 {ROOM_NOISE}"
)
TWO_SESSIONS = f"--rig demo --placements 6 --hold-s 1.5 --seed 11 {ROOM_NOISE}"
WIDE_LENS = "--distortion -0.13 0.02 0.0005 -0.0003"
SLIGHT_LENS = "--distortion -0.02 0.003 0.0002 -0.0001"


@dataclass(frozen=True)
class MatrixFault:
    """A fault at one size.

    name: of the fault; size: in words; arguments: of simulate.py, after the others; causes:
    patterns, one of which the finding that names it matches; change_messages, change_config: what
    else is wrong; recording: arguments of simulate.py of the clean recording.
    """

    name: str
    size: str
    causes: tuple[str, ...]
    arguments: str = ""
    change_messages: MessageChange | None = None
    change_config: ConfigMistake | None = None
    recording: str = SINGLE_SESSION

    @property
    def key(self) -> str:
        """Name of its folder and of its random numbers."""
        words = f"{self.name} {self.size}".translate(str.maketrans(",.%°±²×", "_______"))
        return "-".join(words.split())


def _simulate(
    name: str, causes: tuple[str, ...], sizes: dict[str, str], recording: str = SINGLE_SESSION
) -> list[MatrixFault]:
    """Return a fault of the simulator at several sizes: arguments by words."""
    return [MatrixFault(name, size, causes, a, recording=recording) for size, a in sizes.items()]


def _write(
    name: str, causes: tuple[str, ...], sizes: dict[str, ConfigMistake], arguments: str = ""
) -> list[MatrixFault]:
    """Return a fault of the config at several sizes: mistakes by words."""
    return [
        MatrixFault(name, size, causes, arguments, change_config=mistake)
        for size, mistake in sizes.items()
    ]


def _record(
    name: str, causes: tuple[str, ...], sizes: dict[str, MessageChange]
) -> list[MatrixFault]:
    """Return a fault of the messages at several sizes: changes by words."""
    return [MatrixFault(name, size, causes, change_messages=c) for size, c in sizes.items()]


SCALE = (r"motion capture's scale", r"distances of the motion capture")
SCATTER = (r"motion capture.*scatter", r"mocap\.pose_\w*sigma", r"mocap\.use_measured_noise")
CLOCK = (r"time offset", r"clock", r"time_offset_s")
STEP = (r"clock.*(step|jump)", r"(step|jump).*clock", r"stamp.*jump")
LENS = (r"distortion of camera", r"\bk1\b", r"lens of camera")
NOTHING: tuple[str, ...] = ()  # read as it is: nothing needs to be said

MATRIX_FAULTS: tuple[MatrixFault, ...] = (
    # Lidars
    *_simulate(
        "ranges to dark squares too long",
        (r"dark", r"ranges of velodyne depend on intensity"),
        {"5 mm": "--dark-range-m 0.005", "15 mm": "--dark-range-m 0.015"},
    ),
    *_simulate(
        "ranges of single beams biased",
        (r"beams? of velodyne", r"ranges of .*beam", r"beam"),
        {"5 mm": "--beam-bias-m 0.005", "15 mm": "--beam-bias-m 0.015"},
    ),
    *_simulate(
        "wide beams mix returns at edges",
        (r"outline", r"beam"),
        {"0.1°": "--beam-divergence-deg 0.1", "0.3°": "--beam-divergence-deg 0.3"},
    ),
    # Targets
    *_simulate(
        "board bowed",
        (r"bow", r"not flat", r"bent"),
        {"2 mm": "--board-bow-x-m 0.002", "5 mm": "--board-bow-x-m 0.005"},
    ),
    *_simulate(
        "board twisted",
        (r"twist", r"not flat", r"bow"),
        {"2 mm": "--board-twist-m 0.002", "5 mm": "--board-twist-m 0.005"},
    ),
    *_write(
        "squares stated too large",
        (r"squares? of board",),
        {"0.5 %": written.scale_squares(1.005), "2.5 %": written.scale_squares(1.025)},
    ),
    *_simulate(
        "targets built larger than stated",
        (r"squares? of board", r"outline of board", r"larger than (stated|configured)"),
        {"0.4 %": "--target-scale 1.004", "2 %": "--target-scale 1.02"},
    ),
    *_write(
        "cylinder's radius stated too large",
        (r"radius of cylinder", r"cylinder.*radius", r"radius_m"),
        {"1 mm": written.change_radius(0.001), "4 mm": written.change_radius(0.004)},
    ),
    *(
        MatrixFault(
            "targets off their stated mounts",
            f"{mm} mm {deg}°",
            (r"T_body_target of", r"mount of"),
            f"--mount-m {mm / 1e3} --mount-deg {deg}",
            change_config=written.hide_mount_sigma,
        )
        for mm, deg in ((3, 0.5), (10, 1.5))
    ),
    *_record(
        "board's markers knocked",
        (r"board is shifted",),
        {
            "5 mm 0.3°": recorded.knock_body("mocap/board", 0.005, 0.3),
            "20 mm 1°": recorded.knock_body("mocap/board", 0.02, 1.0),
        },
    ),
    # Motion capture
    *_simulate(
        "robot's markers knocked",
        (r"robot's markers", r"markers of the robot"),
        {
            "5 mm 0.25°": "--knock-m 0.005 --knock-deg 0.25",
            "13 mm 0.6°": "--knock-m 0.013 --knock-deg 0.6",
        },
    ),
    *_simulate(
        "distances of motion capture too long",
        SCALE,
        {"0.2 %": "--mcs-scale-error 0.002", "0.6 %": "--mcs-scale-error 0.006"},
    ),
    *_simulate(
        "motion capture wanders more",
        SCATTER,
        {
            "× 3": "--mcs-wander-m 0.00045 --mcs-wander-deg 0.06 0.21 0.06",
            "× 6": "--mcs-wander-m 0.0009 --mcs-wander-deg 0.12 0.42 0.12",
        },
    ),
    *_write(
        "motion capture noisier than stated",
        SCATTER,
        {
            "a tenth": written.state_small_noise(2e-5, 0.004),
            "a hundredth": written.state_small_noise(2e-6, 0.0004),
        },
    ),
    *_simulate(
        "samples lost",
        NOTHING,
        {"10 %": "--mcs-dropout 0.1", "30 %": "--mcs-dropout 0.3"},
    ),
    # Clocks
    *_simulate(
        "stamps of motion capture late",
        CLOCK,
        {"25 ms": "--mcs-late-s 0.025", "200 ms": "--mcs-late-s 0.2"},
    ),
    *_simulate(
        "stamps of motion capture drift",
        CLOCK,
        {"200 ppm": "--mcs-drift-ppm 200", "1000 ppm": "--mcs-drift-ppm 1000"},
    ),
    *_record(
        "robot's clock stepped",
        STEP,
        {"0.1 s": recorded.step_clock(0.1), "0.4 s": recorded.step_clock(0.4)},
    ),
    # Lens
    *(
        MatrixFault(
            "lens distortion left out",
            size,
            LENS,
            arguments,
            change_config=written.leave_out_distortion,
        )
        for size, arguments in (("k1 -0.02", SLIGHT_LENS), ("k1 -0.13", WIDE_LENS))
    ),
    *_write(
        "focal length stated too long",
        (r"focal length of camera",),
        {"0.3 %": written.scale_focal_length(1.003), "1 %": written.scale_focal_length(1.01)},
    ),
    # Two sessions
    *(
        MatrixFault(
            "re-attached markers not stated",
            f"{mm} mm {deg}°",
            (r"remounted", r"robot's markers"),
            f"--remount-m {mm / 1e3} --remount-deg {deg}",
            change_config=written.hide_remount,
            recording=TWO_SESSIONS,
        )
        for mm, deg in ((3, 0.3), (15, 1))
    ),
    *_simulate(
        "sensor bumped between sessions",
        (r"^right_camera: its pose in session", r"right_camera is shifted on the robot"),
        {
            "4 mm 0.3°": "--bump-m 0.004 --bump-deg 0.3",
            "15 mm 1°": "--bump-m 0.015 --bump-deg 1",
        },
        TWO_SESSIONS,
    ),
    # Conventions
    *_write(
        "pose of a sensor inverted", (r"inverse",), {"camera": written.invert_sensor_pose("camera")}
    ),
    *_write("axes exchanged", (r"optical axes",), {"camera": written.exchange_axes("camera")}),
    *_write(
        "quaternion of a pose with w first",
        (r"w, x, y, z", r"wxyz"),
        {"velodyne": written.reorder_pose_quaternion("velodyne")},
    ),
    *_record(
        "quaternions of motion capture with w first",
        (r"w, x, y, z", r"wxyz"),
        {"all": recorded.change_transforms(recorded.reorder_quaternion)},
    ),
    *_record(
        "motion capture in millimetres",
        NOTHING,
        {"all": recorded.change_transforms(recorded.scale_to_millimetres)},
    ),
    *_record(
        "bodies named for each other",
        (r"each other", r"`body` of the target", r"exchanged"),
        {"board, cylinder": recorded.swap_bodies("mocap/board", "mocap/cylinder")},
    ),
    *_write(
        "rows and columns exchanged",
        (r"inner_corners", r"inner corners"),
        {"board": written.exchange_rows_and_columns},
    ),
    *_record("pictures mirrored", (r"mirror",), {"camera": recorded.mirror_pictures}),
    *_write(
        "lens of another resolution",
        (r"resolution", r"binning", r"half (the|as)", r"images? of .* px"),
        {"half": written.halve_lens_resolution},
    ),
)
