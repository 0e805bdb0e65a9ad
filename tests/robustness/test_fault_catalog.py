"""The table of docs/faults.md: every fixture is in it, with what is said of it today."""

import re

import pytest
import yaml

from calib.io.status import InputError
from helpers import small_run
from helpers.fault_catalog import fault_table
from helpers.fault_catalog.all_faults import FAULT_CASES, list_audit_messages, write_fault_run
from helpers.fault_catalog.fault_table import (
    CLEAN_NAME,
    escape_table_cell,
    format_fault_row,
    measure_all_faults,
)
from helpers.log_containers import decode_tables

DOC = (small_run.ROOT / "docs/faults.md").read_text()
LINES = [line for line in DOC.splitlines() if line.startswith("| `")]
ROWS = {cells[0].strip("`"): cells[1:] for cells in (
    [c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1]] for line in LINES
)}  # fmt: skip
WHAT, SAID, LIDAR, CAMERA, COMES_TO = range(5)
# Told by stages after decode, from the views on.
LATER = {
    "names_exchanged", "late_clock", "board_late", "drifting_clock", "stamp_at_end", "empty_clouds",
    "damaged_clouds", "cloud_in_body_frame", "blurred", "black", "another_resolution", "jpeg_cut",
    "focal_wrong", "few_views", "square_wrong", "targets_larger", "board_backward", "mount_far_off",
    "guess_turned", "target_knocked",
}  # fmt: skip


def test_the_table_has_every_fixture_in_its_order_and_thirty_or_more():
    assert list(ROWS) == list(FAULT_CASES) and len(ROWS) >= 30
    for name, fault in FAULT_CASES.items():
        assert ROWS[name][WHAT].startswith(fault.description)
        assert escape_table_cell(fault.expected_text) in ROWS[name][SAID]


@pytest.mark.parametrize("name", ROWS)
def test_what_a_fault_comes_to_follows_from_its_figures(name):
    *_, lidar, camera, comes_to = ROWS[name]
    ratios = [float(c.rsplit("(", 1)[1].strip(")")) for c in (lidar, camera) if c != "none"]
    worse = any(r > fault_table.MAX_ERROR_RATIO for r in ratios)
    assert worse == ("worse" in comes_to)
    assert ("none" in (lidar, camera)) == comes_to.startswith(("fails: ", "stopped, named"))
    # Whatever is worse and passes, or fails, says why in the table.
    if comes_to != "as clean":
        assert ROWS[name][SAID] != "–" or FAULT_CASES[name].note


def decode_options(folder):
    """The options of decode for a working directory, and its log."""
    settings, rig = (
        yaml.safe_load((folder / "config" / n).read_text())
        for n in ("config.yaml", "rigs/sim.yaml")
    )
    targets = [yaml.safe_load(p.read_text()) for p in sorted(folder.glob("config/targets/*"))]
    session = settings["sessions"]["sim"]
    paths = session["log"] if isinstance(session["log"], list) else [session["log"]]
    logs = [str(folder / p) for p in paths]
    bodies = sorted({rig["body"], *(t["body"] for t in targets)})
    span = {k: session.get(k) for k in ("from_s", "to_s")}
    mocap = {"max_gap_s": 0.05, "unit": "auto", "quaternions": "auto"} | rig["mocap"]
    given = {"sensors": rig["sensors"], "mocap": mocap, "bodies": bodies, "fingerprint": [], **span}
    return logs if isinstance(session["log"], list) else logs[0], given


@pytest.mark.parametrize("name", [n for n in ROWS if n not in LATER])
def test_decode_says_of_a_fault_what_the_table_says(tmp_path, name):
    fault = FAULT_CASES[name]
    log, options = decode_options(write_fault_run(tmp_path, fault))
    try:
        said = list_audit_messages(decode_tables(log, options)[2])
    except InputError as error:
        said = [str(error).replace(f"{tmp_path}/", "")]
    expected = without_byte_counts(ROWS[name][SAID])
    assert expected == "–" or any(
        expected in without_byte_counts(escape_table_cell(s)) for s in said
    )


def without_byte_counts(text):
    """The text without numbers of bytes: how large a simulated log is depends on the machine."""
    return re.sub(r"\bbyte \d+ of \d+|\b\d+ bytes", "bytes", text)


@pytest.mark.slow
def test_a_fault_taken_through_the_pipeline_gives_the_row_of_the_table(tmp_path):
    found = measure_all_faults(tmp_path, ["topic_wrong"])
    made = format_fault_row("topic_wrong", found["topic_wrong"], found[CLEAN_NAME])
    assert made in LINES
