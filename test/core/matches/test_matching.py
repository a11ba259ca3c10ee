"""Matches equal those of the full distance matrix, for every strategy and every awkward size."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import reference

from svc_ros.core.config import MatchingConfig
from svc_ros.core.matches import matching
from svc_ros.core.scan import Features, PreparedScan

RNG = np.random.default_rng(11)
CONFIG = MatchingConfig(max_correspondences=100_000)


def described(descriptors: np.ndarray) -> Features:
    points = np.arange(3.0 * len(descriptors)).reshape(-1, 3)
    return Features(PreparedScan(points, np.tile((0.0, 0, 1), (len(points), 1)), np.zeros(3), 0.3), descriptors)


def unit_rows(num: int) -> np.ndarray:
    rows = RNG.random((num, 33)) ** 4
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def pairs_of(found, source: Features, target: Features) -> list[tuple[int, int]]:
    """Indices again: point k of `described` starts with 3 k."""
    return [(int(s[0] / 3), int(t[0] / 3)) for s, t in zip(found.source_points, found.target_points, strict=True)]


def test_strategies_keep_what_they_promise():
    source, target = described(unit_rows(200)), described(unit_rows(260))
    a, b = source.descriptors, target.descriptors
    nearest, distance, second = reference.nearest_descriptors(a, b)
    mutual = reference.mutual_matches(a, b)
    rows = [i for i, _ in mutual]
    one_way = matching.match(source, target, dataclasses.replace(CONFIG, strategy="one_way"))
    assert pairs_of(one_way, source, target) == list(enumerate(nearest))
    both = matching.match(source, target, dataclasses.replace(CONFIG, strategy="mutual"))
    assert pairs_of(both, source, target) == mutual
    np.testing.assert_allclose(both.distance, distance[rows], atol=1e-5)
    ranked = matching.match(source, target, dataclasses.replace(CONFIG, strategy="ratio"))
    assert pairs_of(ranked, source, target) == mutual
    np.testing.assert_allclose(ranked.distance, (distance / second)[rows], atol=1e-4)


@pytest.mark.parametrize("strategy", ["one_way", "mutual", "ratio"])
def test_the_best_are_kept_in_source_order(strategy):
    source, target = described(unit_rows(200)), described(unit_rows(260))
    every = matching.match(source, target, dataclasses.replace(CONFIG, strategy=strategy))
    few = matching.match(source, target, dataclasses.replace(CONFIG, strategy=strategy, max_correspondences=25))
    best = np.sort(np.argsort(every.distance, kind="stable")[:25])
    np.testing.assert_array_equal(few.source_points, every.source_points[best])
    np.testing.assert_array_equal(few.target_points, every.target_points[best])


@pytest.mark.parametrize("strategy", ["one_way", "mutual", "ratio"])
@pytest.mark.parametrize("empty_side", ["source", "target", "both"])
def test_points_without_a_descriptor_match_nothing(strategy, empty_side):
    zeros, rows = np.zeros((40, 33), np.float32), unit_rows(40)
    source = described(rows if empty_side == "target" else zeros)
    target = described(rows if empty_side == "source" else zeros)
    assert len(matching.match(source, target, dataclasses.replace(CONFIG, strategy=strategy))) == 0


def test_described_points_are_matched_past_the_others():
    rows = unit_rows(50)
    rows[::2] = 0
    source = target = described(rows)
    assert pairs_of(matching.match(source, target, CONFIG), source, target) == [(i, i) for i in range(1, 50, 2)]


def test_every_description_of_a_scan_is_matched_as_what_it_is():
    """The search structure is kept with the scan, not with whatever described it last."""
    source, first, second = described(unit_rows(60)), unit_rows(80), unit_rows(80)
    target = described(first)
    for rows in (first, second, first):
        features = Features(target.prepared, rows)
        expected = reference.mutual_matches(source.descriptors, rows)
        assert pairs_of(matching.match(source, features, CONFIG), source, features) == expected


def test_exchanged_scans_have_the_same_mutual_matches():
    source, target = described(unit_rows(400)), described(unit_rows(300))
    there, back = matching.match(source, target, CONFIG), matching.match(target, source, CONFIG)
    assert sorted(pairs_of(there, source, target)) == sorted((i, j) for j, i in pairs_of(back, target, source))


def test_a_crowd_of_equal_descriptors_matches_nothing_but_the_rest_does():
    crowd, rows = np.repeat(unit_rows(1), 50, 0), unit_rows(60)
    source, target = described(np.concatenate([crowd, rows])), described(np.concatenate([rows, crowd]))
    assert pairs_of(matching.match(source, target, CONFIG), source, target) == [(50 + i, i) for i in range(60)]
    assert len(matching.match(source, source, CONFIG)) == 60


def test_equal_to_one_row_only_is_no_crowd():
    source, target = described(unit_rows(1)), described(np.repeat(unit_rows(1), 2, 0))
    twin = described(np.repeat(source.descriptors, 2, 0))
    assert len(matching.match(source, twin, CONFIG)) == 1
    assert len(matching.match(twin, source, CONFIG)) == 1
    assert len(matching.match(source, target, CONFIG)) == 1


def test_a_part_is_matched_as_if_the_other_points_were_not_there():
    source, target = described(unit_rows(200)), described(unit_rows(260))
    found = matching.match(source, target, CONFIG, 66)
    thinned = described(source.descriptors[::3]), described(target.descriptors[::3])  # 200 and 260 by 66
    expected = [(3 * i, 3 * j) for i, j in pairs_of(matching.match(*thinned, CONFIG), *thinned)]
    assert pairs_of(found, source, target) == expected
    assert 0 < len(expected) < 67
    assert pairs_of(matching.match(source, target, CONFIG), source, target) == reference.mutual_matches(
        source.descriptors, target.descriptors
    )  # the tree of the few is not taken for that of all
