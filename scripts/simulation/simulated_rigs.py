"""Simulated rigs as data: sensors, sessions, and where the targets are held.

To add a rig: one entry in SIMULATED_RIGS.
"""

import argparse
from collections.abc import Sequence
from typing import Any, NamedTuple

from calib.sensors.camera.camera_model import CAMERA_MODELS
from simulation.sensors.scan_patterns import SCAN_PATTERNS, ScanPattern


class SimulatedLidar(NamedTuple):
    """A lidar: topic, nominal T_robot_sensor, names of its cloud format (CLOUD_FORMATS) and scan
    pattern (SCAN_PATTERNS), recorded azimuths (± about its x axis), and start of its first scan."""

    topic: str
    xyz_m: tuple[float, ...]
    rpy_deg: tuple[float, ...]
    cloud_format: str = "velodyne"
    pattern_name: str = "beams16"
    sector_deg: float = 100.0
    start_s: float = 0.003

    @property
    def scan_pattern(self) -> ScanPattern:
        return SCAN_PATTERNS[self.pattern_name]


class SimulatedCamera(NamedTuple):
    """A camera: topic of its raw images, nominal T_robot_sensor, model, encoding (IMAGE_ENCODERS
    for Image, COMPRESSED_ENCODINGS for CompressedImage), and time of its first image."""

    topic: str
    xyz_m: tuple[float, ...]
    rpy_deg: tuple[float, ...]
    model: str
    params: tuple[float, ...]
    size_px: tuple[int, int]
    encoding: str = "bgr8"
    rate_hz: float = 4.0
    start_s: float = 0.02

    @property
    def is_compressed(self) -> bool:
        return self.encoding in COMPRESSED_ENCODINGS


class TargetSpot(NamedTuple):
    """Where a target is held: azimuths to the left and elevations about the forward axis of a
    sensor, and distances from it; the sensors that must see it well."""

    sensor: str
    azimuth_deg: tuple[float, float]
    distance_m: tuple[float, float]
    visible_to: tuple[str, ...]
    elevation_deg: tuple[float, float] = (-4, 4)


PlacementLayout = dict[str, TargetSpot]  # by target


class SimulatedRig(NamedTuple):
    """Sensors by name, sessions, and layouts of placements, which take turns.

    single_target_spots: where a target is held that is the only one. default_arguments: those that
    differ from the defaults of simulate.py.
    """

    sensors: dict[str, SimulatedLidar | SimulatedCamera]
    session_names: tuple[str, ...]
    placement_layouts: tuple[PlacementLayout, ...]
    single_target_spots: dict[str, TargetSpot]
    default_arguments: dict[str, Any]


