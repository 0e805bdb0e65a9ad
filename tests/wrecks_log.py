"""Faults of files, and of what is written about a recording."""

import containers
from fault import Fault


def flipped(data):
    """One bit wrong in the middle of every fourth MiB, which are chunks of sensors' messages."""
    data = bytearray(data)
    for at in range(3 << 20, len(data), 4 << 20):
        data[at] ^= 16
    return bytes(data)


def split_in_half(path, rows):
    """A folder whose metadata names two files, of which the second is missing."""
    containers.split(path, rows)
    (path / "bag_1.mcap").unlink()
    return str(path)


def another_suffix(path, rows):
    return str(containers.mcap(path.with_suffix(".log"), rows, chunk_size=1 << 20))


def of_sensor(name, **keys):
    return lambda session, rig, targets: rig["sensors"][name].update(keys)


def of_board(**keys):
    return lambda session, rig, targets: targets["board"].update(keys)


def pattern(**keys):
    return lambda session, rig, targets: targets["board"]["pattern"].update(keys)


def guess_turned(session, rig, targets):
    rig["sensors"]["velodyne"]["T_robot_sensor"]["rpy_deg"][2] += 90


FLAT = {"xyz_m": [0.0, 0.0, 0.0], "rpy_deg": [0.0, 180.0, 0.0]}
LOG = {
    "truncated": Fault(
        "a recorder that crashed: the last 20 % of the file are missing", "breaks off after byte",
        spoil=lambda data: data[: int(0.8 * len(data))],
    ),
    "bits_flipped": Fault("wrong bits in the file", "sim", spoil=flipped),
    "zero_bytes": Fault("a log of zero bytes", "logs/sim", spoil=lambda data: b""),
    "blank": Fault("a log of zeros only", "logs/sim", spoil=lambda data: bytes(len(data))),
    "split_lost": Fault(
        "metadata.yaml names a file that is not there", "logs/sim", write=split_in_half,
    ),
    "wrong_suffix": Fault("an MCAP that is called .log", "logs/sim", write=another_suffix),
    "topic_wrong": Fault(
        "the camera's topic is misspelt in the rig", "is not in the log",
        config=of_sensor("camera", topic="/camera/image_rwa"),
    ),
    "few_views": Fault(
        "only the first three placements are recorded", "placements",
        config=lambda session, rig, targets: session.update(to_s=6.3),
    ),
    "square_wrong": Fault(
        "squares of the pattern are 80 mm, not 78 as stated", "a wrong size",
        config=pattern(square_m=0.078),
    ),
    "targets_larger": Fault(
        "targets are built 3 % larger than stated", "probably", simulated="--target-scale 1.03",
        note="Outline, pattern and radius at once: the outline is named, the others are not",
    ),
    "board_backward": Fault(
        "the board is stated the wrong way round", "seen from behind",
        config=of_board(T_body_target=FLAT),
    ),
    "mount_far_off": Fault(
        "the board sits 40 mm from where T_body_target says", "board",
        config=of_board(T_body_target={"xyz_m": [0.03, 0.026, 0.0], "rpy_deg": [0.0, 0.0, 0.0]}),
    ),
    "guess_turned": Fault(
        "the first guess of the lidar is turned by 90°", "view", config=guess_turned,
    ),
}  # fmt: skip
