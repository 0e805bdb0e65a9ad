"""Command line, logging and JSON files of all stage scripts."""

import argparse
import errno
import json
import logging
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calib.io.atomic_files import write_file
from calib.io.status import InputError, escape_control_characters

logger = logging.getLogger("calib")
RULE_BY_STAGE = {"preflight": "preflight_rig"}  # where its name is another
OPENCV_NO_MEMORY = -4  # cv2.error.code
# Start of the interpreter, s: until here it only computed, so its CPU time is its age.
PROCESS_START_S = time.perf_counter() - time.process_time()


class StageArgumentParser(argparse.ArgumentParser):
    """Command line of a stage: its docstring as help, --options and one flag per file."""

    def __init__(
        self, description: str | None, options_help: str = "slice of the config, as JSON"
    ) -> None:
        super().__init__(
            description=description, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        self.add_argument("--options", type=json.loads, required=True, help=options_help)

    def add_path(self, flag: str, description: str) -> None:
        """Add a required flag that takes one path."""
        self.add_argument(flag, type=Path, required=True, help=description)

    def add_paths(self, flag: str, description: str) -> None:
        """Add a required flag that takes any number of paths."""
        self.add_argument(flag, type=Path, nargs="*", required=True, help=description)


class EscapingFormatter(logging.Formatter):
    """Formatter that escapes control characters, because lines may hold names from a log.

    Further lines of a message are indented: only the start of a message starts a line.
    """

    def format(self, record: logging.LogRecord) -> str:
        lines = escape_control_characters(super().format(record)).split("\n")
        return "\n".join([lines[0], *(f"  {line.lstrip()}" for line in lines[1:])])


def run_stage(main: Callable[[], None]) -> None:
    """Run a stage's main; an InputError ends in one line and exit code 1, without a trace.

    So does memory that runs out: the rule limits the address space of the job.
    """
    logging.basicConfig(stream=sys.stderr, level=logging.INFO)
    logging.getLogger().handlers[0].setFormatter(EscapingFormatter("%(message)s"))
    try:
        main()
        _log_cost(Path(sys.argv[0]).stem)
    except Exception as error:
        if is_out_of_memory(error):
            logger.error("error: %s", _describe_memory_limit(sys.argv))
        elif isinstance(error, InputError):
            logger.error("error: %s", error)
        else:
            raise
        sys.exit(1)


def is_out_of_memory(error: BaseException | None) -> bool:
    """Return whether an error, or one that caused it, says that memory could not be allocated."""
    while error is not None:
        if isinstance(error, MemoryError) or "bad_alloc" in str(error):
            return True
        if isinstance(error, OSError) and error.errno == errno.ENOMEM:
            return True
        if getattr(error, "code", None) == OPENCV_NO_MEMORY and type(error).__module__ == "cv2":
            return True
        error = error.__cause__ or error.__context__
    return False


def _describe_memory_limit(argv: list[str]) -> str:
    """Return the message of a job without memory left, with the files that it reads."""
    stage, limit = Path(argv[0]).stem, resource.getrlimit(resource.RLIMIT_AS)[0]
    allowed = "it can get"
    remedy = "Free some memory and run again."
    if limit != resource.RLIM_INFINITY:
        allowed = f"its limit, {limit >> 20} MB of address space"
        remedy = (
            "If the files are yours and sound, raise it: "
            f"snakemake --set-resources {RULE_BY_STAGE.get(stage, stage)}:mem_mb={limit >> 19}."
        )
    return f"{_name_inputs(argv)}: {stage} needs more memory than {allowed}. {remedy}"


def _name_inputs(argv: list[str]) -> str:
    """Return the log that a stage reads, or else the first of its files, by its command line."""
    options = json.loads(argv[argv.index("--options") + 1]) if "--options" in argv else {}
    log = options.get("log", []) if isinstance(options, dict) else []
    names = [log] if isinstance(log, str) else list(log)
    first = [word for word in argv[1:] if not word.startswith("--")][:1]
    return ", ".join(names or first)


def _log_cost(name: str) -> None:
    """Log time and memory of the job since the interpreter started, as its last line."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    wall = time.perf_counter() - PROCESS_START_S
    cost = wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024
    logger.info("%s took %.2f s, %.2f s CPU, %.0f MB", name, *cost)


def limit_opencv_threads() -> None:
    """Limit OpenCV to the threads that Snakemake granted; OpenCV does not read OMP_NUM_THREADS."""
    import cv2

    cv2.setNumThreads(int(os.environ.get("OMP_NUM_THREADS", "1")))


def write_json(path: str | Path, content: Any) -> None:
    """Write content as sorted, indented JSON; NaN and infinity raise ValueError."""
    text = json.dumps(content, indent=1, sort_keys=True, allow_nan=False) + "\n"
    write_file(path, text)


def read_json(path: str | Path) -> Any:
    """Return the content of a JSON file."""
    return json.loads(Path(path).read_text())