COMPRESSED_ENCODINGS = ("jpeg", "png")
# Of an image of 900 by 700 px.
PRINCIPAL_POINT_PX = (452.6, 347.9)
LENS_PARAMS: dict[str, tuple[float, ...]] = {
    "radtan": (802.3, 801.1, *PRINCIPAL_POINT_PX, 0.0, 0.0, 0.0, 0.0),
    "kannala_brandt": (561.2, 560.4, *PRINCIPAL_POINT_PX, -0.013, 0.021, -0.014, 0.003),
    "double_sphere": (562.4, 561.7, *PRINCIPAL_POINT_PX, -0.19, 0.57),
    "eucm": (641.2, 640.6, *PRINCIPAL_POINT_PX, 0.61, 1.12),
    "mei": (1482.3, 1480.9, *PRINCIPAL_POINT_PX, 1.15, -0.06, 0.02, 3e-4, -2e-4),
}
LIDAR_CHOICES = {  # of --lidar: cloud format and scan pattern
    "velodyne": ("velodyne", "beams16"),
    "ouster": ("ouster", "beams32"),
    "plain": ("plain", "beams16"),
    "livox": ("livox", "rosette"),
    "livox_custom": ("livox_custom", "rosette"),
    "velodyne_last": ("velodyne_last", "beams16"),
    "hesai": ("hesai", "beams32"),
    "robosense": ("robosense", "beams16"),
    "nebula": ("nebula", "beams32"),
    "nebula_legacy": ("nebula_legacy", "beams32"),
    "sick": ("sick", "beams16"),
    "sick_split": ("sick_split", "beams16"),
    "laserscan": ("laserscan", "flat"),
}
# Blocks of config.yaml: the demo must end within a minute.
CONFIG_BY_RIG: dict[str, dict[str, Any]] = {
    "demo": {
        "crop": {"max_frames": 4},
        "solve": {"tolerance_m": 1e-6, "tolerance_rad": 1e-6},  # a hundredth of its σ and less
        "report": {"max_overlays": 2},
    },
}
SIMULATED_RIGS: dict[str, SimulatedRig] = {
    "sim": SimulatedRig(
        sensors={
            "velodyne": SimulatedLidar("/velodyne_points", (0.15, 0.0, 0.60), (0.0, 0.0, 2.0)),
            "camera": SimulatedCamera(
                "/camera/image_raw", (0.25, -0.10, 0.45), (-90.0, 0.0, -90.0),
                "radtan", LENS_PARAMS["radtan"], (900, 700),
            ),
        },
        session_names=("sim",),
        placement_layouts=(
            {
                "board": TargetSpot("velodyne", (-12, 12), (1.4, 3.2), ("velodyne", "camera")),
                "cylinder": TargetSpot("velodyne", (25, 70), (1.4, 2.4), ("velodyne",)),
            },
        ),
        single_target_spots={
            "cylinder": TargetSpot("velodyne", (-18, 18), (1.4, 2.4), ("velodyne", "camera")),
        },
        default_arguments={},
    ),
    # A lidar alone, with the targets held all round it.
    "round": SimulatedRig(
        sensors={
            "velodyne": SimulatedLidar(
                "/velodyne_points", (0.15, 0.0, 0.60), (0.0, 0.0, 2.0), sector_deg=180.0
            ),
        },
        session_names=("round",),
        placement_layouts=(
            {
                "board": TargetSpot("velodyne", (-180, 180), (1.4, 2.6), ("velodyne",)),
                "cylinder": TargetSpot("velodyne", (-180, 180), (1.2, 2.4), ("velodyne",)),
            },
        ),
        single_target_spots={},
        default_arguments={},
    ),
    # Four fields of view that do not overlap, even with every mount at its worst. Images are taken
    # twice at each placement: 0.6 s divides the 1.8 s from one to the next.
    "demo": SimulatedRig(
        sensors={
            "front_lidar": SimulatedLidar(
                "/front/velodyne_points", (0.30, 0.0, 0.60), (0.0, 0.0, 0.0), sector_deg=38.0
            ),
            "rear_lidar": SimulatedLidar(
                "/rear/points", (-0.30, 0.0, 0.60), (0.0, 0.0, 180.0),
                "ouster", "beams32", sector_deg=38.0, start_s=0.041,
            ),
            "left_camera": SimulatedCamera(
                "/left/image_raw", (0.05, 0.20, 0.60), (-90.0, 0.0, 0.0),
                "radtan", (781.6, 780.2, 515.3, 379.8, -0.28, 0.09, 6e-4, -4e-4), (1024, 768),
                rate_hz=5 / 3, start_s=0.2,
            ),
            "right_camera": SimulatedCamera(
                "/right/image_raw", (-0.05, -0.20, 0.60), (-90.0, 0.0, 180.0),
                "kannala_brandt", (641.9, 641.1, 478.2, 362.7, -0.012, 0.018, -0.011, 0.002),
                (960, 720), "png", rate_hz=5 / 3, start_s=0.25,
            ),
        },
        session_names=("morning", "evening"),
        placement_layouts=(
            {
                "board": TargetSpot("front_lidar", (-9, 9), (1.5, 2.8), ("front_lidar",)),
                "cylinder": TargetSpot("rear_lidar", (-14, 14), (1.4, 2.4), ("rear_lidar",)),
            },
            {
                "board": TargetSpot(
                    "left_camera", (-11, 11), (1.3, 2.4), ("left_camera",), (-3, 8)
                ),
                "cylinder": TargetSpot(
                    "right_camera", (-14, 14), (1.1, 1.7), ("right_camera",), (-9, 9)
                ),
            },
            {
                "board": TargetSpot("rear_lidar", (-9, 9), (1.5, 2.8), ("rear_lidar",)),
                "cylinder": TargetSpot("front_lidar", (-14, 14), (1.4, 2.4), ("front_lidar",)),
            },
        ),
        single_target_spots={},
        default_arguments={
            "placements": 15, "range_noise_m": 0.01, "image_noise": 1.8, "blur_px": 0.7,
            "mcs_noise_m": 0.00015, "mcs_noise_deg": 0.02,
            "mcs_bias_m": 0.00005, "mcs_bias_deg": 0.005,
        },
    ),
}  # fmt: skip


def layouts_for_targets(rig: SimulatedRig, targets: Sequence[str]) -> tuple[PlacementLayout, ...]:
    """Return the layouts of placements with some of the targets only."""
    if len(targets) == 1 and targets[0] in rig.single_target_spots:
        return ({targets[0]: rig.single_target_spots[targets[0]]},)
    return tuple({name: layout[name] for name in targets} for layout in rig.placement_layouts)


def customize_rig(rig: SimulatedRig, args: argparse.Namespace) -> SimulatedRig:
    """Return the rig with what the arguments say of all its lidars or all its cameras.

    An argument of None changes nothing. A camera model comes with its own parameters and image
    size.
    """
    lidar_changes: dict[str, Any] = {"sector_deg": args.sector_deg}
    camera_changes: dict[str, Any] = {
        "rate_hz": args.camera_hz,
        "encoding": args.compressed or args.encoding,
    }
    if args.lidar:
        cloud_format, pattern_name = LIDAR_CHOICES[args.lidar]
        lidar_changes |= {"cloud_format": cloud_format, "pattern_name": pattern_name}
    if args.camera_model:
        camera_changes |= {
            "model": args.camera_model,
            "params": LENS_PARAMS[args.camera_model],
            "size_px": (900, 700),
        }
    sensors: dict[str, SimulatedLidar | SimulatedCamera] = {}
    for name, spec in rig.sensors.items():
        if isinstance(spec, SimulatedLidar):
            sensors[name] = spec._replace(**_stated(lidar_changes))
        else:
            changed = spec._replace(**_stated(camera_changes))
            sensors[name] = _set_distortion(changed, args.distortion)
    return rig._replace(sensors=sensors)


def _stated(changes: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in changes.items() if value is not None}


def _set_distortion(camera: SimulatedCamera, distortion: Sequence[float] | None) -> SimulatedCamera:
    """Return a radtan camera with distortion k1 k2 p1 p2; another camera as it is."""
    if camera.model != "radtan" or not distortion:
        return camera
    return camera._replace(params=(*camera.params[:4], *distortion))


def simulated_camera_models() -> list[str]:
    """Return the names of the camera models with parameters in LENS_PARAMS."""
    return [name for name in CAMERA_MODELS if name in LENS_PARAMS]
