"""Names that a log brings along are shown as they are, and neither obeyed nor drawn as formulas."""

import html
import logging

import report
from calib.io.stage_cli import EscapingFormatter
from calib.io.status import escape_control_characters, failure_status

NAME = "<script>alert(1)</script><b>&amp; $\\frac{$ {{ 7 * 7 }} \x1b[2J"


def test_control_characters_are_written_out_and_letters_are_not():
    assert escape_control_characters("a\x1b[2J\u202eb\r\n") == "a\\x1b[2J\\u202eb\\r\n"
    assert escape_control_characters("µ é 漢 − \u2009°") == "µ é 漢 − \u2009°"
    assert escape_control_characters("\ud800") == "\\ud800"


def test_a_stage_logs_no_control_character():
    line = logging.LogRecord("calib", logging.INFO, "", 0, "topic %s", (NAME,), None)
    assert "\x1b" not in EscapingFormatter("%(message)s").format(line)


def test_the_report_shows_what_a_log_names_and_runs_none_of_it(report_files):
    for audit in report_files.audits.values():
        audit["topics"][NAME] = {"type": NAME, "messages": 3}
        audit["faults"] = [NAME]
        for sensor in audit["sensors"].values():
            sensor |= {"frame": NAME, "inferred": {"image": NAME}}
        for body in audit["bodies"].values():
            body["status"] = failure_status(NAME, NAME, NAME, NAME).to_dict()
    report_files.calibration["reasons"] = [NAME]
    report.main(report_files.write_inputs())
    page = (report_files.folder / "report.html").read_text()
    assert page.count(html.escape(NAME, quote=False)) + page.count(html.escape(NAME)) >= 5
    assert "<script>alert" not in page and "</script><b>" not in page
    assert (report_files.folder / "report.pdf").read_bytes().startswith(b"%PDF")
