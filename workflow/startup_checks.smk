"""What a run checks before Snakemake reads the config: free space on the disk, and a valid config.

Snakemake reads config.yaml with less care than calib.io.safe_yaml: it takes the last of a repeated
key, and expands every alias.
"""

import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(workflow.basedir) / "scripts"))

from calib.io.safe_yaml import load_yaml
from calib.io.status import InputError, escape_control_characters
from snakemake.exceptions import WorkflowError

CONFIG_FILE = Path("config/config.yaml")
MIN_FREE_BYTES = 1 << 20  # with fewer, Snakemake cannot write its own files


def disk_full_message():
    """Return the message that the disk is full; empty if it is not."""
    if shutil.disk_usage(".").free >= MIN_FREE_BYTES:
        return ""
    return f"{Path.cwd()}: no space left on its disk; free some space and run again"


def require_readable_config():
    """Stop with one line if config.yaml is not a valid YAML file."""
    try:
        load_yaml(CONFIG_FILE)
    except InputError as error:
        raise WorkflowError(escape_control_characters(str(error)))


if disk_full_message():
    raise WorkflowError(disk_full_message())
if CONFIG_FILE.is_file():
    require_readable_config()
