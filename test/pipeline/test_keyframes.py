"""Keyframes: a bounded store, and what was computed of a scan is computed once."""

from __future__ import annotations

import numpy as np
import pytest
from mini_data import POSES, scan_room

from svc_ros.core.config import preset
from svc_ros.core.registration import prepare, verify
from svc_ros.core.scan import Scan
from svc_ros.pipeline import scan_matching
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
        assert scan_matching._thinned(keyframe.scan, num).range_image is image


def test_the_newest_are_kept(keyframe: Keyframe) -> None:
    keyframes = [Keyframe(keyframe.scan, None, CONFIG) for _ in range(5)]
    store = KeyframeStore(3)
    for k in keyframes:
        store.add(k)
    assert len(store) == 3
    assert list(store) == keyframes[2:]
    assert list(reversed(store)) == keyframes[:1:-1]
    store.clear()
    assert len(store) == 0
