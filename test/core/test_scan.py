"""The data types: checked once, read-only afterwards, and never at the cost of the caller's own arrays."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Correspondences, Features, HypothesisSet, PreparedScan, Scan
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence

POINTS = np.arange(30.0).reshape(10, 3)


def prepared(num: int = 10) -> PreparedScan:
    return PreparedScan(POINTS[:num], np.tile((0.0, 0.0, 1.0), (num, 1)), np.zeros(3), 0.3)


def test_scan_is_read_only_and_the_callers_array_is_not():
    points = POINTS.copy()
    scan = Scan(points)
    assert len(scan) == 10
    with pytest.raises(ValueError, match="read-only"):
        scan.points[0, 0] = 5
    with pytest.raises(dataclasses.FrozenInstanceError):
        scan.stamp_ns = 3  # type: ignore[misc]
    assert points.flags.writeable


def test_other_number_types_and_lists_are_converted():
    assert Scan([[1, 2, 3]]).points.dtype == np.float64  # type: ignore[arg-type]
    assert Scan(POINTS.astype(np.float32)).points.dtype == np.float64
    assert Scan(np.asfortranarray(POINTS)).points.flags.c_contiguous


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (POINTS.ravel(), r"Scan.points: expected shape N x 3, found \(30,\)"),
        (POINTS[:, :2], r"expected shape N x 3, found \(10, 2\)"),
        (np.where(POINTS == 4, np.nan, POINTS), "found 1 NaN or inf"),
        (np.where(POINTS < 2, np.inf, POINTS), "found 2 NaN or inf"),
        ("no cloud", "Scan.points: expected an array of numbers"),
        ([[1, 2, 3], [4, 5]], "Scan.points: expected an array of numbers"),
    ],
)
def test_bad_points_are_refused_in_words(points, words):
    with pytest.raises(InputError, match=words):
        Scan(points)


def test_an_empty_scan_is_a_scan():
    assert len(Scan(np.zeros((0, 3)))) == 0


def test_times_belong_to_points():
    assert Scan(POINTS, point_times_s=np.arange(10)).point_times_s.shape == (10,)
    with pytest.raises(InputError, match="point_times_s"):
        Scan(POINTS, point_times_s=np.arange(9))


def test_origins_are_not_shared_between_scans():
    first, second = Scan(POINTS), Scan(POINTS)
    assert not np.shares_memory(first.sensor_origin, second.sensor_origin)
    with pytest.raises(InputError, match="sensor_origin"):
        Scan(POINTS, sensor_origin=np.zeros(2))


def test_prepared_scan_and_features_agree_in_length():
    with pytest.raises(InputError, match=r"PreparedScan\.normals"):
        PreparedScan(POINTS, POINTS[:3], np.zeros(3), 0.3)
    with pytest.raises(InputError, match=r"Features\.descriptors"):
        Features(prepared(), np.zeros((9, 33), np.float32))
    features = Features(prepared(), np.zeros((10, 33)))
    assert len(features) == 10
    assert features.descriptors.dtype == np.float32
    assert features.keypoints is features.prepared.points
    assert prepared().memo is not prepared().memo
    assert prepared().range_image is None


def test_correspondences_from_elsewhere():
    found = Correspondences.from_points(POINTS.astype(np.float32), POINTS.tolist())
    assert len(found) == 10
    assert not found.distance.any()
    with pytest.raises(InputError, match="target_points"):
        Correspondences.from_points(POINTS, POINTS[:4])
    with pytest.raises(InputError, match="source_points"):
        Correspondences.from_points(3.0, POINTS)


def test_hypotheses_agree_in_length():
    with pytest.raises(InputError, match="num_inliers"):
        HypothesisSet(np.tile(np.eye(4), (3, 1, 1)), np.zeros(2), np.zeros(3))


def lines(num_lines: int, blocked: list[int], observed: int = 4) -> SightLines:
    return SightLines(num_lines, observed, np.array(blocked, np.int64), np.array(blocked, np.int64))


def test_ratios_of_sight_lines():
    some = lines(8, [1, 5])
    assert (some.num_blocked, some.blocked_ratio, some.observed_ratio) == (2, 0.25, 0.5)
    assert (lines(0, [], 0).blocked_ratio, lines(0, [], 0).observed_ratio) == (0.0, 0.0)


def test_evidence_as_numbers_keeps_the_directions_apart():
    numbers = SightViewEvidence(lines(8, [1, 5]), lines(10, [3]), 0.5, 0.4, 0.1).numbers()
    assert numbers["blocked_ratio_source_in_target"] == 0.25
    assert numbers["blocked_ratio_target_in_source"] == 0.1
    assert (numbers["overlap_ratio"], numbers["oriented_overlap_ratio"], numbers["opposed_ratio"]) == (0.5, 0.4, 0.1)
    assert all(type(value) in (int, float) for value in numbers.values())


def surface(denied: list[int], confirmed: int, wide: float = 0.0) -> SeenSurface:
    return SeenSurface(20, confirmed, np.array(denied, np.int64), wide, 2, 3)


def test_ratios_of_seen_surface():
    assert (surface([4, 7], 6).num_denied, surface([4, 7], 6).denied_ratio) == (2, 0.25)
    assert (surface([], 6).denied_ratio, surface([], 0).denied_ratio, surface([1], 0).denied_ratio) == (0.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="read-only"):
        surface([4, 7], 6).denied_idx[0] = 5
    with pytest.raises(InputError, match=r"SeenSurface\.denied_idx"):
        SeenSurface(20, 6, np.zeros((2, 2), np.int64), 0.0, 2, 3)


def test_denied_surface_of_both_ways_is_one_share():
    ways = {"source_surface": surface([4, 7], 6, 0.5), "target_surface": surface([1], 3, 0.25)}
    evidence = SightViewEvidence(lines(8, [1]), lines(10, [3]), 0.5, 0.4, 0.1, **ways)
    assert evidence.denied_ratio == pytest.approx(3 / 12)
    assert evidence.wide_denied_ratio == pytest.approx(0.75 / 9.75)
    numbers = evidence.numbers()
    assert (numbers["denied_ratio"], numbers["wide_denied_ratio"]) == (
        evidence.denied_ratio,
        evidence.wide_denied_ratio,
    )
    for way, seen in zip(("source_in_target", "target_in_source"), ways.values(), strict=True):
        assert numbers[f"denied_ratio_{way}"] == seen.denied_ratio
        assert numbers[f"wide_denied_{way}"] == seen.wide_denied
        for name in ("points", "confirmed", "denied", "hidden", "unseen"):
            assert numbers[f"num_{name}_{way}"] == getattr(seen, f"num_{name}")
    silent = SightViewEvidence(lines(8, [1]), lines(10, [3]), 0.5, 0.4, 0.1)
    assert (silent.denied_ratio, silent.wide_denied_ratio, silent.source_surface.num_points) == (0.0, 0.0, 0)


@pytest.mark.parametrize("verdict", list(Verdict))
def test_a_transform_belongs_to_acceptance_and_to_nothing_else(verdict):
    accepted = verdict is Verdict.ACCEPTED
    assert RegistrationResult(verdict, Reason.OK, T_target_source=np.eye(4) if accepted else None).accepted is accepted
    with pytest.raises(InputError, match="T_target_source"):
        RegistrationResult(verdict, Reason.OK, T_target_source=None if accepted else np.eye(4))


def test_matrices_of_a_result_are_checked():
    with pytest.raises(InputError, match="covariance"):
        RegistrationResult(Verdict.ACCEPTED, Reason.OK, T_target_source=np.eye(4), covariance=np.eye(3))
    with pytest.raises(InputError, match="best_candidate"):
        RegistrationResult(Verdict.REJECTED, Reason.AMBIGUOUS, best_candidate=np.full((4, 4), np.nan))
