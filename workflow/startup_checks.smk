"""What a run checks before Snakemake reads the config: disk space, symbolic links, a valid config.

Snakemake reads config.yaml with less care than calib.io.safe_yaml: it takes the last of a repeated
key, and expands every alias.
"""

import logging
import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(workflow.basedir) / "scripts"))

from calib.io.atomic_files import disk_full_message, require_no_link, require_no_link_below
from calib.io.safe_yaml import load_yaml
from calib.io.status import InputError, escape_control_characters
from snakemake.exceptions import WorkflowError

CONFIG_FILE = Path("config/config.yaml")
CODE_KEY = "__use_yte__"  # with it, Snakemake runs Python that a config file holds
# Of .snakemake: environments that Snakemake installs, which may hold links.
INSTALLED_FOLDERS = ("conda", "conda-archive", "singularity")
MIN_FREE_BYTES = 1 << 20  # with fewer, Snakemake cannot write its own files


# On a full disk, each line of Snakemake's own log would print a traceback of Python's logging.
logging.raiseExceptions = False


def is_disk_full():
    """Return whether the disk of the working folder is too full for Snakemake."""
    return shutil.disk_usage(".").free < MIN_FREE_BYTES


def require_readable_config():
    """Stop with one line if config.yaml is not a valid YAML file, or one that runs code."""
    content = load_yaml(CONFIG_FILE)
    if isinstance(content, dict) and CODE_KEY in content:
        raise InputError(f"{CONFIG_FILE}: {CODE_KEY} runs code of the file. Remove this key.")


def require_no_links():
    """Stop with one line if anything that a run writes lies behind a symbolic link."""
    require_no_link_below("results")
    require_no_link(".snakemake")
    for path in sorted(Path(".snakemake").glob("*")):
        if path.name not in INSTALLED_FOLDERS:
            require_no_link_below(path)


if is_disk_full():
    raise WorkflowError(disk_full_message(Path.cwd()))
try:
    require_no_links()
    if CONFIG_FILE.is_file():
        require_readable_config()
except InputError as error:
    raise WorkflowError(escape_control_characters(str(error)))
