"""What a run checks before Snakemake reads the config: free space on the disk, and a valid config.

Snakemake reads config.yaml with less care than calib.io.safe_yaml: it takes the last of a repeated
key, and expands every alias.
"""

import logging
import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(workflow.basedir) / "scripts"))

from calib.io.atomic_files import disk_full_message
from calib.io.safe_yaml import load_yaml
from calib.io.status import InputError, escape_control_characters
from snakemake.exceptions import WorkflowError

CONFIG_FILE = Path("config/config.yaml")
MIN_FREE_BYTES = 1 << 20  # with fewer, Snakemake cannot write its own files


# On a full disk, each line of Snakemake's own log would print a traceback of Python's logging.
logging.raiseExceptions = False


def is_disk_full():
    """Return whether the disk of the working folder is too full for Snakemake."""
    return shutil.disk_usage(".").free < MIN_FREE_BYTES


def require_readable_config():
    """Stop with one line if config.yaml is not a valid YAML file."""
    try:
        load_yaml(CONFIG_FILE)
    except InputError as error:
        raise WorkflowError(escape_control_characters(str(error)))


if is_disk_full():
    raise WorkflowError(disk_full_message(Path.cwd()))
if CONFIG_FILE.is_file():
    require_readable_config()
