"""The report without a browser: what is read, what is counted, what is left out and said so, and the file itself."""

from __future__ import annotations

import base64
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from places import PROJECT_ROOT
from report_cases import DATA, REFUSED, REJECTED, START_NS, data_of, judged, way, write_run

from svc_ros.core import se3
from svc_ros.core.config import preset, with_values
from svc_ros.core.decision import decide
from svc_ros.core.errors import InputError, MissingDependencyError
from svc_ros.core.result import Verdict
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence
from svc_ros.io.results import read_jsonl, result_to_json, write_jsonl
from svc_ros.io.trajectories import Trajectory
from svc_ros.report.data import Run, choose_drawn, read_run, verdict_of, verdict_strip, worst_decisions
from svc_ros.report.plots import decision_border, map_from_above, stage_times
from svc_ros.report.report import write_report, write_view
from svc_ros.report.scenes import make_scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("run")


@pytest.fixture(scope="module")
def page(folder) -> Path:
    write_report(folder / "report.html", folder, write_run(folder))
    return folder / "report.html"


def record(verdict: str = "accepted", **more) -> dict:
    return {"verdict": verdict, "reason": "ok", "probability": 0.9, "evidence": {}, "time_ms": {}, **more}


class TestFile:
    def test_it_is_one_file_that_asks_for_nothing(self, page):
        text = page.read_text("utf-8")
        assert page.stat().st_size < 15e6
        shell = text.replace(DATA.findall(text)[0], "")
        own = re.sub(r"/\*\*\n\* plotly\.js.*?\n</script>", "", shell, flags=re.DOTALL)
        assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!data:|#)|@import|url\(""", own)
        assert "default-src 'none'" in own
        assert text.count("plotly.js v") == 1

    def test_hostile_texts_stay_texts(self, page, folder):
        assert "3 points </script><b>" in (folder / "decisions.jsonl").read_text()
        assert data_of(page)["told"][str(REFUSED)]["detail"] == "3 points </script><b>"
        assert "</script><b>" not in page.read_text("utf-8")

    def test_a_title_is_escaped(self, tmp_path):
        source, target, results = judged()
        write_view(tmp_path / "v.html", record(), make_scene(0, source, target, results[0]), "<img src=x>")
        assert "<title>&lt;img src=x&gt; - svc_ros</title>" in (tmp_path / "v.html").read_text("utf-8")

    def test_the_same_run_gives_the_same_file(self, page, folder, tmp_path):
        scenes = write_run(tmp_path)
        write_report(tmp_path / "again.html", tmp_path, scenes)
        assert (tmp_path / "again.html").read_bytes() == page.read_bytes()

    def test_coordinates_are_true_to_a_hundredth_of_a_metre(self, page):
        source, target, results = judged()
        scene, packed = make_scene(REJECTED, source, target, results[REJECTED]), data_of(page)["scenes"][REJECTED]
        for side in ("target", "source"):
            for part in ("points", "clear", "blocked", "denied"):
                raw = np.frombuffer(base64.b64decode(packed[side][part]), "<i2").reshape(-1, 3)
                np.testing.assert_allclose(raw * packed["step_m"], getattr(getattr(scene, side), part), atol=0.01)
        assert len(raw) > 0

    def test_a_page_that_cannot_be_written_is_told(self, folder, page):
        with pytest.raises(InputError, match=r"nowhere/report\.html: cannot be written"):
            write_report(folder / "nowhere" / "report.html", folder, [])

    def test_without_plotly_the_command_to_install_it_is_told(self, folder, page, monkeypatch):
        monkeypatch.setitem(sys.modules, "plotly.offline", None)
        with pytest.raises(MissingDependencyError, match="pip install plotly"):
            write_report(folder / "other.html", folder, [])
        assert not (folder / "other.html").exists()

    def test_a_scene_of_no_decision_is_refused(self, folder, page):
        source, target, results = judged()
        with pytest.raises(InputError, match="expected decision 5 of a scene, found 5 decisions"):
            write_report(folder / "other.html", folder, [make_scene(5, source, target, results[0])])


