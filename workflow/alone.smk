"""What a run makes sure of before it begins: a config that may be read, room on the disk, and locks
with a run behind them.

Snakemake reads config.yaml with less care than calib.io.safe_yaml: it takes the last of a key that stands
twice, and unfolds every alias.
Snakemake's lock outlives a run that was killed; one of the kernel does not. Every run shares one,
and so does every job, for jobs go on for a while where Snakemake alone was killed. Who gets it for
himself may remove what dead runs have locked, and nobody has to type --unlock.
"""

import fcntl
import shutil
import sys
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(workflow.basedir) / "scripts"))

from calib.io import safe_yaml
from calib.io.status import InputError, printable
from snakemake.exceptions import WorkflowError

CONFIG_FILE = Path("config/config.yaml")
STATE = Path(".snakemake")
LEAST_FREE = 1 << 20  # bytes; with fewer Snakemake cannot keep its books
# Before the command of a job: its shell and what that starts share the lock. Snakemake fills braces.
SHARE = f"{{{{ exec 9<{STATE}/alive && flock -s 9; }}}} 2>/dev/null || true; "


def no_room():
    """In words, that the disk is full; empty where it is not."""
    if shutil.disk_usage(".").free >= LEAST_FREE:
        return ""
    return f"{Path.cwd()}: no space left on its disk; free some and run again"


def share_lock():
    """The file that is locked as long as this run lives; what dead ones have locked is freed."""
    STATE.mkdir(exist_ok=True)
    held = (STATE / "alive").open("a")
    # On a file system without such locks, --unlock is left to do.
    with suppress(OSError):
        if alone(held):
            for left in (STATE / "locks").glob("*.lock"):
                left.unlink(missing_ok=True)
        fcntl.flock(held, fcntl.LOCK_SH)
    return held


def alone(held):
    """Whether no other run and no job is alive; if so, none can begin until the lock is shared."""
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def require_readable():
    """Stop in words where the config is none that anybody would write."""
    try:
        safe_yaml.load(CONFIG_FILE)
    except InputError as error:
        raise WorkflowError(printable(str(error)))


if no_room():
    raise WorkflowError(no_room())
if CONFIG_FILE.is_file():
    require_readable()
ALIVE = share_lock()
