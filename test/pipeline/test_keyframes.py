"""Keyframes: a bounded store, and what was computed of a scan is computed once."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from mini_data import POSES, scan_room

from svc_ros.core.config import Config, preset, with_values
from svc_ros.core.matches.descriptors import more_matches
from svc_ros.core.registration import extract_features, prepare, verify
from svc_ros.core.scan import Features, PreparedScan, Scan
from svc_ros.pipeline import keyframes
from svc_ros.pipeline.keyframes import Keyframe, KeyframeStore

CONFIG = preset("lidar_indoor")


@pytest.fixture
def keyframe() -> Keyframe:
    return Keyframe(prepare(Scan(scan_room(POSES[0])), CONFIG), np.eye(4), CONFIG)


def test_features_and_look_are_computed_once(keyframe: Keyframe) -> None:
    assert keyframe.features is keyframe.features
    assert keyframe.look is keyframe.look
    assert keyframe.features.prepared is keyframe.scan


def test_searches_can_be_forgotten_and_come_back_the_same(keyframe: Keyframe) -> None:
    other = prepare(Scan(scan_room(POSES[0], seed=1)), CONFIG)
    first = verify(other, keyframe.scan, np.eye(4), CONFIG)
    assert keyframe.scan.memo
    keyframe.forget_searches()
    assert not keyframe.scan.memo
    second = verify(other, keyframe.scan, np.eye(4), CONFIG)
    np.testing.assert_array_equal(first.best_candidate, second.best_candidate)
    assert first.verdict is second.verdict
    assert second.evidence.source_surface.num_confirmed > 100


def test_what_the_sensor_saw_is_kept_by_all_that_is_made_of_a_scan(keyframe: Keyframe) -> None:
    """A copy without its range image would deny nothing, whatever the pose."""
    image = keyframe.scan.range_image
    assert image is not None
    keyframe.forget_searches()
    assert keyframe.scan.range_image is image
    assert keyframe.features.prepared.range_image is image
    for num in (len(keyframe.scan) // 3, 10 * len(keyframe.scan)):
        assert keyframe.thinned(num).range_image is image


def test_the_newest_are_kept(keyframe: Keyframe) -> None:
    many = [Keyframe(keyframe.scan, None, CONFIG) for _ in range(5)]
    store = KeyframeStore(3)
    for k in many:
        store.add(k)
    assert len(store) == 3
    assert list(store) == many[2:]
    assert list(reversed(store)) == many[:1:-1]
    store.clear()
    assert len(store) == 0


def test_a_lent_keyframe_has_searches_of_its_own_and_shares_what_takes_long(keyframe: Keyframe) -> None:
    with keyframe.lent() as lent, keyframe.lent() as other:
        verify(lent.scan, other.scan, np.eye(4), CONFIG)
        assert lent.scan.memo
        assert lent.features.prepared is lent.scan
        assert lent.look is other.look is keyframe.look
        for each in (lent, other):
            assert each.features is each.features
            assert np.shares_memory(each.features.descriptors, keyframe.features.descriptors)
            assert np.shares_memory(each.scan.points, keyframe.scan.points)
            assert each.scan.range_image is keyframe.scan.range_image
    assert lent.scan.memo == other.scan.memo == keyframe.scan.memo == {}


def test_what_several_threads_ask_for_at_once_is_computed_once(
    keyframe: Keyframe, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def slow(scan: PreparedScan, config: Config) -> Features:
        calls.append(scan)
        time.sleep(0.05)
        return extract_features(scan, config)

    monkeypatch.setattr(keyframes, "extract_features", slow)

    def descriptors(_: int) -> np.ndarray:
        with keyframe.lent() as lent:
            return lent.features.descriptors

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(descriptors, range(4)))
    assert len(calls) == 1
    assert all(np.shares_memory(each, found[0]) for each in found)


def test_descriptions_made_of_a_lent_keyframe_are_kept_without_their_searches() -> None:
    config = with_values(CONFIG, {"matching.more_descriptors": "fpfh_wide"})
    first, other = (Keyframe(prepare(Scan(scan_room(T)), config), None, config) for T in POSES[:2])
    with first.lent() as source, other.lent() as target:
        (before,) = more_matches(source.scan, target.scan, config)
    ((_, kept),) = first.scan.memo.values()
    assert kept.memo == {}
    with first.lent() as source, other.lent() as target:
        ((_, again),) = source.scan.memo.values()
        assert again is not kept
        assert np.shares_memory(again.descriptors, kept.descriptors)
        (after,) = more_matches(source.scan, target.scan, config)
    assert before.source_points.tobytes() == after.source_points.tobytes()
    assert kept.memo == {}
