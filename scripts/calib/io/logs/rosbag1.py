"""ROS 1 bags, through their index."""

from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import decompressors

from calib.io.logs.decompression import decompress_bzip2, decompress_lz4
from calib.io.logs.rosbags_reader import RosbagsLog, open_readers

ROSBAG1_REMEDY = "run `rosbag reindex {}` and use its output"
BOUNDED_DECOMPRESSORS = {
    decompressors["bz2"]: decompress_bzip2,
    decompressors["lz4"]: decompress_lz4,
}


def open_rosbag1(files):
    """The RosbagsLog of ROS 1 bags."""
    readers = open_readers(files, Reader, ROSBAG1_REMEDY)
    for _, reader in readers:
        for at, chunk in reader.chunks.items():
            bounded = BOUNDED_DECOMPRESSORS.get(chunk.decompressor, chunk.decompressor)
            reader.chunks[at] = chunk._replace(decompressor=bounded)
    return RosbagsLog(readers, lambda connection: "ros1")
