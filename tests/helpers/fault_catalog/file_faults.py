"""Faults of files, and of what is written about a recording."""

from helpers.fault_catalog.fault_case import FaultCase
from helpers.log_containers import write_split_mcap, write_test_mcap


def flip_chunk_bits(data):
    """One bit wrong in the middle of every fourth MiB, which are chunks of sensors' messages."""
    data = bytearray(data)
    for at in range(3 << 20, len(data), 4 << 20):
        data[at] ^= 16
    return bytes(data)


def write_incomplete_split(path, rows):
    """A folder whose metadata names two files, of which the second is missing."""
    write_split_mcap(path, rows)
    (path / "bag_1.mcap").unlink()
    return str(path)


def write_wrong_suffix(path, rows):
    return str(write_test_mcap(path.with_suffix(".log"), rows, chunk_size=1 << 20))


def change_sensor_config(name, **keys):
    return lambda session, rig, targets: rig["sensors"][name].update(keys)


def change_board_config(**keys):
    return lambda session, rig, targets: targets["board"].update(keys)


def change_pattern_config(**keys):
    return lambda session, rig, targets: targets["board"]["pattern"].update(keys)


def rotate_lidar_guess(session, rig, targets):
    rig["sensors"]["velodyne"]["T_robot_sensor"]["rpy_deg"][2] += 90


REVERSED_MOUNT = {"xyz_m": [0.0, 0.0, 0.0], "rpy_deg": [0.0, 180.0, 0.0]}
FILE_FAULTS = {
    "truncated": FaultCase(
        "a recorder that crashed: the last 20 % of the file are missing",
        "breaks off after byte",
        damage_bytes=lambda data: data[: int(0.8 * len(data))],
    ),
    "bits_flipped": FaultCase("wrong bits in the file", "sim", damage_bytes=flip_chunk_bits),
    "zero_bytes": FaultCase("a log of zero bytes", "logs/sim", damage_bytes=lambda data: b""),
    "blank": FaultCase(
        "a log of zeros only", "logs/sim", damage_bytes=lambda data: bytes(len(data))
    ),
    "split_lost": FaultCase(
        "metadata.yaml names a file that is not there",
        "logs/sim",
        write_log=write_incomplete_split,
    ),
    "wrong_suffix": FaultCase(
        "an MCAP that is called .log", "logs/sim", write_log=write_wrong_suffix
    ),
    "topic_wrong": FaultCase(
        "the camera's topic is misspelt in the rig",
        "is not in the log",
        change_config=change_sensor_config("camera", topic="/camera/image_rwa"),
    ),
    "few_views": FaultCase(
        "only the first three placements are recorded",
        "placements",
        change_config=lambda session, rig, targets: session.update(to_s=6.3),
    ),
    "square_wrong": FaultCase(
        "squares of the pattern are 80 mm, not 78 as stated",
        "the squares of board",
        change_config=change_pattern_config(square_m=0.078),
    ),
    "targets_larger": FaultCase(
        "targets are built 3 % larger than stated",
        "likely error",
        simulate_arguments="--target-scale 1.03",
        note="Outline, pattern and radius at once: the outline is named, the others are not",
    ),
    "board_backward": FaultCase(
        "the board is stated the wrong way round",
        "seen from behind",
        change_config=change_board_config(T_body_target=REVERSED_MOUNT),
    ),
    "mount_far_off": FaultCase(
        "the board sits 40 mm from where T_body_target says",
        "board",
        change_config=change_board_config(
            T_body_target={"xyz_m": [0.03, 0.026, 0.0], "rpy_deg": [0.0, 0.0, 0.0]}
        ),
    ),
    "guess_turned": FaultCase(
        "the first guess of the lidar is turned by 90°",
        "view",
        change_config=rotate_lidar_guess,
    ),
}