class TestContent:
    def test_counts_title_and_summary(self, page):
        data = data_of(page)
        assert data["counts"] == {"accepted": 2, "rejected": 3, "undecided": 0, "dropped": 0}
        assert data["title"] == "bags/street"
        assert ["real_time_factor", 2.5] in data["summary"]
        assert data["notes"] == []

    def test_columns_hold_what_the_decisions_say(self, page, folder):
        data, records = data_of(page)["decisions"], read_jsonl(folder / "decisions.jsonl")
        assert data["line"] == [0, 1, 2, 3, 4]
        assert data["time_s"] == [0.0, 1.0, 2.0, 3.0, 4.0]
        wrong = records[REJECTED]["evidence"]
        assert data["denied"][REJECTED] == pytest.approx(wrong["denied_ratio"], abs=1e-5)
        assert data["denied"][REJECTED] > 100 * data["denied"][0] > 0
        assert data["overlap"][REJECTED] == pytest.approx(wrong["oriented_overlap_ratio"], abs=1e-4)
        assert data["probability"][REFUSED] is data["overlap"][REFUSED] is None

    def test_reasons_come_in_words(self, page):
        told = data_of(page)["told"]
        assert told[str(REJECTED)]["words"].startswith("one scan has surface where the other sensor looked through")
        assert told["0"]["words"].startswith("both scans see the same surfaces")
        assert told[str(REFUSED)]["words"] == "too few points after range crop and voxel grid"

    def test_decisions_that_tell_no_denied_share_are_read(self, folder, tmp_path, page):
        """Of a replay by a version that knew none, and of a method that looks for none."""
        records = read_jsonl(folder / "decisions.jsonl")
        older, other = records[0]["evidence"], records[REJECTED]["evidence"]
        for key in [key for key in older if "denied" in key or key.startswith(("num_points", "num_confirmed"))]:
            del older[key]
        other |= dict.fromkeys((key for key in other if key.startswith("num_points")), 0)
        write_jsonl(tmp_path / "decisions.jsonl", records)
        write_report(tmp_path / "report.html", tmp_path, [])
        data = data_of(tmp_path / "report.html")["decisions"]
        assert data["denied"][:2] == [None, None]
        assert None not in (*data["overlap"][:3], data["denied"][2])

    def test_an_empty_folder_gives_a_page_that_says_what_is_missing(self, tmp_path):
        write_report(tmp_path / "report.html", tmp_path, [])
        data = data_of(tmp_path / "report.html")
        names = ("decisions.jsonl", "summary.json", "trajectory_tum.txt", "config.yaml")
        assert [note.split()[0] for note in data["notes"]] == list(names)
        assert data["title"] == tmp_path.name
        assert data["map"]["way"] == data["worst"] == data["scenes"] == []

    def test_a_broken_file_is_named(self, tmp_path):
        (tmp_path / "summary.json").write_text("[1]")
        with pytest.raises(InputError, match=r"summary\.json: expected a JSON object, found list"):
            write_report(tmp_path / "report.html", tmp_path, [])

    def test_an_unknown_verdict_is_refused(self):
        with pytest.raises(InputError, match="expected a verdict, found 'perhaps'"):
            verdict_of({"verdict": "perhaps"})


class TestThinning:
    def test_few_decisions_are_all_drawn(self):
        assert choose_drawn([record()] * 7, [], 7) == list(range(7))

    def test_what_was_not_accepted_and_what_is_told_is_drawn_first(self):
        rejected = [13, 400, 999]
        records = [record("rejected" if k in rejected else "accepted") for k in range(1000)]
        drawn = choose_drawn(records, [1, 2], 100)
        assert {*rejected, 1, 2, 0, 998} <= set(drawn)
        assert 100 <= len(drawn) <= 102
        assert drawn == sorted(set(drawn))

    def test_many_rejections_leave_a_third_to_acceptances(self):
        drawn = choose_drawn([record("rejected" if k % 2 else "accepted") for k in range(1000)], [], 90)
        assert sum(k % 2 for k in drawn) == 60
        assert len(drawn) == 90

    def test_the_page_of_a_long_run_counts_all_and_draws_some(self, tmp_path):
        write_jsonl(tmp_path / "decisions.jsonl", (record(source_stamp_ns=START_NS + k) for k in range(5000)))
        write_report(tmp_path / "report.html", tmp_path, [])
        data = data_of(tmp_path / "report.html")
        assert data["counts"]["accepted"] == 5000
        assert len(data["decisions"]["line"]) < 3100


