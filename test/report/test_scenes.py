"""Scenes: what is drawn of a pair, and which pairs are kept."""

from __future__ import annotations

import numpy as np
import pytest
from report_cases import judged

from svc_ros.core import se3
from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import PreparedScan
from svc_ros.io.results import result_from_json, result_to_json
from svc_ros.report import scenes
from svc_ros.report.scenes import SceneKeeper, make_scene
from svc_ros.report.sight_lines import MAX_DENIED, MAX_LINES

RIGHT, WRONG, NOTHING = 0, 1, 3


def rows(points: np.ndarray) -> set[tuple[float, ...]]:
    return {tuple(row) for row in np.asarray(points, np.float32).tolist()}


def pose(result: RegistrationResult) -> np.ndarray:
    assert result.best_candidate is not None
    return result.best_candidate


class TestMakeScene:
    @pytest.mark.parametrize("case", [RIGHT, WRONG])
    def test_blocked_lines_end_at_the_points_that_the_evidence_names(self, case, monkeypatch):
        monkeypatch.setattr(scenes, "choose_lines", lambda lines, num: choose_all(lines, num))
        source, target, results = judged()
        scene, evidence, T = make_scene(7, source, target, results[case]), results[case].evidence, pose(results[case])
        assert rows(scene.target.blocked) == rows(target.points[evidence.source_in_target.blocked_idx])
        assert rows(scene.source.blocked) == rows(se3.apply(T, source.points[evidence.target_in_source.blocked_idx]))
        assert len(scene.target.clear) == len(target) - scene.target.num_blocked
        assert not rows(scene.target.clear) & rows(scene.target.blocked)

    @pytest.mark.parametrize("case", [RIGHT, WRONG])
    def test_red_points_are_surface_that_the_other_sensor_looked_through(self, case):
        source, target, results = judged()
        scene, evidence, T = make_scene(0, source, target, results[case]), results[case].evidence, pose(results[case])
        placed = se3.apply(T, source.points[evidence.source_surface.denied_idx])
        own = target.points[evidence.target_surface.denied_idx]
        for side, denied in ((scene.source, placed), (scene.target, own)):
            assert side.num_denied == len(denied)
            assert len(side.denied) == min(len(denied), MAX_DENIED)
            assert rows(side.denied) <= rows(denied)
        assert scene.target.num_seen == len(own) + evidence.target_surface.num_confirmed
        assert scene.num_denied_drawn == len(scene.source.denied) + len(scene.target.denied) > 0

    def test_the_same_points_are_drawn_each_time(self):
        source, target, results = judged()
        first, again = (make_scene(0, source, target, results[WRONG]) for _ in range(2))
        np.testing.assert_array_equal(first.source.denied, again.source.denied)
        np.testing.assert_array_equal(first.target.denied, again.target.denied)

    def test_a_wrong_pose_shows_red_lines_and_much_more_of_them_than_a_right_one(self):
        source, target, results = judged()
        right, wrong = (make_scene(0, source, target, results[case]) for case in (RIGHT, WRONG))
        assert wrong.num_blocked_drawn > 100
        assert wrong.num_denied_drawn > 20 * right.num_denied_drawn
        assert wrong.target.num_blocked > 10 * max(right.target.num_blocked, 1)

    def test_copies_are_thin_and_say_how_much_there_was(self):
        source, target, results = judged()
        scene = make_scene(0, source, target, results[WRONG])
        assert (scene.target.num_points, scene.source.num_points) == (len(target), len(source))
        assert len(scene.target.points) == min(len(target), scenes.MAX_POINTS)
        assert scene.target.num_lines == len(target)
        assert max(len(scene.target.clear), len(scene.source.blocked)) <= MAX_LINES
        assert not np.shares_memory(scene.target.points, target.points)

    def test_without_a_pose_the_source_stays_where_it_is_and_no_line_is_drawn(self):
        source, target, results = judged()
        scene = make_scene(0, source, target, results[NOTHING])
        assert scene.T_target_source is None
        assert rows(scene.source.points) <= rows(source.points)
        assert scene.num_denied_drawn == scene.source.num_denied == scene.source.num_seen == 0
        assert scene.num_blocked_drawn == scene.target.num_lines == len(scene.target.clear) == 0

    def test_evidence_without_indices_is_refused(self):
        source, target, results = judged()
        read = result_from_json(result_to_json(results[WRONG]))
        with pytest.raises(InputError, match="JSON, which keeps no indices"):
            make_scene(0, source, target, read)

    def test_evidence_of_larger_scans_is_refused(self):
        source, target, results = judged()
        few = PreparedScan(target.points[:50], target.normals[:50], target.sensor_origin, target.voxel_size_m)
        with pytest.raises(InputError, match="expected blocked indices from 0 to 49"):
            make_scene(0, source, few, results[WRONG])


