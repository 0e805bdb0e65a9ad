"""ROS 1 bags, through their index."""

from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import decompressors

from calib.io.logs import decompression
from calib.io.logs.rosbags_reader import RosbagsLog, opened

REMEDY = "run `rosbag reindex {}` and use its output"
BOUNDED = {decompressors["bz2"]: decompression.bzip2, decompressors["lz4"]: decompression.lz4}


def open_bag(files):
    """The RosbagsLog of ROS 1 bags."""
    readers = opened(files, Reader, REMEDY)
    for _, reader in readers:
        for at, chunk in reader.chunks.items():
            bounded = BOUNDED.get(chunk.decompressor, chunk.decompressor)
            reader.chunks[at] = chunk._replace(decompressor=bounded)
    return RosbagsLog(readers, lambda connection: "ros1")
