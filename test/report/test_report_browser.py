"""The report in a real browser: it loads, it draws, pairs can be chosen, and it reads in every light and width."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from places import PROJECT_ROOT
from report_cases import REFUSED, REJECTED, judged, write_run

from svc_ros.io.results import read_jsonl, result_to_json
from svc_ros.report.report import write_report, write_view
from svc_ros.report.scenes import make_scene
from svc_ros.simulation import DriveConfig, simulate_drive

sys.path.insert(0, str(PROJECT_ROOT / "tools"))
from chromium import Chromium, find_chromium

pytest.importorskip("websocket", reason="websocket-client not installed: pip install 'svc_ros[test]'")
pytest.importorskip("plotly", reason="plotly not installed: pip install 'svc_ros[report]'")
pytestmark = pytest.mark.skipif(find_chromium() is None, reason="no Chromium found: apt-get install chromium")

DESKTOP, PHONE = (1280, 900), (390, 844)
RED_LINES = """(() => {
  const trace = document.getElementById("view3d").data.find((t) => t.name === "blocked");
  return {num: trace.x.filter((x) => x !== null).length / 2, colour: trace.line.color, visible: trace.visible};
})()"""
RED_POINTS = """(() => {
  const trace = document.getElementById("view3d").data.find((t) => t.name === "denied");
  return {num: trace.x.length, colour: trace.marker.color, visible: trace.visible};
})()"""
BLOCKED_LIGHT, BLOCKED_DARK = "#e02020", "#ff5a5a"
RINGED = ("timeline", "evidence", "map")
OVERLAP = "window.svcReport.data.decisions.overlap[{}]"
CHOSEN = "window.svcReport.chosen()"


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_report(folder / "report.html", folder, write_run(folder))
    return folder / "report.html"


@pytest.fixture(scope="module")
def browser():
    with Chromium() as chromium:
        yield chromium


@pytest.fixture
def opened(browser, page):
    """The report in a light and wide window, with every switch where it is at the start."""
    browser.prefer("light")
    browser.resize(*DESKTOP)
    if browser.evaluate("location.href") != page.as_uri():
        load(browser, page)
    browser.evaluate(
        "document.querySelector('#theme input[value=auto]').click();"
        "document.querySelectorAll('#layers input:not(:checked)').forEach((box) => box.click());"
        "document.activeElement.blur(); window.scrollTo({top: 0, behavior: 'instant'});"
    )
    set_filter(browser, "all")
    browser.settle()
    yield browser
    assert browser.complaints == []


def load(browser: Chromium, page: Path) -> Chromium:
    browser.open(page)
    browser.wait_for("window.svcReport && window.svcReport.ready && document.querySelector('#view3d canvas')")
    browser.settle()
    return browser


def set_filter(browser: Chromium, verdict: str) -> None:
    browser.evaluate(
        f"(() => {{ const f = document.getElementById('filter'); f.value = '{verdict}';"
        " f.dispatchEvent(new Event('change')); })()"
    )


def picture_of(browser: Chromium, selector: str) -> np.ndarray:
    """RGB (H, W, 3) of the part of the window that an element covers."""
    from PIL import Image

    browser.evaluate(f"document.querySelector('{selector}').scrollIntoView({{behavior: 'instant', block: 'center'}})")
    browser.settle()
    box = browser.evaluate(
        f"(() => {{ const b = document.querySelector('{selector}').getBoundingClientRect();"
        " return [b.left, b.top, b.right, b.bottom].map(Math.round); })()"
    )
    return np.asarray(Image.open(io.BytesIO(browser.picture())).convert("RGB").crop(tuple(box)), np.int64)


def reddish(picture: np.ndarray) -> int:
    red, green, blue = np.moveaxis(picture, -1, 0)
    return int(((red > 130) & (red > 1.7 * green) & (red > 1.7 * blue)).sum())


def brightness(browser: Chromium) -> float:
    return float(picture_of(browser, "#timeline").mean())


def choose(browser: Chromium, index: int) -> None:
    """As a person does it: by the selector."""
    browser.evaluate(
        f"(() => {{ const s = document.getElementById('pair'); s.value = '{index}';"
        " s.dispatchEvent(new Event('change', {bubbles: true})); })()"
    )
    browser.settle()


def test_it_loads_without_a_complaint_and_asks_nobody(browser, page):
    browser.resize(*DESKTOP)
    load(browser, page)
    assert browser.complaints == []
    asked = [url for url in browser.requests if not url.startswith(("data:", "blob:"))]
    assert asked == [page.as_uri()]


def test_every_plot_has_drawn_something(opened):
    for name in ("timeline", "evidence", "map", "times", "view3d"):
        assert opened.evaluate(f"document.querySelectorAll('#{name} svg, #{name} canvas').length") > 0, name
        assert opened.evaluate(f"document.getElementById('{name}').data.length") > 0, name
        assert opened.evaluate(f"document.getElementById('{name}').getAttribute('aria-label').length") > 20, name


def test_the_selector_chooses_a_rejected_pair_with_red_sight_lines_in_its_data(opened):
    choose(opened, 0)
    assert opened.evaluate(CHOSEN) == 0
    few = opened.evaluate(RED_LINES)["num"]
    choose(opened, REJECTED)
    assert opened.evaluate(f"window.svcReport.scene({REJECTED}).verdict") == "rejected"
    lines = opened.evaluate(f"window.svcReport.scene({REJECTED}).target.blocked.length") / 3
    lines += opened.evaluate(f"window.svcReport.scene({REJECTED}).source.blocked.length") / 3
    source, target, results = judged()
    assert lines == make_scene(0, source, target, results[REJECTED]).num_blocked_drawn
    drawn = opened.evaluate(RED_LINES)
    assert drawn["num"] == lines > max(100, few)
    assert drawn["colour"] == BLOCKED_LIGHT
    points = opened.evaluate(RED_POINTS)
    assert points["num"] == make_scene(0, source, target, results[REJECTED]).num_denied_drawn > 100
    assert points["colour"] == BLOCKED_LIGHT
    assert "rejected" in opened.evaluate("document.getElementById('facts').textContent")
    announced = opened.evaluate("document.getElementById('announced').textContent")  # what a screen reader says
    assert announced.startswith(f"Decision {REJECTED}, rejected: one scan has surface")
    assert "where the other sensor looked through" in opened.evaluate("document.getElementById('facts').textContent")


def test_the_page_unpacks_the_coordinates_that_were_packed(opened):
    source, target, results = judged()
    scene = make_scene(REJECTED, source, target, results[REJECTED])
    for side in ("target", "source"):
        for part in ("points", "clear", "blocked", "denied"):
            unpacked = opened.evaluate(f"[...window.svcReport.scene({REJECTED}).{side}.{part}]")
            np.testing.assert_allclose(np.reshape(unpacked, (-1, 3)), getattr(getattr(scene, side), part), atol=0.01)


def test_the_canvas_is_not_blank_and_shows_red_lines_of_the_rejected_pair(opened):
    choose(opened, REJECTED)
    wrong = picture_of(opened, "#view3d")
    background = wrong[20, 20]
    assert (np.abs(wrong - background).sum(-1) > 60).mean() > 0.02
    choose(opened, 0)
    right = picture_of(opened, "#view3d")
    assert reddish(wrong) > 5 * reddish(right)
    assert reddish(wrong) > 500


def test_a_layer_can_be_taken_away(opened):
    choose(opened, REJECTED)
    before = reddish(picture_of(opened, "#view3d"))
    for name, what in (("blocked", RED_LINES), ("denied", RED_POINTS)):
        opened.evaluate(f"document.querySelector('#layers input[name={name}]').click()")
        assert opened.evaluate(what)["visible"] is False
    assert reddish(picture_of(opened, "#view3d")) < 0.1 * before
    choose(opened, 0)
    assert opened.evaluate(RED_LINES)["visible"] is False  # and stays away


def test_keys_go_through_the_pairs(opened):
    choose(opened, 0)
    for key, expected in (("n", 1), ("n", 2), ("p", 1), ("p", 0), ("p", 0)):
        opened.press(key)
        assert opened.evaluate(CHOSEN) == expected
    assert opened.evaluate("document.getElementById('previous').disabled")


def test_the_tab_key_reaches_the_selector_and_shows_where_it_is(browser, page):
    opened = load(browser, page)  # only then the key begins at the top
    reached = []
    for _ in range(12):
        opened.press("Tab")
        reached.append(opened.evaluate("document.activeElement.id || document.activeElement.className"))
    assert reached[0] == "skip"
    assert reached.index("pair") < reached.index("view3d")
    opened.evaluate("document.getElementById('pair').focus()")
    opened.press("Tab")  # the outline is for keys, not for clicks
    assert opened.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"


def test_arrow_keys_turn_the_picture(opened):
    eye = "JSON.stringify(document.getElementById('view3d').layout.scene.camera.eye)"
    before = opened.evaluate(eye)
    opened.evaluate("document.getElementById('view3d').focus({preventScroll: true})")
    opened.press("ArrowLeft")
    assert opened.evaluate(eye) != before


def test_the_filter_leaves_one_verdict(opened):
    choose(opened, 0)
    set_filter(opened, "accepted")
    assert opened.evaluate("[...document.querySelectorAll('#pair option')].map((o) => Number(o.value))") == [0, 2]
    assert opened.evaluate(CHOSEN) == 0


def test_the_table_chooses_too_and_says_what_was_not_kept(opened):
    rows = opened.evaluate(
        "[...document.querySelectorAll('table.worst tbody tr[data-line]')].map((r) => [r.dataset.line, r.textContent])"
    )
    texts = {int(line): text for line, text in rows}
    assert "too few points after range crop" in texts[REFUSED].lower()
    assert "not kept" in texts[REFUSED]
    choose(opened, 0)
    opened.evaluate(f"document.querySelector('tr[data-line=\"{REJECTED}\"] button').click()")
    assert opened.evaluate(CHOSEN) == REJECTED


def ring_places(browser: Chromium) -> list[float]:
    """Where the ring around the chosen decision is on the axis to the right of each plot that has one."""
    shapes = [browser.evaluate(f"document.getElementById('{name}').layout.shapes[0]") for name in RINGED]
    assert all(shape["visible"] for shape in shapes)
    return [shape["xanchor"] for shape in shapes]


def test_a_click_on_a_decision_in_a_plot_chooses_it(opened):
    choose(opened, 0)
    assert ring_places(opened) == pytest.approx([0.0, opened.evaluate(OVERLAP.format(0)), 2.0])
    opened.evaluate("window.scrollTo({top: 0, behavior: 'instant'})")
    place = opened.evaluate(
        "(() => { const g = document.getElementById('timeline'), b = g.getBoundingClientRect(), l = g._fullLayout;"
        f" const d = window.svcReport.data.decisions, k = d.line.indexOf({REJECTED});"
        " return [b.left + l.xaxis._offset + l.xaxis.d2p(d.time_s[k]),"
        " b.top + l.yaxis._offset + l.yaxis.d2p(d.probability[k])]; })()"
    )
    opened.click(*place)
    opened.wait_for(f"{CHOSEN} === {REJECTED}")
    # After a second, the overlap of the decision, and half way between the two places, 4 m and 8 m.
    assert ring_places(opened) == pytest.approx([1.0, opened.evaluate(OVERLAP.format(REJECTED)), 6.0])


def test_dark_and_light_follow_the_system_and_the_switch(opened, browser):
    assert brightness(opened) > 200
    browser.prefer("dark")
    assert brightness(opened) < 70
    assert opened.evaluate(RED_LINES)["colour"] == BLOCKED_DARK
    opened.evaluate("document.querySelector('#theme input[value=light]').click()")
    assert brightness(opened) > 200
    assert opened.evaluate(RED_LINES)["colour"] == BLOCKED_LIGHT
    browser.prefer("light")
    opened.evaluate("document.querySelector('#theme input[value=dark]').click()")
    assert brightness(opened) < 70
    assert opened.evaluate(RED_LINES)["colour"] == BLOCKED_DARK


@pytest.mark.parametrize("width", [320, PHONE[0]])
def test_a_phone_needs_no_sideways_scrolling(browser, page, width):
    browser.resize(width, PHONE[1], phone=True)
    load(browser, page)
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    wide = browser.evaluate(
        "[...document.querySelectorAll('main *')].filter((e) => !e.closest('.plot, .view3d, pre, thead')"
        f" && e.getBoundingClientRect().right > {width} + 1 && getComputedStyle(e).position !== 'absolute')"
        ".map((e) => e.id || e.className || e.tagName)"
    )
    assert wide == []
    choose(browser, REJECTED)
    assert reddish(picture_of(browser, "#view3d")) > 200
    assert browser.complaints == []


def test_a_view_shows_its_one_pair(browser, tmp_path):
    source, target, results = judged()
    scene = make_scene(0, source, target, results[REJECTED])
    write_view(tmp_path / "view.html", result_to_json(results[REJECTED]), scene, "scan_1.pcd onto scan_0.pcd")
    browser.prefer("light")
    browser.resize(*DESKTOP)
    load(browser, tmp_path / "view.html")
    assert browser.evaluate("document.querySelector('h1').textContent") == "scan_1.pcd onto scan_0.pcd"
    assert browser.evaluate(RED_LINES)["num"] == scene.num_blocked_drawn
    assert browser.evaluate("document.getElementById('timeline').clientHeight") == 0
    assert browser.complaints == []


@pytest.mark.slow
def test_the_report_that_a_replay_writes(browser, tmp_path):
    """From a bag to red lines on the screen: the carrier is put elsewhere after its second scan."""
    drive = simulate_drive(tmp_path, DriveConfig(num_scans=4, sensor="VLP-16", teleport_after=1))
    out = tmp_path / "out"
    done = run("replay", drive.bag, "--reference", drive.reference, "--out", out)
    assert done.exit_code == 0, done.output
    browser.resize(*DESKTOP)
    load(browser, out / "report.html")
    assert (out / "report.html").stat().st_size < 15e6
    verdicts = [record["verdict"] for record in read_jsonl(out / "decisions.jsonl")]
    assert verdicts == ["accepted", "rejected", "accepted"]
    assert browser.evaluate("window.svcReport.indices()") == [0, 1, 2]
    choose(browser, 1)
    scene = browser.evaluate(
        "(() => { const s = window.svcReport.scene(1);"
        " return [s.verdict, s.target.blocked.length + s.source.blocked.length]; })()"
    )
    assert scene[0] == "rejected"
    assert scene[1] / 3 == browser.evaluate(RED_LINES)["num"] > 50
    assert browser.evaluate("document.getElementById('notes').hidden")
    assert browser.complaints == []


def test_a_run_without_anything_loads_and_says_so(browser, tmp_path):
    write_report(tmp_path / "report.html", tmp_path, [])
    browser.resize(*DESKTOP)
    browser.open(tmp_path / "report.html")
    browser.wait_for("window.svcReport && window.svcReport.ready")
    assert "decisions.jsonl is not in the folder" in browser.evaluate("document.getElementById('notes').textContent")
    assert browser.complaints == []
