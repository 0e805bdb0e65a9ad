"""Measure memory and time of the worst input that each budget admits, as a table.

    PYTHONPATH=scripts OMP_NUM_THREADS=1 .venv/bin/python -m benchmarking.fuzzing.budget_costs

Each input is made and read in a process of its own; only the reading is timed.
"""

import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from mcap.records import Schema

from benchmarking.fuzzing.case_runner import read_peak_memory
from benchmarking.fuzzing.crafted_mcap import CraftedMcap, make_chunk
from benchmarking.page.markdown import format_markdown_table
from calib.io.logs.bounded.decompression import MAX_UNPACKED_BYTES
from calib.io.logs.bounded.definition_budget import MAX_EXPANDED_VALUES, MAX_IDL_EXPRESSIONS
from calib.io.logs.bounded.mcap_chunks import FREE_UNPACKED_BYTES
from calib.io.logs.bounded.overlap_budget import MAX_OVERLAPPING_CHUNKS
from calib.io.logs.message_types import MessageTypes
from calib.io.logs.open_log import open_log
from calib.io.logs.ros_messages import TF_TYPE
from calib.sensors.camera.images import compressed_image
from calib.targets.point_template import read_template_file
from calib.targets.template_header import MAX_TEMPLATE_POINTS

TYPE = "own_msgs/msg/Pose"
MB = 1 << 20
Read = Callable[[], Any]  # reads the input that was made


def make_definition(form: str, text: str) -> Read:
    """Return the reader of a definition of TYPE."""
    types = MessageTypes("log")
    types.add_definition(TYPE, form, text)
    return lambda: types.find_type_store(TYPE, "cdr").get_msgdef(TYPE)


def make_msg_definition(folder: Path) -> Read:
    """Return the reader of a message of as many texts as allowed."""
    return make_definition("ros2msg", f"string[{MAX_EXPANDED_VALUES - 2}] a\n")


def make_idl_definition(folder: Path) -> Read:
    """Return the reader of a definition of as many constants as allowed."""
    n = MAX_IDL_EXPRESSIONS - 1
    constants = "".join(f"const long C{k} = {k};" for k in range(n))
    return make_definition(
        "ros2idl",
        f"module own_msgs {{ module msg {{ module Pose_Constants {{ {constants} }}; "
        "struct Pose { double x; }; }; };",
    )


def make_log(folder: Path, chunk_times: list[list[int]], message_bytes: int) -> Read:
    """Return the reader of an MCAP file of chunks with messages at these log times, ns."""
    schema = Schema(id=1, name=TF_TYPE, encoding="", data=b"")
    chunks = [make_chunk(times, bytes(message_bytes)) for times in chunk_times]
    path = CraftedMcap("/tf", schema, chunks).write(folder / "a.mcap")

    def read() -> None:
        assert sum(1 for _ in open_log(str(path)).iter_messages(["/tf"]))

    return read


def make_large_chunk(folder: Path) -> Read:
    """Return the reader of one chunk of the largest size."""
    return make_log(folder, [[0]], MAX_UNPACKED_BYTES - 100)


def make_many_messages(folder: Path) -> Read:
    """Return the reader of a chunk of as many messages as its bytes pay for."""
    return make_log(folder, [np.random.default_rng(0).permutation(10**6)[:200_000].tolist()], 0)


def make_overlaps(folder: Path) -> Read:
    """Return the reader of chunks that all hold the same times, 512 MiB together."""
    size = 2 * MAX_UNPACKED_BYTES // MAX_OVERLAPPING_CHUNKS // 2 - 100
    return make_log(folder, [[0, 10**9]] * MAX_OVERLAPPING_CHUNKS, size)


def make_small_file(folder: Path) -> Read:
    """Return the reader of a small file whose chunks unpack to as much as allowed."""
    n = FREE_UNPACKED_BYTES // (64 * MB) - 1
    return make_log(folder, [[k] for k in range(n)], 64 * MB)


def make_image(folder: Path) -> Read:
    """Return the reader of a PNG of the most pixels, all of one colour."""
    side = int((MAX_UNPACKED_BYTES / 3) ** 0.5)
    data = cv2.imencode(".png", np.zeros((side, side, 3), np.uint8))[1].ravel()
    message = SimpleNamespace(format="png", data=data)
    return lambda: compressed_image.read(message)


def make_template(folder: Path) -> Read:
    """Return the reader of a template of the most points."""
    n = MAX_TEMPLATE_POINTS
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {n}\n" + "".join(
        f"property float {axis}\n" for axis in "xyz"
    )
    path = folder / "a.ply"
    points = np.random.default_rng(0).normal(size=(n, 3)).astype(np.float32)
    path.write_bytes(f"{head}end_header\n".encode() + points.tobytes())
    return lambda: read_template_file(path)


WORST_INPUTS: dict[str, Callable[[Path], Read]] = {
    "definition: values of a message": make_msg_definition,
    "definition: constants of IDL": make_idl_definition,
    "chunk: unpacked bytes": make_large_chunk,
    "chunk: messages": make_many_messages,
    "chunks that overlap in time": make_overlaps,
    "file: unpacked bytes of all chunks": make_small_file,
    "image: pixels": make_image,
    "template: points": make_template,
}


def _measure_input(name: str, results: "multiprocessing.Queue[tuple[float, float]]") -> None:
    with tempfile.TemporaryDirectory(prefix="budget-") as folder:
        read = WORST_INPUTS[name](Path(folder))
        # From here on, the peak is that of reading.
        Path("/proc/self/clear_refs").write_text("5")
        begin = time.process_time()
        read()
        results.put((time.process_time() - begin, read_peak_memory()))


def measure_budgets() -> list[list[str]]:
    """Return a row for each worst input: name, CPU seconds and peak memory, MB."""
    context, rows = multiprocessing.get_context("spawn"), []
    for name in WORST_INPUTS:
        results: multiprocessing.Queue[tuple[float, float]] = context.Queue()
        process = context.Process(target=_measure_input, args=(name, results))
        process.start()
        process.join()
        if process.exitcode:
            raise RuntimeError(f"{name}: exit code {process.exitcode}")
        seconds, memory = results.get()
        rows.append([name, f"{seconds:.1f}", f"{memory:.0f}"])
        print(*rows[-1], file=sys.stderr, flush=True)
    return rows


if __name__ == "__main__":
    print(
        format_markdown_table(("worst admitted input", "CPU, s", "memory, MB"), measure_budgets())
    )
