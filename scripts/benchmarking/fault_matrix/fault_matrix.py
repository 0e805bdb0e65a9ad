"""Measure the fault matrix and write it into docs/faults.md.

Every fault goes once through the whole pipeline, without noise. Draws of the noise are put on its
keypoints and poses, and go through solve and judge; then again after the first advice was followed.
"""

import argparse
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

from benchmarking.fault_matrix.matrix_faults import MATRIX_FAULTS, NOTHING, MatrixFault
from benchmarking.fault_matrix.matrix_page import write_matrix_section
from benchmarking.fault_matrix.row_measurement import RowResult, measure_row
from benchmarking.room_rigs import ROOM_RIGS

ROOT = Path(__file__).parents[3]
CLEAN_NAME = "clean"
CLEAN_FAULTS = tuple(
    MatrixFault(CLEAN_NAME, title, NOTHING, recording=arguments)
    for title, arguments in ROOM_RIGS.items()
)

FAULTS_BY_KEY = {fault.key: fault for fault in (*CLEAN_FAULTS, *MATRIX_FAULTS)}


def parse_matrix_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("work", type=Path, metavar="WORK", help="an own folder")
    add("--draws", type=int, default=10, help="of the noise, of each fault")
    add("--clean-draws", type=int, default=50, help="of each clean rig")
    add("--quick", action="store_true", help="one draw of each")
    add("--only", default="", help="rows whose name contains this")
    add("--keep", action="store_true", help="rows that an earlier run left in WORK")
    add("--cores", type=int, default=2)
    add("--docs", type=Path, default=ROOT / "docs", help="folder of faults.md")
    return parser.parse_args(argv)


def measure_into_file(work: Path, key: str, n_draws: int, has_kept_rows: bool) -> str:
    """Measure a row, unless it is there and has_kept_rows; return what came of it, in words."""
    path, fault = work / f"{key}.json", FAULTS_BY_KEY[key]
    if not (has_kept_rows and path.exists() and len(read_row(path).before) >= n_draws):
        row = measure_row(work / fault.key, fault, n_draws)
        path.write_text(row.to_json())
    row = read_row(path)
    levels = " ".join(d.level for d in row.before)
    return f"{row.title}: {row.stopped or levels}"


def read_row(path: Path) -> RowResult:
    """Read a row that was measured."""
    return RowResult.from_json(path.read_text())


def read_rows(work: Path, faults: Sequence[MatrixFault]) -> list[RowResult]:
    """Return the rows that were measured, in the order of the faults, with the causes of today."""
    paths = [(work / f"{fault.key}.json", fault) for fault in faults]
    return [replace(read_row(path), causes=fault.causes) for path, fault in paths if path.exists()]


def main(argv: Sequence[str] | None = None) -> None:
    """Measure the rows, and write the page of all rows in WORK."""
    args = parse_matrix_arguments(argv)
    # One thread per process. NumPy reads this when it is imported, so before the workers start.
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
    counts = (1, 1) if args.quick else (args.clean_draws, args.draws)
    work = args.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    tasks = [(fault, counts[0]) for fault in CLEAN_FAULTS]
    tasks += [(fault, counts[1]) for fault in MATRIX_FAULTS]
    with ProcessPoolExecutor(args.cores, get_context("spawn")) as pool:
        futures = [
            pool.submit(measure_into_file, work, fault.key, n, args.keep)
            for fault, n in tasks
            if args.only in f"{fault.name}, {fault.size}"
        ]
        for future in futures:
            print(future.result(), flush=True)
    clean, faulty = (read_rows(work, faults) for faults in (CLEAN_FAULTS, MATRIX_FAULTS))
    n_missing = len(FAULTS_BY_KEY) - len(clean) - len(faulty)
    print(write_matrix_section(args.docs / "faults.md", clean, faulty, n_missing))


if __name__ == "__main__":
    main()
