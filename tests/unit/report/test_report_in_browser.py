"""The report in a real browser, opened from disk with the network off."""

import cv2
import numpy as np
import pytest

from helpers.browser import CHROMIUM, CHROMIUM_MISSING, Browser

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason=CHROMIUM_MISSING)
DRAWN = """new Promise((done, fail) => {
  const late = setTimeout(() => fail(new Error("not drawn in time")), 60000);
  const look = () => document.getElementById("scene-view").dataset.drawn
    ? (clearTimeout(late), done(true)) : setTimeout(look, 50);
  look();
})"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """One Chromium for all tests of this file."""
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture
def opened(browser, good_report_folder):
    """The browser with the report of a good run open, and nothing noted before."""
    browser.requested_urls.clear()
    browser.page_errors.clear()
    browser.open_page(good_report_folder / "report.html")
    return browser


def test_nothing_is_asked_of_the_network_and_nothing_complains(opened, good_report_folder):
    opened.evaluate_js(DRAWN)
    asked = [url for url in opened.requested_urls if not url.startswith(("data:", "blob:"))]
    assert asked == [f"file://{good_report_folder}/report.html"]
    assert opened.page_errors == []


def test_a_request_that_leaves_and_an_error_would_be_noticed(browser, tmp_path):
    page = tmp_path / "bad.html"
    page.write_text('<img src="http://127.0.0.1:1/x.png"><script>throw Error("wrong")</script>')
    browser.requested_urls.clear()
    browser.page_errors.clear()
    browser.open_page(page)
    assert any(url.startswith("http:") for url in browser.requested_urls)
    assert any("wrong" in said for said in browser.page_errors)


def test_every_image_is_decoded(opened):
    """Those inside of SVG are decoded one by one; a broken one would reject."""
    count = opened.evaluate_js("""Promise.all(
    [...document.querySelectorAll("svg image")].map((image) => {
      const copy = new Image();
      copy.src = image.href.baseVal;
      return copy.decode().then(() => copy.naturalWidth);
    })).then((widths) => widths.filter((width) => width > 0).length)""")
    assert count == opened.evaluate_js('document.querySelectorAll("svg image").length') > 5
    assert opened.evaluate_js("document.images.length") == 0


def test_the_3d_view_is_drawn_and_turns_to_the_first_guess(opened):
    opened.evaluate_js(DRAWN)
    assert opened.evaluate_js('document.getElementById("scene-still").hidden')
    drawn = "document.getElementById('scene-view').data.find((t) => t.name === 'top').x[0]"
    result = opened.evaluate_js(drawn)
    opened.evaluate_js("""document.querySelector('[data-by="guess"]').click()""")
    assert abs(opened.evaluate_js(drawn) - result) > 0.01
    box = opened.evaluate_js("""(() => {
      const r = document.querySelector("#scene-view canvas").getBoundingClientRect();
      return [r.left + scrollX, r.top + scrollY, r.width, r.height];
    })()""")
    picture = cv2.imdecode(np.frombuffer(opened.take_screenshot(box), np.uint8), cv2.IMREAD_COLOR)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50


def test_without_webgl_the_still_picture_stays(good_report_folder, tmp_path):
    with Browser(tmp_path, "--disable-3d-apis") as without:
        without.open_page(good_report_folder / "report.html")
        assert without.evaluate_js('document.createElement("canvas").getContext("webgl")') is None
        assert not without.evaluate_js('document.getElementById("scene-still").hidden')
        assert without.evaluate_js('document.getElementById("scene-view").hidden')
        assert without.evaluate_js('document.querySelector("#scene-still svg").clientHeight') > 100
        assert without.page_errors == []


def test_tables_sort_both_ways_by_number_and_by_name(opened):
    table = 'document.querySelectorAll("#residuals table.split")[1]'

    def sorted_by(column):
        """The cells of a column after a click on its head."""
        opened.evaluate_js(f"{table}.tHead.rows[0].cells[{column}].click()")
        cells = f"[...{table}.tBodies[0].rows].map((row) => row.cells[{column}].textContent)"
        return opened.evaluate_js(cells)

    up = [int(v) for v in sorted_by(3)]
    assert up == sorted(up) and len(set(up)) > 3
    down = [int(v) for v in sorted_by(3)]
    assert down == up[::-1]
    names = sorted_by(1)
    assert names == sorted(names) and len(set(names)) > 3
    sigmas = [float(v.replace("−", "-")) for v in sorted_by(7)]
    assert sigmas == sorted(sigmas) and sigmas[0] < 0 < sigmas[-1]


CONTRAST = """() => {
  const level = (c) => c / 255 <= 0.03928 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => 0.2126 * level(r) + 0.7152 * level(g) + 0.0722 * level(b);
  const parse = (text) => text.match(/[\\d.]+/g).map(Number);
  const ground = (e) => {
    for (; e; e = e.parentElement) {
      const c = parse(getComputedStyle(e).backgroundColor);
      if (c.length < 4 || c[3] > 0) return c;
    }
    return [255, 255, 255];
  };
  let worst = [99, ""];
  const all = "h1, h2, h3, p, td, th, li, dd, dt, a, b, small, summary, figcaption, pre, .badge";
  for (const e of document.querySelectorAll(all + ", button, svg.plot text")) {
    const style = getComputedStyle(e);
    if (!e.textContent.trim() || !e.getClientRects().length || e.closest("#scene-view")) continue;
    const ink = parse(e.tagName === "text" ? style.fill : style.color);
    const [a, b] = [light(ink), light(ground(e))].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < worst[0]) worst = [ratio, e.outerHTML.slice(0, 200)];
  }
  return worst;
}"""


@pytest.mark.parametrize("dark", [False, True])
def test_text_is_legible_in_both_themes(browser, good_report_folder, dark):
    """Contrast by WCAG: 4.5 or more of all text, also of that in figures."""
    browser.open_page(good_report_folder / "report.html", dark=dark)
    ratio, where = browser.evaluate_js(f"({CONTRAST})()")
    assert ratio >= 4.5, where


def test_the_theme_can_be_chosen(opened):
    ground = "getComputedStyle(document.body).backgroundColor"
    light = opened.evaluate_js(ground)
    opened.evaluate_js('document.getElementById("theme").click()')
    assert opened.evaluate_js(ground) != light
    opened.evaluate_js('document.getElementById("theme").click()')
    assert opened.evaluate_js(ground) == light


def test_a_phone_never_scrolls_sideways(browser, good_report_folder):
    browser.open_page(good_report_folder / "report.html", width=390, height=844, mobile=True)
    assert browser.evaluate_js("document.documentElement.scrollWidth") == 390


def test_navigation_leads_to_every_section(opened):
    there = opened.evaluate_js("""[...document.querySelectorAll("nav a")].map((a) =>
      document.querySelector(a.getAttribute("href")).tagName)""")
    assert there == ["SECTION"] * 15
