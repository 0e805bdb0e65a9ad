"""Logs in ROS 1 bags."""

from pathlib import Path

from rosbags import rosbag1
from rosbags.rosbag1.reader import decompressors

from calib.io.logs.bounded.decompression import decompress_bzip2, decompress_lz4
from calib.io.logs.rosbags_reader import RosbagsLog, open_readers

ROSBAG1_REMEDY = "Run `rosbag reindex {}` and use its output."
BOUNDED_DECOMPRESSORS = {
    decompressors["bz2"]: decompress_bzip2,
    decompressors["lz4"]: decompress_lz4,
}


class BoundedReader(rosbag1.Reader):
    """A reader that decompresses chunks with bounded memory."""

    def open(self) -> None:
        """Open the file and replace the decompressors of its chunks."""
        super().open()
        for offset, chunk in self.chunks.items():
            bounded = BOUNDED_DECOMPRESSORS.get(chunk.decompressor, chunk.decompressor)
            self.chunks[offset] = chunk._replace(decompressor=bounded)


def open_rosbag1(files: list[Path]) -> RosbagsLog:
    """Return the log in ROS 1 bags."""
    opened = open_readers(files, BoundedReader, ROSBAG1_REMEDY)
    return RosbagsLog(opened, lambda connection: "ros1")
