"""Three looks, each only where the one before was not enough; and an end where the ground says there is nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from assertions import assert_same_bits, assert_same_pose
from correspondence_cases import random_case
from scan_cases import T_ROOM, random_scan, real_pair, room_config, room_scans
from simulated_scans import Place, features_at, is_right

from svc_ros.core import se3
from svc_ros.core.config import Config, preset, with_values
from svc_ros.core.matches.matcher import Described, Given, Matcher
from svc_ros.core.matches.matching import match
from svc_ros.core.pair import Pair
from svc_ros.core.registration import extract_features, register
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Correspondences, Features
from svc_ros.core.scans.levelling import find_level
from svc_ros.core.search import looks
from svc_ros.core.search.hypotheses import generate_hypotheses
from svc_ros.core.search.looks import RoughPoses, find_pose
from svc_ros.core.stopwatch import Stopwatch

NO_MATCH = Correspondences.from_points(np.zeros((0, 3)), np.zeros((0, 3)))
ELSEWHERE = [(3, 5), (5, 7), (7, 3)]  # streets


class Watched:
    """A matcher that remembers what it was asked for, and gives other matches of all points where told to."""

    def __init__(self, matcher: Matcher, all_matches: list[Correspondences] | None = None) -> None:
        self._matcher, self._all, self.asked, self.alone = matcher, all_matches, list[str](), matcher.alone

    def few(self) -> list[Correspondences]:
        self.asked.append("few")
        return self._matcher.few()

    def all(self) -> list[Correspondences]:
        self.asked.append("all")
        return self._matcher.all() if self._all is None else self._all


class Nothing:
    """A matcher that finds nothing."""

    alone = False

    def few(self) -> list[Correspondences]:
        return [NO_MATCH]

    def all(self) -> list[Correspondences]:
        return [NO_MATCH]


Two = tuple[Features, Features]


def afresh(features: Features, sure: bool | None = None) -> Features:
    """The same with nothing remembered; its level as sure as told."""
    prepared = dataclasses.replace(features.prepared, memo={})
    if sure is not None:
        prepared.memo["level", False] = dataclasses.replace(find_level(features.prepared), sure=sure)
    return Features(prepared, features.descriptors)


def pair_of(two: Two, config: Config) -> Pair:
    return Pair(two[0].prepared, two[1].prepared, config, {}, Stopwatch())


def look(two: Two, config: Config, all_matches: list[Correspondences] | None = None) -> tuple[RegistrationResult, list]:
    """The answer, and what the matcher was asked for."""
    pair = pair_of(two, config)
    matcher = Watched(Described(pair, two), all_matches)
    return find_pose(pair, matcher), matcher.asked


@pytest.fixture(scope="module")
def room() -> Two:
    return tuple(extract_features(scan, room_config()) for scan in room_scans())


@pytest.fixture
def levelled(monkeypatch) -> list[int]:
    """How many poses every levelled look was asked for."""
    asked, find = list[int](), looks.find_levelled_poses
    monkeypatch.setattr(looks, "find_levelled_poses", lambda *given: asked.append(given[3]) or find(*given))
    return asked


def street(seed: int) -> Features:
    return features_at(Place("street", "HDL-64E", seed, 20.0), "lidar_outdoor")


# The first look


def test_an_accepted_first_look_asks_for_nothing_more(room, levelled):
    result, asked = look(room, room_config(matching__first_points=2000))
    assert result.accepted
    assert_same_pose(result.T_target_source, T_ROOM, 1.0, 0.1)
    assert asked == ["few"]
    assert levelled == []


def test_where_few_points_are_all_points_all_are_matched_at_once_and_once(room):
    for first in (0, max(map(len, room))):
        described = Described(pair_of(room, room_config(matching__first_points=first)), room)
        assert described.few() is described.all()
    config = room_config(matching__first_points=2000)
    (few,), (everything,) = (getattr(Described(pair_of(room, config), room), name)() for name in ("few", "all"))
    assert 0 < len(few) < len(everything)
    assert_same_bits(everything.source_points, match(*room, config.matching).source_points)


def test_without_ground_the_first_look_is_judged_whatever_it_promises(monkeypatch, room):
    monkeypatch.setattr(looks, "_PROMISING", np.inf)
    result, asked = look(room, room_config(matching__first_points=2000, hypotheses__levelled_poses=0))
    assert result.accepted
    assert asked == ["few"]


# The levelled look


def test_the_levelled_look_needs_no_correspondence(room, levelled):
    pair = pair_of(room, room_config())
    matcher = Watched(Nothing())
    result = find_pose(pair, matcher)
    assert result.accepted
    assert_same_pose(result.T_target_source, T_ROOM, 1.0, 0.1)
    assert matcher.asked == ["few"]
    assert levelled == [pair.config.hypotheses.levelled_poses]
    assert result.counts["searched"] <= pair.config.hypotheses.levelled_poses
    assert result.time_ms["levelled"] > 0.0


@pytest.mark.parametrize("seeds", ELSEWHERE)
def test_scans_of_different_streets_are_rejected_before_all_points_are_matched(seeds, levelled):
    result, asked = look((street(seeds[0]), street(seeds[1])), preset("lidar_outdoor"))
    assert result.verdict is Verdict.REJECTED, result.detail
    assert asked == ["few"]
    assert len(levelled) == 1
    assert result.counts["judged"] == looks._LAST_TRIES
    assert result.best_candidate is not None


def test_real_scans_of_different_drives_are_rejected_before_all_points_are_matched(shared_data):
    (source, _, _, config), (target, *_) = (
        real_pair(shared_data, name) for name in ("hdl64_kitti_a", "hdl64_kitti_05_loop")
    )
    result, asked = look((extract_features(source, config), extract_features(target, config)), config)
    assert result.verdict is Verdict.REJECTED, result.detail
    assert asked == ["few"]


def test_low_overlap_that_descriptors_do_not_find_is_found_on_the_ground(shared_data):
    source, target, T, config = real_pair(shared_data, "os0_64_walk", 69)
    two = extract_features(source, config), extract_features(target, config)
    without = register(*two, with_values(config, {"hypotheses.levelled_poses": 0}))
    assert not without.accepted
    assert not is_right(without, T)
    result = register(*two, config)
    assert result.accepted, result.detail
    assert is_right(result, T)


def test_without_levelled_poses_nobody_looks_for_the_ground(room, levelled):
    two = afresh(room[0]), afresh(room[1])
    config = room_config(hypotheses__levelled_poses=0, matching__first_points=0)
    result, asked = look(two, config)
    assert pair_of(two, config).levels() == []
    assert result.accepted
    assert asked == ["few"]
    assert levelled == []
    assert "levelled" not in result.time_ms
    assert all(("level", False) not in features.memo for features in two)


# The last look


def test_what_further_descriptors_may_find_is_looked_for_nevertheless(levelled):
    two, config = (street(3), street(5)), with_values(preset("lidar_outdoor"), {"matching.more_descriptors": "any"})
    result, asked = look(two, config, [NO_MATCH])
    assert not result.accepted
    assert asked == ["few", "all"]
    assert len(levelled) == 1


@pytest.mark.parametrize(("sure", "end"), [((True, True), True), ((True, False), False), ((False, True), False)])
def test_scans_are_told_to_show_different_places_only_where_the_ground_is_sure(sure, end):
    two = tuple(afresh(street(seed), each) for seed, each in zip((3, 5), sure, strict=True))
    result, asked = look(two, preset("lidar_outdoor"), [NO_MATCH])
    assert not result.accepted
    assert asked == (["few"] if end else ["few", "all"])


def test_what_was_seen_before_the_last_look_is_judged_with_it():
    two = tuple(afresh(street(seed), sure=False) for seed in (3, 5))
    result, asked = look(two, preset("lidar_outdoor"), [NO_MATCH])
    assert asked == ["few", "all"]
    assert result.counts["judged"] == preset("lidar_outdoor").shortlist.max_poses
    assert result.best_candidate is not None


def test_a_scan_that_sees_no_ground_ends_no_search(room):
    """Of the same place, so that it is found; its first look is judged at once."""
    two = afresh(room[0]), afresh(room[1])
    two[1].memo["level", False] = None
    assert pair_of(two, room_config()).levels() == []
    result, asked = look(two, room_config(matching__first_points=0))
    assert result.accepted
    assert asked == ["few"]


# Correspondences from elsewhere


def test_given_correspondences_are_all_that_is_used(room, levelled):
    """They agree on a pose far away, that nothing in the scans would lead to."""
    two, x = (afresh(room[0]), afresh(room[1])), random_case(200).source_points
    far_away = Correspondences.from_points(x, se3.apply(shifted(300.0)[0], x))
    result = register(*two, room_config(), correspondences=far_away)
    assert not result.accepted
    assert_same_pose(result.best_candidate, shifted(300.0)[0], 0.01, 0.01)
    assert result.counts["correspondences"] == 200
    assert levelled == []
    assert {"levelled", "features", "matching"}.isdisjoint(result.time_ms)
    assert all(("level", False) not in features.memo for features in two)
    assert (Given(far_away).few(), Given(far_away).all(), Given(far_away).alone) == ([far_away], [far_away], True)


LINE = np.linspace(0, 9, 50)[:, None] * (1.0, 0.5, 0.2)
POINTLESS = {
    Reason.TOO_FEW_CORRESPONDENCES: [Correspondences.from_points(LINE[:num], LINE[:num]) for num in (6, 9, 0)],
    Reason.NO_HYPOTHESIS: [NO_MATCH, Correspondences.from_points(LINE, LINE)],
}


@pytest.mark.parametrize("reason", POINTLESS)
def test_where_no_look_leads_to_a_pose_the_answer_says_why(reason):
    blind = [Features(random_scan(200, seed), np.zeros((200, 33), np.float32)) for seed in (1, 2)]
    pair = pair_of(tuple(blind), room_config())
    result = find_pose(pair, Watched(Nothing(), POINTLESS[reason]))
    assert (result.verdict, result.reason) == (Verdict.REJECTED, reason)
    assert (result.T_target_source, result.best_candidate, result.evidence) == (None, None, None)
    assert result.probability == 0.0
    assert result.counts == {"correspondences": sum(map(len, POINTLESS[reason])), "hypotheses": 0}
    if reason is Reason.TOO_FEW_CORRESPONDENCES:
        assert result.detail == "9 correspondences, at least 10 are needed"


# Parts


def test_levels_are_known_of_both_scans_or_of_none(room):
    assert len(pair_of(room, room_config()).levels()) == 2
    blind = Features(random_scan(200, 1), np.zeros((200, 33), np.float32))
    for two in ((room[0], blind), (blind, room[1]), (blind, blind)):
        assert pair_of(two, room_config()).levels() == []


def test_sets_with_too_few_correspondences_lead_to_no_hypothesis(room):
    """Yet they are counted."""
    pair, enough = pair_of(room, room_config()), random_case(200)
    few = random_case(9, inlier_ratio=1.0)
    together = pair.hypotheses([few, enough], generate_hypotheses)
    assert pair.counts == {"correspondences": 209, "hypotheses": len(together)}
    assert_same_bits(together.T_target_source, pair.hypotheses([enough], generate_hypotheses).T_target_source)
    assert len(pair.hypotheses([few], generate_hypotheses)) == len(pair.hypotheses([], generate_hypotheses)) == 0


def shifted(*x: float) -> np.ndarray:
    return np.array([se3.make_pose(np.eye(3), (shift, 0, 0)) for shift in x]).reshape(-1, 4, 4)


def test_contenders_are_the_poses_that_promise_about_as_much_as_the_best():
    seen = RoughPoses(shifted(0, 1, 2), 1.0 - looks._HOPELESS * np.array([0.0, 0.9, 1.1]))
    assert_same_bits(seen.contenders(), seen.T_target_source[:2])
    assert (len(seen), seen.promising) == (3, True)
    assert not RoughPoses(shifted(0), np.array([looks._PROMISING])).promising
    assert not looks._NONE.promising
    assert len(looks._NONE) == 0


def test_joined_looks_keep_the_better_of_what_is_the_same(room):
    pair = pair_of(room, room_config())
    one = RoughPoses(shifted(0.0, 10.0, 20.0), np.array([1.0, -1.0, -3.0]))
    other = RoughPoses(shifted(10.2, 40.0, 0.1), np.array([2.0, -2.0, -4.0]))
    joined = looks._join(pair, one, other)
    assert joined.T_target_source[:, 0, 3].tolist() == [10.2, 0.0, 40.0, 20.0]
    assert joined.promise.tolist() == [2.0, 1.0, -2.0, -3.0]
    assert_same_bits(looks._join(pair, one, looks._NONE).T_target_source, one.T_target_source)
    assert len(looks._join(pair, looks._NONE, looks._NONE)) == 0