class TestStrip:
    def test_all_decisions_are_counted_where_they_belong(self):
        verdicts = ["accepted", "accepted", "rejected", "accepted"]
        stamps = [START_NS + second * 10**9 for second in (0, 1, 2, 8)]
        found = verdict_strip([record(v, source_stamp_ns=s) for v, s in zip(verdicts, stamps, strict=True)])
        assert (found["start"], found["width"]) == ([0.0, 2.0, 4.0, 6.0], 2.0)
        assert found["counts"]["accepted"] == [2, 0, 0, 1]
        assert found["counts"]["rejected"] == [0, 1, 0, 0]

    def test_a_long_run_is_counted_whole_in_few_parts(self):
        found = verdict_strip([record("rejected" if k >= 4000 else "accepted") for k in range(5000)])
        assert len(found["start"]) == 200
        assert sum(found["counts"]["accepted"]) == 4000
        assert found["counts"]["rejected"][:159] == [0] * 159

    def test_a_run_of_nothing_or_of_one_has_a_strip(self):
        assert verdict_strip([])["counts"]["accepted"] == [0]
        assert verdict_strip([record(source_stamp_ns=START_NS)])["counts"]["accepted"] == [1]


class TestWorst:
    def test_each_kind_has_its_own_order_and_none_comes_twice(self):
        def judged_record(verdict, probability, denied):
            return record(verdict, probability=probability, evidence={"denied_ratio": denied})

        records = [judged_record("accepted", 0.99, 0.0), judged_record("accepted", 0.6, 0.0)]
        records += [judged_record("rejected", 0.4, 0.01), judged_record("rejected", 0.1, 0.3)]
        records += [record("rejected", probability=None), record("dropped", probability=None)]
        assert worst_decisions(records, num_each=1) == [
            (1, "accepted, least sure"), (2, "not accepted, nearest to acceptance"), (3, "not accepted, most denied"),
            (4, "could not be registered"),
        ]  # fmt: skip

    def test_with_a_reference_the_largest_errors_come_first(self):
        records = [record(probability=0.9, translation_error_m=error) for error in (0.1, 7.0, None)]
        assert worst_decisions(records, num_each=1)[0] == (1, "accepted, farthest from the reference")


class TestBorder:
    def evidence(self, overlap: float, denied: float, wide: float, structure: float) -> SightViewEvidence:
        num = round(10_000 * overlap)
        num_denied = round(denied / (1.0 - denied) * num)
        seen = SeenSurface(10_000, num, np.zeros(num_denied, np.int64), wide * num_denied, 0, 0)
        lines = SightLines(10_000, 0, np.zeros(0, np.int64), np.zeros(0, np.int64))
        return SightViewEvidence(
            lines, lines, 1.0, overlap, 0.0, weakest_constraint=structure, source_surface=seen, target_surface=seen
        )

    @pytest.mark.parametrize("name", ["lidar_outdoor", "rgbd_indoor"])
    def test_beyond_the_outer_border_nothing_is_accepted_and_before_it_the_best_is(self, name):
        config = preset(name)
        border = decision_border(config)
        for overlap, outer in list(zip(border["overlap"], border["outer"], strict=True))[1:]:
            beyond, before = (self.evidence(overlap, share * outer, 0.1, 1.0 / 3.0) for share in (1.03, 0.97))
            assert decide(beyond, config.decision).verdict is not Verdict.ACCEPTED
            assert decide(before, config.decision).verdict is Verdict.ACCEPTED

    @pytest.mark.parametrize("name", ["lidar_outdoor", "rgbd_indoor"])
    def test_below_the_inner_border_denied_surface_never_rejects_and_beyond_it_it_may(self, name):
        config = preset(name)
        border = decision_border(config)
        for overlap, inner in list(zip(border["overlap"], border["inner"], strict=True))[1:]:
            beyond, before = (self.evidence(overlap, share * inner, 1.0, 0.0) for share in (1.05, 0.95))
            assert decide(beyond, config.decision).verdict is Verdict.REJECTED
            assert decide(before, config.decision).verdict is not Verdict.REJECTED
            assert inner < border["outer"][-1]

    def test_it_follows_the_configuration_of_the_run(self, tmp_path):
        plain = preset("lidar_outdoor")
        strict = with_values(plain, {"decision.offset": plain.decision.offset - 5.0})
        assert decision_border(strict)["outer"][-1] < 0.5 * decision_border(plain)["outer"][-1]

    def test_other_methods_have_none(self):
        assert decision_border(with_values(preset("lidar_outdoor"), {"method": "svc_paper"})) is None


