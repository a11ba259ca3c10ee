"""The cheap look at many poses counts what brute force counts, and prefers the right pose."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from scan_cases import T_ROOM, random_scan, room_config, room_scans
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.registration import prepare
from svc_ros.core.search import prescore as stage


def random_poses(num: int) -> np.ndarray:
    rng = np.random.default_rng(6)
    return se3.make_pose(Rotation.random(num, random_state=1).as_matrix(), rng.normal(size=(num, 3)) * 2)


@pytest.mark.parametrize("radius", [0.5, 2.0])
def test_scores_equal_brute_force(radius):
    source, target = random_scan(200, 1, spread=3.0), random_scan(300, 2, spread=3.0)
    T = random_poses(100)  # more than one thread takes at once
    found = stage.prescore(T, source, target, radius, 10_000)
    both = (source.points, source.normals), (target.points, target.normals)
    expected = [reference.num_agreeing(pose, *both, radius, stage._MIN_COSINE) for pose in T]
    np.testing.assert_array_equal(found, np.array(expected) / len(source))
    assert max(expected) > 0


def test_the_right_pose_beats_all_others():
    config = room_config()
    source, target = (prepare(scan, config) for scan in room_scans())
    T = np.concatenate([random_poses(100), T_ROOM[None]])
    scores = stage.prescore(T, source, target, config.sight_view.tolerance_m, config.shortlist.prescore_points)
    assert scores.argmax() == 100
    assert scores[100] > 0.7
    assert (scores >= 0).all()
    assert (scores <= 1).all()


def test_no_pose_no_score():
    scan = random_scan(50, 1)
    assert stage.prescore(np.zeros((0, 4, 4)), scan, scan, 0.5, 100).shape == (0,)


@pytest.mark.parametrize(("num", "wanted"), [(0, 5), (3, 5), (1000, 10), (1001, 500), (999, 1), (10, 10)])
def test_a_sample_is_spread_evenly(num, wanted):
    sample = stage.thin_evenly(num, wanted)
    assert len(np.unique(np.diff(sample))) <= 1
    assert len(sample) >= min(num, wanted)
    assert len(sample) < 2 * wanted + 1
    assert num == 0 or (sample[0] == 0 and sample[-1] < num)
