"""The report of a good run: what it says, and that it is complete, in both themes and on paper."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

import report
from calib.report.figures.figure_encoding import (
    THEME_VARIABLES,
    create_figure,
    encode_figure_svg,
    make_standalone_svg,
)
from calib.report.number_format import (
    choose_decimals,
    floor_to_nice_number,
    format_decimals,
    format_number,
)
from calib.report.page.report_context import PAGE_SECTIONS
from helpers.report_inputs import extract_page_text, remove_plotly
from report import FIGURE_COLUMNS


def test_sections_come_in_order(good_report_page):
    found = re.findall(r"<h2>(\d+) ([^<]*)<", good_report_page)
    assert found == [(str(i), name.capitalize()) for i, name in enumerate(PAGE_SECTIONS, 1)]
    assert len(found) == 15


@pytest.mark.parametrize(
    "said",
    [
        "PASS Result 2 of 2 sensors calibrated from 1 session.",
        "warn above 5 fail above 20",
        "board 2.0 m away, its face turned 40° left as the sensor sees it 2.4 mm 1.6 mm",
        "roll, ° −90.0000 −90.0000 0.0057 0.0000",
        "x, mm 226.0 200.0 1.3 −26.0",
        "Rejected: 5 % , 299 of 5 977 candidates",
        "4 of 100 cells of the image",
        "4 of 36 sectors of azimuth, elevation −18 to 2.3°",
        "placements 12",
        "views 34",
        "rejected 5 %",
        "residual rms 12.3 mm",
        "residual rms 0.0123 px",
        "change from the initial guess 50 mm, 2°",
        "least certain: translation along z of the robot body, σ 3 mm",
        "the point (1, 0, 0) m of top is at (1.0660, 0.4500, 0.6000) m in the robot frame",
        "T_left_top",
        "Not estimated: time offset of left, intrinsics of left, time offset of top, "
        "mount of board in its MCS body, mount of pipe in its MCS body.",
        "3 × repeated",
        "not kept: 1 not still",
        "poses were multiplied by 1.25",
        "left pattern corner 0.05 0.04 px 0.8",
        "s1, view 0: board, placement 0",
        "s1.mcap 123456 00ffab",
        "numpy 2.4.6",
        "T_robot_left, from frame left_frame into mcs/robot",
    ],
)
def test_says(good_report_page, said):
    assert said in extract_page_text(good_report_page)


def test_is_complete_in_itself(good_report_page):
    good_report_page = remove_plotly(good_report_page)
    assert "http" not in good_report_page
    assert not re.search(r"<script[^>]*\ssrc", good_report_page)
    references = re.findall(r"""(?:src|href)\s*=\s*["']([^"']*)""", good_report_page)
    assert references
    assert all(r.startswith(("#", "data:image/")) for r in references)
    assert all(u.startswith("#") for u in re.findall(r"url\(([^)]*)\)", good_report_page))
    assert "@import" not in good_report_page


def test_ids_that_figures_refer_to_are_their_own(good_report_page):
    ids = re.findall(r'\sid="([^"]*)"', good_report_page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]*)"', good_report_page)) <= set(ids)


def test_follows_light_and_dark(good_report_page):
    assert "prefers-color-scheme: dark" in good_report_page
    assert "@media print" in good_report_page
    # No figure has a colour of the light page of its own.
    drawn = "".join(re.findall("<svg.*?</svg>", good_report_page, flags=re.S))
    assert "var(--ink)" in drawn
    assert not re.search("|".join(THEME_VARIABLES), drawn)


def test_same_inputs_same_bytes(good_report_folder, report_files):
    report.main(report_files.write_inputs())
    for name in ("report.html", "report.pdf", *(f"{figure}.svg" for figure in FIGURE_COLUMNS)):
        assert (report_files.folder / name).read_bytes() == (
            good_report_folder / name
        ).read_bytes(), name


def test_every_figure_has_a_caption(good_report_page):
    good_report_page = remove_plotly(good_report_page)
    assert good_report_page.count("<figure") == good_report_page.count("<figcaption>") > 10
    assert good_report_page.count('role="img"') == good_report_page.count("<svg")


def test_every_figure_is_an_xml_of_its_own_or_paper_would_leave_it_out(good_report_page):
    for svg in re.findall("<svg.*?</svg>", remove_plotly(good_report_page), flags=re.S):
        ElementTree.fromstring(make_standalone_svg(svg))


def test_a_figure_with_an_empty_group_is_well_formed():
    """Matplotlib writes <g/> for what lies outside of the axes."""
    fig, ax = create_figure()
    ax.broken_barh([], (0, 1))
    ax.plot([np.nan], [np.nan])
    ax.scatter([], [])
    svg = encode_figure_svg(fig, "empty", "Nothing")
    assert ElementTree.fromstring(make_standalone_svg(svg)).tag.endswith("svg")


def test_title(report_files, skip_figures):
    report_files.options["report"]["title"] = "Husky & trailer"
    assert "<h1>Husky &amp; trailer</h1>" in report_files.render_report()


def test_the_pdf_is_small_and_knows_no_clock(good_report_folder):
    pdf = (good_report_folder / "report.pdf").read_bytes()
    assert pdf.startswith(b"%PDF") and b"CreationDate" not in pdf
    assert 50_000 < len(pdf) < 5_000_000


@pytest.mark.parametrize("name", FIGURE_COLUMNS)
def test_figures_are_files_that_open_without_a_page(good_report_folder, name):
    root = ElementTree.parse(good_report_folder / f"{name}.svg").getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert "var(" not in (good_report_folder / f"{name}.svg").read_text()
    assert root.findall("{http://www.w3.org/2000/svg}svg")


@pytest.mark.parametrize(
    ("x", "shown"),
    [(1234.5, "1230"), (-0.0123456, "−0.0123"), (4.9e-6, "4.90e−6"), (None, "–"), (np.nan, "–")],
)
def test_numbers(x, shown):
    assert format_number(x) == shown


def test_fixed_has_no_negative_zero():
    assert format_decimals(-0.001, 2) == "0.00"
    assert [choose_decimals(s) for s in (12.0, 0.15, 0.0021, 0.0)] == [0, 2, 4, 2]
    assert [floor_to_nice_number(x) for x in (1.0, 3.0, 70.0, 0.03)] == [1, 2, 50, 0.02]