def test_stage_times_are_those_of_decisions_that_took_time():
    times = [{"matching": 10.0, "prepare": 1.0, "total": 12.0}, {"matching": 30.0, "total": 40.0}, {"total": 0.0}, {}]
    found = stage_times([record(time_ms=entry) for entry in times])
    assert (found["num_decisions"], found["stages"], found["num"]) == (2, ["matching", "prepare"], [2, 1])
    assert found["median_ms"] == [20.0, 1.0]
    assert found["total_median_ms"] == 26.0
    assert found["p95_ms"][0] == pytest.approx(29.0)


class TestMap:
    def link(self, target: int, source: int, verdict: str = "accepted", **more) -> dict:
        stamps = {"target_stamp_ns": START_NS + target * 10**9, "source_stamp_ns": START_NS + source * 10**9}
        return record(verdict, **stamps, **more)

    def test_links_join_the_places_of_their_stamps(self):
        records = [self.link(0, 1), self.link(1, 3, "rejected"), self.link(2, 2), self.link(2, 99)]
        found = map_from_above(Run(records, trajectory=way(4)), None, range(4))
        assert found["links"]["accepted"] == [[0, 0.0, 0.0, 4.0, 0.3]]
        assert found["links"]["rejected"] == [[1, 4.0, 0.3, 12.0, 2.7]]
        assert found["num_unplaced"] == 1
        assert found["basis"] == "trajectory"
        assert found["way"][-1] == [12.0, 2.7]

    def test_the_reference_is_moved_onto_the_way(self):
        turn = se3.make_pose([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [50.0, 7.0, 1.0])
        reference = Trajectory(way(6).stamps_ns, turn @ way(6).poses)
        found = map_from_above(Run([], trajectory=way(6)), reference, [])
        np.testing.assert_allclose(found["reference"], found["way"], atol=0.01)

    def test_what_the_reference_tells_of_before_and_after_is_left_out(self):
        whole = way(9)
        part = Trajectory(whole.stamps_ns[2:6], whole.poses[2:6])
        found = map_from_above(Run([], trajectory=part), whole, [])
        np.testing.assert_allclose(found["reference"], found["way"], atol=0.01)

    def test_a_reference_along_a_straight_line_is_turned_by_its_first_pose(self):
        straight = way(5).poses.copy()
        straight[:, 1, 3] = 0.0
        ours = Trajectory(way(5).stamps_ns, straight)
        turn = se3.make_pose([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [50.0, 7.0, 1.0])
        found = map_from_above(Run([], trajectory=ours), Trajectory(ours.stamps_ns, turn @ straight), [])
        np.testing.assert_allclose(found["reference"], found["way"], atol=0.01)

    def test_without_a_trajectory_places_are_those_of_the_reference(self):
        found = map_from_above(Run([self.link(0, 1)]), way(3), [0])
        assert (found["basis"], found["links"]["accepted"]) == ("reference", [[0, 0.0, 0.0, 4.0, 0.3]])
        assert found["reference"] == []

    def test_without_both_accepted_pairs_place_the_scans(self):
        step = se3.make_pose(np.eye(3), [2.0, 1.0, 0.0]).tolist()
        records = [self.link(k, k + 1, T_target_source=step) for k in (0, 1)] + [self.link(0, 2, "rejected")]
        found = map_from_above(Run(records), None, range(3))
        assert found["basis"] == "accepted pairs"
        assert found["way"] == [[0.0, 0.0], [2.0, 1.0], [4.0, 2.0]]
        assert found["links"]["rejected"] == [[2, 0.0, 0.0, 4.0, 2.0]]

    def test_without_anything_nothing_is_drawn(self):
        found = map_from_above(Run([self.link(0, 1, "rejected")]), None, [0])
        assert (found["way"], found["num_unplaced"]) == ([], 1)


def test_an_empty_trajectory_is_none(tmp_path):
    (tmp_path / "trajectory_tum.txt").write_text("")
    assert read_run(tmp_path).trajectory is None


def test_a_view_holds_its_one_pair(tmp_path):
    source, target, results = judged()
    write_view(tmp_path / "v.html", result_to_json(results[1]), make_scene(0, source, target, results[1]), "a pair")
    data = data_of(tmp_path / "v.html")
    assert (data["kind"], data["title"], len(data["scenes"])) == ("view", "a pair", 1)
    assert data["told"]["0"]["verdict"] == "rejected"


@pytest.mark.parametrize("name", ["report", "report_dark", "report_phone"])
def test_pictures_of_a_report_are_small(name):
    picture = PROJECT_ROOT / "docs" / "images" / f"{name}.png"
    assert 20_000 < picture.stat().st_size < 400_000
