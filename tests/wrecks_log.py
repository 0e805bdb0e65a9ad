"""Faults of files, and of what is written about a recording."""

import numpy as np

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


def bare_sqlite(path, rows):
    return str(containers.without_definitions(containers.rosbag2(path, rows, containers.SQLITE)))


def torn_apart(path, rows):
    """A list whose files come in the wrong order."""
    half = len(rows) // 2
    path.mkdir()
    later = containers.mcap(path / "a.mcap", rows[half:], chunk_size=1 << 20)
    return [
        str(p) for p in (later, containers.mcap(path / "b.mcap", rows[:half], chunk_size=1 << 20))
    ]


def another_suffix(path, rows):
    return str(containers.mcap(path.with_suffix(".log"), rows, chunk_size=1 << 20))


def of_sensor(name, **keys):
    return lambda session, rig, targets: rig["sensors"][name].update(keys)


def of_board(**keys):
    return lambda session, rig, targets: targets["board"].update(keys)


def pattern(**keys):
    return lambda session, rig, targets: targets["board"]["pattern"].update(keys)


def guess_off(session, rig, targets):
    xyz = rig["sensors"]["velodyne"]["T_robot_sensor"]["xyz_m"]
    xyz[0] += 0.25
    xyz[2] -= 0.15


def guess_turned(session, rig, targets):
    rig["sensors"]["velodyne"]["T_robot_sensor"]["rpy_deg"][2] += 90


def no_guess(session, rig, targets):
    for sensor in rig["sensors"].values():
        del sensor["T_robot_sensor"], sensor["guess_sigma"]


def bodies_exchanged(session, rig, targets):
    board, cylinder = targets["board"]["body"], targets["cylinder"]["body"]
    targets["board"]["body"], targets["cylinder"]["body"] = cylinder, board


def outline_mirrored(session, rig, targets):
    """The pattern's corners counted from the other side of the board's centre."""
    targets["board"]["pattern"]["first_corner_m"] = [-0.26, -0.16]


def busy(rows):
    late = np.random.default_rng(0).uniform(0, 0.8e9, len(rows)).astype(int)
    out = [(row[0] + int(dt), *row[1:]) for row, dt in zip(rows, late, strict=True)]
    return sorted(out, key=lambda row: row[0])


FLAT = {"xyz_m": [0.0, 0.0, 0.0], "rpy_deg": [0.0, 180.0, 0.0]}
LOG = {
    "truncated": Fault(
        "a recorder that crashed: the last 20 % of the file are missing", "breaks off after byte",
        spoil=lambda data: data[: int(0.8 * len(data))],
    ),
    "bits_flipped": Fault("wrong bits in the file", "sim", spoil=flipped),
    "zero_bytes": Fault("a log of zero bytes", "", spoil=lambda data: b""),
    "blank": Fault("a log of zeros only", "", spoil=lambda data: bytes(len(data))),
    "split_lost": Fault("metadata.yaml names a file that is not there", "", write=split_in_half),
    "wrong_suffix": Fault("an MCAP that is called .log", "", write=another_suffix),
    "topic_wrong": Fault(
        "the camera's topic is misspelt in the rig", "is not in the log",
        config=of_sensor("camera", topic="/camera/image_rwa"),
    ),
    "few_views": Fault(
        "only the first three placements are recorded", "placements",
        config=lambda session, rig, targets: session.update(to_s=6.3),
    ),
    "square_wrong": Fault(
        "squares of the pattern are 80 mm, not 78 as stated", "probably",
        config=pattern(square_m=0.078),
    ),
    "targets_larger": Fault(
        "targets are built 3 % larger than stated", "probably", simulated="--target-scale 1.03",
    ),
    "board_backward": Fault(
        "the board is stated the wrong way round", "seen from behind",
        config=of_board(T_body_target=FLAT),
    ),
    "mount_far_off": Fault(
        "the board sits 40 mm from where T_body_target says", "board",
        config=of_board(T_body_target={"xyz_m": [0.03, 0.026, 0.0], "rpy_deg": [0.0, 0.0, 0.0]}),
    ),
    "bodies_exchanged": Fault(
        "the rig takes the cylinder's body for the board's", "seen", config=bodies_exchanged,
    ),
    "guess_off": Fault(
        "the first guess of the lidar is 0.29 m off, at a stated σ of 17 mm", "first guess",
        config=guess_off,
    ),
    "guess_turned": Fault(
        "the first guess of the lidar is turned by 90°", "view", config=guess_turned,
    ),
}  # fmt: skip
