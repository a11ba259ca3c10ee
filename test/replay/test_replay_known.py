"""Decisions of an earlier run: taken as they are, looked at once more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from replay_cases import CONFIG, write_room_bag

from svc_ros.core.config import with_values
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.io.bags import Bag
from svc_ros.io.results import result_from_json, result_to_json
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.replay.clouds import ReplayedPair
from svc_ros.replay.known import KnownLoops, look_again
from svc_ros.replay.stream_pairs import replay_pairs


def first_pair(path: Path, method: str) -> ReplayedPair:
    with Bag(path) as bag:
        return next(replay_pairs(bag, "/points", with_values(CONFIG, {"method": method})))


@pytest.fixture(scope="module")
def bag_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_room_bag(tmp_path_factory.mktemp("known") / "room")


@pytest.mark.parametrize("method", ["svc", "sc2", "svc_paper"])
def test_the_evidence_is_what_it_was_with_all_its_indices(bag_path: Path, method: str) -> None:
    pair = first_pair(bag_path, method)
    assert pair.scans is not None
    assert pair.result.evidence is not None
    read = result_from_json(result_to_json(pair.result))
    again = look_again(read, *pair.scans, with_values(CONFIG, {"method": method}))
    assert again.evidence is not None
    assert again.evidence.numbers() == pair.result.evidence.numbers()
    for direction in ("source_in_target", "target_in_source"):
        first, second = (getattr(side, direction) for side in (again.evidence, pair.result.evidence))
        np.testing.assert_array_equal(first.blocked_idx, second.blocked_idx)
    assert result_to_json(again) == result_to_json(pair.result)


def test_without_a_pose_there_is_nothing_to_look_at(bag_path: Path) -> None:
    pair = first_pair(bag_path, "svc")
    assert pair.scans is not None
    result = RegistrationResult(Verdict.REJECTED, Reason.NO_HYPOTHESIS)
    assert look_again(result, *pair.scans, CONFIG) is result


def test_known_loops_are_not_judged_again(bag_path: Path) -> None:
    pair = first_pair(bag_path, "svc")
    assert pair.scans is not None
    source, target = (Keyframe(scan, None, CONFIG) for scan in pair.scans)
    judge = KnownLoops([pair])
    known = judge(source, target, None, CONFIG)
    assert known.time_ms == pair.result.time_ms
    again = judge(source, target, None, CONFIG)  # a second time it is not known
    assert again.time_ms != pair.result.time_ms
    np.testing.assert_array_equal(again.T_target_source, pair.result.T_target_source)