def choose_all(lines, num):
    return scenes.choose_evenly(np.setdiff1d(np.arange(num), lines.blocked_idx), num), np.unique(lines.blocked_idx)


def tiny(num: int = 3) -> PreparedScan:
    points = np.arange(3.0 * num).reshape(num, 3)
    return PreparedScan(points, np.tile([0.0, 0.0, 1.0], (num, 1)), np.zeros(3), 0.3)


def answer(accepted: bool, probability: float | None) -> RegistrationResult:
    if accepted:
        return RegistrationResult(Verdict.ACCEPTED, Reason.OK, "svc", np.eye(4), np.eye(4), probability=probability)
    return RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP, "svc", None, np.eye(4), probability=probability)


def kept(answers: list[tuple[bool, float | None]], max_scenes: int) -> list[int]:
    keeper, scan = SceneKeeper(max_scenes), tiny()
    for index, (accepted, probability) in enumerate(answers):
        keeper.offer(index, scan, scan, answer(accepted, probability))
    return [scene.index for scene in keeper.scenes]


class TestSceneKeeper:
    def test_few_are_all_kept_in_their_order(self):
        assert kept([(k % 2 == 0, 0.5) for k in range(9)], 10) == list(range(9))

    def test_rare_rejections_and_doubtful_acceptances_are_kept(self):
        answers: list[tuple[bool, float | None]] = [(True, 0.99)] * 2000
        rejected, doubtful = [3, 777, 1500, 1999], [10, 1234, 1888]
        for k in rejected:
            answers[k] = (False, 0.1)
        for k in doubtful:
            answers[k] = (True, 0.55)
        found = kept(answers, 20)
        assert len(found) == 20
        assert set(rejected + doubtful) <= set(found)

    def test_ordinary_ones_are_spread_over_the_run(self):
        found = [k for k in kept([(True, 0.5 + 0.4999 * k / 3000) for k in range(3000)], 40) if k >= 40]
        assert len(found) >= 10
        assert max(np.diff([0, *found, 3000])) < 700

    def test_rejections_nearest_to_acceptance_come_first_and_leave_places_to_acceptances(self):
        answers: list[tuple[bool, float | None]] = [(k % 5 == 0, 0.9 if k % 5 == 0 else 0.0) for k in range(1000)]
        answers[501], answers[502] = (False, 0.49), (False, 0.48)
        found = kept(answers, 16)
        assert {501, 502} <= set(found)
        assert sum(answers[k][0] for k in found) >= 4

    def test_the_same_run_keeps_the_same(self):
        answers = [(bool(k % 3), float(p)) for k, p in enumerate(np.random.default_rng(0).random(500))]
        assert kept(answers, 12) == kept(answers, 12)

    def test_memory_stays_bounded(self):
        keeper, scan = SceneKeeper(5), tiny()
        for index in range(700):
            keeper.offer(index, scan, scan, answer(index % 3 > 0, (index * 37 % 100) / 100))
            assert len(keeper._scenes) <= 4 * 5
        assert len(keeper.scenes) == 5

    def test_results_without_a_probability_are_kept_too(self):
        assert kept([(False, None), (True, None)], 3) == [0, 1]

    def test_no_scene_at_all_is_no_request(self):
        with pytest.raises(InputError, match="at least one, found 0"):
            SceneKeeper(0)
