"""The story from two scans to a verdict: what may be passed in, what comes out, and that it comes out again."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from assertions import assert_same_bits, assert_same_pose, fingerprint
from correspondence_cases import T_TRUE, random_case
from places import PROJECT_ROOT, SUPPORT
from scan_cases import T_ROOM, prepared, room_config, room_scans

from svc_ros.core import se3
from svc_ros.core.config import METHODS
from svc_ros.core.errors import InputError, TooFewPointsError
from svc_ros.core.matches.matching import match
from svc_ros.core.registration import extract_features, prepare, register, verify
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Correspondences, Features, Scan

SOURCE, TARGET = room_scans()


def numbers_of(result: RegistrationResult) -> dict[str, object]:
    return {"evidence": result.evidence.numbers(), "verdict": result.verdict, "probability": result.probability,
            "counts": dict(result.counts)}  # fmt: skip


@pytest.fixture(scope="module")
def features() -> tuple[Features, Features]:
    return extract_features(SOURCE, room_config()), extract_features(TARGET, room_config())


def test_features_computed_before_give_the_same_answer(features):
    from_scans, from_features = register(SOURCE, TARGET, room_config()), register(*features, room_config())
    assert_same_bits(from_features.best_candidate, from_scans.best_candidate)
    assert numbers_of(from_features) == numbers_of(from_scans)


def test_features_of_a_prepared_scan_are_those_of_the_scan(features):
    config = room_config()
    assert_same_bits(extract_features(prepare(SOURCE, config), config).descriptors, features[0].descriptors)


def test_correspondences_take_the_place_of_matching(features):
    config = room_config(method="sc2")
    given = register(*features, config, correspondences=match(*features, config.matching))
    assert_same_bits(given.T_target_source, register(*features, config).T_target_source)
    assert {"features", "matching"}.isdisjoint(given.time_ms)
    elsewhere = register(SOURCE, TARGET, config, correspondences=random_case(200))
    assert_same_pose(elsewhere.best_candidate, T_TRUE, 0.5, 0.1)
    assert elsewhere.counts["correspondences"] == 200


@pytest.mark.parametrize("num", [0, 1, 9])
def test_too_few_correspondences_are_a_verdict(features, num):
    points = np.arange(3.0 * num).reshape(num, 3)
    result = register(*features, room_config(), correspondences=Correspondences.from_points(points, points))
    assert (result.verdict, result.reason) == (Verdict.REJECTED, Reason.TOO_FEW_CORRESPONDENCES)
    assert (result.T_target_source, result.best_candidate) == (None, None)
    assert str(num) in result.detail


@pytest.mark.parametrize("method", METHODS)
def test_correspondences_that_determine_no_pose_are_a_verdict(features, method):
    line = np.linspace(0, 9, 50)[:, None] * (1.0, 0.5, 0.2)
    result = register(*features, room_config(method=method), correspondences=Correspondences.from_points(line, line))
    assert (result.verdict, result.reason) == (Verdict.REJECTED, Reason.NO_HYPOTHESIS)
    assert result.best_candidate is None
    assert result.counts["hypotheses"] == 0


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.ones((50, 3)), np.zeros((5000, 3))])
def test_scans_without_enough_points_are_an_error(points):
    for pair in ((Scan(points), TARGET), (SOURCE, Scan(points))):
        with pytest.raises(TooFewPointsError, match="expected at least"):
            register(*pair, room_config())
        with pytest.raises(TooFewPointsError, match="expected at least"):
            verify(*pair, np.eye(4), room_config())


def test_what_is_no_pose_is_an_error(features):
    for wrong in (np.eye(3), np.diag([1.0, 1, -1, 1]), np.full((4, 4), np.nan)):
        with pytest.raises(InputError, match="T_target_source"):
            verify(*features, wrong, room_config())


@pytest.mark.parametrize("method", METHODS)
def test_verify_takes_scans_at_any_stage(features, method):
    config = room_config(method=method)
    answers = [
        verify(SOURCE, TARGET, T_ROOM, config),
        verify(prepare(SOURCE, config), prepare(TARGET, config), T_ROOM.tolist(), config),
        verify(*features, T_ROOM, config),
        verify(SOURCE, features[1], T_ROOM, config),
    ]
    for answer in answers[1:]:
        assert_same_bits(answer.best_candidate, answers[0].best_candidate)
        assert answer.evidence.numbers() == answers[0].evidence.numbers()


def test_a_sensor_that_does_not_stand_at_the_origin_changes_nothing(features):
    """The same scans, each in a frame of its own with the sensor elsewhere."""
    A, B = (se3.make_pose([[0, -1, 0], [1, 0, 0], [0, 0, 1]], t) for t in ((3.0, 1, 2), (-2.0, 4, 1)))
    moved = [Scan(se3.apply(T, scan.points), sensor_origin=T[:3, 3]) for T, scan in ((A, SOURCE), (B, TARGET))]
    answer = verify(*moved, B @ T_ROOM @ se3.invert(A), room_config())
    at_origin = verify(*features, T_ROOM, room_config())
    assert answer.verdict is at_origin.verdict is Verdict.ACCEPTED
    assert_same_pose(se3.invert(B) @ answer.T_target_source @ A, at_origin.T_target_source, 0.2, 0.02)
    assert answer.evidence.overlap_ratio == pytest.approx(at_origin.evidence.overlap_ratio, abs=0.05)


@pytest.mark.parametrize("method", METHODS)
def test_every_stage_is_timed(method):
    result = register(SOURCE, TARGET, room_config(method=method))
    stages = {name: ms for name, ms in result.time_ms.items() if name != "total"}
    assert {"prepare", "features", "matching", "hypotheses", "sight_view"} <= set(stages)
    assert all(ms >= 0 for ms in stages.values())
    assert result.time_ms["total"] >= 0.99 * sum(stages.values())


def test_inputs_are_left_alone():
    source, target, T = SOURCE.points.copy(), TARGET.points.copy(), T_ROOM.copy()
    case = random_case(100)
    x, y = case.source_points.copy(), case.target_points.copy()
    before = fingerprint(source, target, T, x, y)
    for method in METHODS:
        register(Scan(source), Scan(target), room_config(method=method))
        register(Scan(source), Scan(target), room_config(method=method), Correspondences.from_points(x, y))
        verify(Scan(source), Scan(target), T, room_config(method=method))
    assert fingerprint(source, target, T, x, y) == before
    assert all(array.flags.writeable for array in (source, target, T, x, y))


def test_the_order_of_points_does_not_matter():
    rng = np.random.default_rng(4)
    shuffled = [Scan(rng.permutation(scan.points)) for scan in (SOURCE, TARGET)]
    first, second = register(SOURCE, TARGET, room_config()), register(*shuffled, room_config())
    assert_same_bits(second.best_candidate, first.best_candidate)
    assert numbers_of(second) == numbers_of(first)


def test_a_point_at_the_sensor_does_no_harm():
    """Prepared scans of one's own may hold one, where nothing cropped it."""
    config = room_config()
    points = np.concatenate([prepare(SOURCE, config).points, np.zeros((1, 3))])
    normals = np.concatenate([prepare(SOURCE, config).normals, [[0.0, 0, 1]]])
    for method in METHODS:
        given = prepared(points, normals)
        assert verify(given, prepare(TARGET, config), T_ROOM, room_config(method=method)).evidence is not None


PROGRAM = """
from scan_cases import room_config, room_scans
from assertions import fingerprint
from svc_ros.core.registration import extract_features, register
features = [extract_features(scan, room_config()) for scan in room_scans()]
for f in features:
    print(fingerprint(f.keypoints, f.normals, f.descriptors))
for method in ("sc2", "svc_paper", "svc"):
    result = register(*features, room_config(method=method))
    print(fingerprint(result.best_candidate), sorted(result.evidence.numbers().items()), result.counts)
"""


def run_with_threads(num: int) -> str:
    """What a fresh process computes with that many threads in every library that has them."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    environment = os.environ | dict.fromkeys(names, str(num))
    environment["PYTHONPATH"] = os.pathsep.join([str(PROJECT_ROOT), str(SUPPORT)])
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.slow
def test_runs_and_thread_counts_give_the_same_bits():
    one, two, again = run_with_threads(1), run_with_threads(2), run_with_threads(2)
    assert len(one.splitlines()) == 5
    assert two == one
    assert again == one
