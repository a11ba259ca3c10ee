"""The measured tables of the README and the pages are what benchmarks/tables.py makes of the results."""

from __future__ import annotations

import copy
import json
import re

import numpy as np
import pytest
from pages import module_from
from places import PROJECT_ROOT

from svc_ros.core.sight.seen_surface import look_through

PAGE = PROJECT_ROOT / "docs" / "how_it_decides.md"
BENCHMARKS = PROJECT_ROOT / "docs" / "benchmarks.md"


@pytest.fixture(scope="module")
def tables():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(PROJECT_ROOT / "benchmarks"))
        yield module_from(PROJECT_ROOT / "benchmarks" / "tables.py")


@pytest.fixture(scope="module")
def results(tables):
    return tables.read_results(tables.RESULTS)


def test_the_pages_are_what_the_command_writes(tables, results):
    for page in tables.PAGES:
        text = page.read_text("utf-8")
        assert tables.fill(text, results) == text, f"{page.name} is out of date: python benchmarks/tables.py"


def test_every_section_has_a_place(tables):
    text = "".join(page.read_text("utf-8") for page in tables.PAGES)
    assert [name for name in tables.SECTIONS if f"<!-- {name} -->" not in text] == []


def test_changed_results_change_the_tables(tables, results):
    changed = copy.deepcopy(results)
    decision, registration = changed["decision"], changed["registration"]
    decision["decision"]["recorded sets"]["svc"]["num_false_accepted"] = 987
    decision["decision"]["simulated rooms"]["svc"]["num_false_accepted"] = 54
    answer = {"dataset": "new", "overlap": 0.05, "method": "svc", "accepted": True, "correct": True}
    registration["pairs"] += [answer] * 33 + [{**answer, "correct": False}] * 11
    before = tables.fill(BENCHMARKS.read_text("utf-8"), results)
    written = tables.fill(PAGE.read_text("utf-8"), changed)
    assert f"| nothing | {decision['decision']['recorded sets']['svc']['f1']:.3f} | 987 |" in written
    assert f"54 of {decision['decision']['simulated rooms']['svc']['num_wrong']}<!-- /rooms accepted -->" in written
    low = [r for r in results["registration"]["pairs"] if r["method"] == "svc" and (r["overlap"] or 1.0) < 0.1]
    assert f"| `svc` | {sum(r['correct'] for r in low) + 33} of {len(low) + 44} |" in written
    assert tables.fill(written, results) == PAGE.read_text("utf-8")
    assert "| new | 44 | 33, **11 wrong** |" in tables.fill(before, changed)


def test_times_are_those_of_the_last_comparison(tables):
    measured = {"time_ms_p50": 123.4, "ratio_vs_kiss_matcher": 0.456, "recall": 0.5, "pairs": 8}
    latest = dict.fromkeys(("verify", "kiss_matcher", "open3d_ransac"), measured)
    latest["register"] = {**measured, "reused": {**measured, "time_ms_p50": 99.6}}
    table = tables.times_table({"latest": latest})
    assert "| `register` | 123 | 0.46 | 4 of 8 |" in table
    assert "| `register`, target described before | 100 |" in table


def test_borders_are_those_of_the_presets(tables, results):
    table = tables.borders_table(results)
    assert "| `decision.slip_m` | 2.4 / 0.9 |" in table
    assert not [name for name in tables.WEIGHTS if f"decision.{name}`" in table]


def test_the_weights_of_the_page_are_those_of_the_stored_run(tables, results):
    configured = results["decision"]["weights"]["configured"]
    told = re.findall(r"^\| `decision\.(\w+)` \|[^|]+\| ([-\d.]+) \|", tables.weights_table(results), re.MULTILINE)
    assert {name: float(value) for name, value in told} == configured


def test_an_open_mark_is_refused(tables, results):
    with pytest.raises(ValueError, match="expected as many <!-- /margins -->"):
        tables.fill("<!-- margins -->\n| a |", results)


def test_out_of_date_pages_are_told(tables, results, tmp_path, monkeypatch, capsys):
    page = tmp_path / "page.md"
    page.write_text("of <!-- rooms accepted -->old<!-- /rooms accepted --> pairs")
    monkeypatch.setattr(tables, "PAGES", (page,))
    assert tables.main(["--check"]) == 1
    assert "old" in page.read_text()
    assert "out of date" in capsys.readouterr().out
    assert tables.main([]) == 0
    assert re.fullmatch(r"of <!-- rooms accepted -->\d+ of \d+<!-- /rooms accepted --> pairs", page.read_text())
    assert tables.main(["--check"]) == 0


def test_missing_results_are_named(tables, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(tables, "RESULTS", tmp_path)
    assert tables.main([]) == 2
    assert "decision.json" in capsys.readouterr().err
    (tmp_path / "decision.json").write_text(json.dumps({}))
    assert tables.main([]) == 2


@pytest.mark.slow
def test_the_picture_is_drawn_from_the_configuration(tmp_path):
    pictures = module_from(PROJECT_ROOT / "tools" / "decision_pictures.py")
    pictures.draw_border(tmp_path / "border.png")
    assert (tmp_path / "border.png").read_bytes().startswith(b"\x89PNG")
    config = pictures.preset("lidar_outdoor").decision
    small, wide = (pictures.probabilities(config, share) for share in pictures.CLUSTERS.values())
    assert small[0, -1] > 0.5 > small[-1, 0]  # hardly denied and held firmly; much denied and held by next to nothing
    assert (small >= wide).all()


def test_the_picture_of_denied_surface_tells_the_classes_of_the_library():
    pictures = module_from(PROJECT_ROOT / "tools" / "decision_pictures.py")
    config = pictures.preset("lidar_outdoor")
    source, target, T = pictures.simulated_pair(config)
    placement = pictures.place(target, source, T, config.sight_view)
    classes, whole = pictures.classify(target, placement, config), look_through(target, placement, config.sight_view)
    counts = {kind: int((classes == kind).sum()) for kind in pictures.CLASSES}
    assert [counts[kind] for kind in ("confirmed", "denied", "hidden", "unseen")] == [
        whole.num_confirmed, whole.num_denied, whole.num_hidden, whole.num_unseen,
    ]  # fmt: skip
    assert set(np.flatnonzero(classes == "denied")) == set(whole.denied_idx.tolist())
