"""The report of a good run: what it says, and that it is complete, in both themes and on paper."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

import report
from calib.report import number_format
from calib.report.figures import svg_plots
from reporting import own, words


def test_sections_come_in_order(page):
    found = re.findall(r"<h2>(\d+) ([^<]*)<", page)
    assert found == [(str(i), h) for i, (_, h) in enumerate(report.SECTIONS, 1)]
    assert len(found) == 15


@pytest.mark.parametrize(
    "said",
    [
        "PASS Found 2 of 2 sensors calibrated from 1 session.",
        "warn above 5 fail above 20",
        "board 2.0 m away, its face turned 40° left as the sensor sees it 2.4 mm 1.6 mm",
        "roll, ° −90.0000 −90.0000 0.0057 0.0000",
        "x, mm 226.0 200.0 1.3 −26.0",
        "Rejected: 5 % , 299 of 5 977 candidates",
        "4 of 100 cells of the image",
        "4 of 36 sectors of azimuth, elevation −18 to 2.3°",
        "placements 12",
        "observations 34",
        "rejected 5 %",
        "residual rms 12.3 mm",
        "residual rms 0.0123 px",
        "change from the first guess 50 mm, 2°",
        "least certain: translation along z of the robot body, σ 3 mm",
        "the point (1, 0, 0) m of top lies at (1.0660, 0.4500, 0.6000) m in the robot frame",
        "T_left_top",
        "Not estimated: time offset of left, intrinsics of left, time offset of top, "
        "alignment of board in its MCS body, alignment of pipe in its MCS body.",
        "3 × repeated",
        "not kept: 1 not still",
        "widened by a factor of 1.25",
        "left corner 0.05 0.04 px 0.8",
        "s1, view 0: board, placement 0",
        "s1.mcap 123456 00ffab",
        "numpy 2.4.6",
        "T_robot_left, from frame left_frame into mcs/robot",
    ],
)
def test_says(page, said):
    assert said in words(page)


def test_is_complete_in_itself(page):
    page = own(page)
    assert "http" not in page
    assert not re.search(r"<script[^>]*\ssrc", page)
    references = re.findall(r"""(?:src|href)\s*=\s*["']([^"']*)""", page)
    assert references
    assert all(r.startswith(("#", "data:image/")) for r in references)
    assert all(u.startswith("#") for u in re.findall(r"url\(([^)]*)\)", page))
    assert "@import" not in page


def test_ids_that_figures_refer_to_are_their_own(page):
    ids = re.findall(r'\sid="([^"]*)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]*)"', page)) <= set(ids)


def test_follows_light_and_dark(page):
    assert "prefers-color-scheme: dark" in page
    assert "@media print" in page
    # No figure has a colour of the light page of its own.
    drawn = "".join(re.findall("<svg.*?</svg>", page, flags=re.S))
    assert "var(--ink)" in drawn
    assert not re.search("|".join(svg_plots.THEME), drawn)


def test_same_inputs_same_bytes(printed, files):
    report.main(files.write())
    for name in ("report.html", "report.pdf", *(f"{figure}.svg" for figure in report.COLUMNS)):
        assert (files.folder / name).read_bytes() == (printed / name).read_bytes(), name


def test_every_figure_has_a_caption(page):
    page = own(page)
    assert page.count("<figure") == page.count("<figcaption>") > 10
    assert page.count('role="img"') == page.count("<svg")


def test_every_figure_is_an_xml_of_its_own_or_paper_would_leave_it_out(page):
    for svg in re.findall("<svg.*?</svg>", own(page), flags=re.S):
        ElementTree.fromstring(svg_plots.alone(svg))


def test_a_figure_with_an_empty_group_is_well_formed():
    """Matplotlib writes <g/> for what lies outside of the axes."""
    fig, ax = svg_plots.figure()
    ax.broken_barh([], (0, 1))
    ax.plot([np.nan], [np.nan])
    ax.scatter([], [])
    svg = svg_plots.to_svg(fig, "empty", "Nothing")
    assert ElementTree.fromstring(svg_plots.alone(svg)).tag.endswith("svg")


def test_title(files, undrawn):
    files.options["report"]["title"] = "Husky & trailer"
    assert "<h1>Husky &amp; trailer</h1>" in files.render()


def test_the_pdf_is_small_and_knows_no_clock(printed):
    pdf = (printed / "report.pdf").read_bytes()
    assert pdf.startswith(b"%PDF") and b"CreationDate" not in pdf
    assert 50_000 < len(pdf) < 5_000_000


@pytest.mark.parametrize("name", report.COLUMNS)
def test_figures_are_files_that_open_without_a_page(printed, name):
    root = ElementTree.parse(printed / f"{name}.svg").getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert "var(" not in (printed / f"{name}.svg").read_text()
    assert root.findall("{http://www.w3.org/2000/svg}svg")


@pytest.mark.parametrize(
    ("x", "shown"),
    [(1234.5, "1230"), (-0.0123456, "−0.0123"), (4.9e-6, "4.90e−6"), (None, "–"), (np.nan, "–")],
)
def test_numbers(x, shown):
    assert number_format.number(x) == shown


def test_fixed_has_no_negative_zero():
    assert number_format.fixed(-0.001, 2) == "0.00"
    assert [number_format.places(s) for s in (12.0, 0.15, 0.0021, 0.0)] == [0, 2, 4, 2]
    assert [number_format.nice(x) for x in (1.0, 3.0, 70.0, 0.03)] == [1, 2, 50, 0.02]
