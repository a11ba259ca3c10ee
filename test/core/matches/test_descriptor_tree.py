"""The tree's nearest rows are those of the full distance matrix, for every awkward size, and nothing else sways it."""

from __future__ import annotations

import numpy as np
import pytest
import reference

from svc_ros.core import parallel
from svc_ros.core.kernels.descriptor import LANES
from svc_ros.core.matches import descriptor_tree
from svc_ros.core.matches.descriptor_tree import DescriptorTree

RNG = np.random.default_rng(11)


def unit_rows(num: int, length: int = 33, signed: bool = False) -> np.ndarray:
    rows = RNG.normal(size=(num, length)) if signed else RNG.random((num, length)) ** 4
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def clustered_rows(num: int) -> np.ndarray:
    """Like real descriptors: they differ along few directions, many of them hardly, some not at all."""
    centres, directions = RNG.random((12, 33)), RNG.normal(size=(3, 33))
    rows = centres[RNG.integers(0, 12, num)] + RNG.normal(size=(num, 3)) * (0.1, 0.03, 0.001) @ directions
    rows[::9] = rows[0]
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize(("num_a", "num_b"), [(1, 1), (1, 300), (300, 1), (2, 255), (64, 257), (40, 4200)])
def test_nearest_of_all_equals_the_full_matrix(num_a, num_b, signed):
    a, b = unit_rows(num_a, signed=signed), unit_rows(num_b, signed=signed)
    index, distance, second = reference.nearest_descriptors(a, b)
    found = DescriptorTree.build(b).find(a, with_second=True)
    np.testing.assert_array_equal(found.index, index)
    np.testing.assert_allclose(np.sqrt(found.sq_distance), distance, atol=1e-5)
    if num_b > 1:
        np.testing.assert_allclose(np.sqrt(found.sq_second), second, atol=1e-5)
    else:
        assert (found.sq_second > 1e11).all()


@pytest.mark.parametrize("length", [1, 3, 8, 32, 128, 5000])
def test_descriptors_of_any_length(length):
    a, b = unit_rows(70, length, signed=True), unit_rows(90, length, signed=True)
    index, distance, _ = reference.nearest_descriptors(a, b)
    found = DescriptorTree.build(b).find(a)
    np.testing.assert_allclose(np.linalg.norm(a - b[found.index], axis=1), distance, atol=1e-6)
    if length > 1:  # rows of length one are all the same two numbers
        np.testing.assert_array_equal(found.index, index)


def test_clustered_rows_are_found_as_near_as_they_are():
    a, b = clustered_rows(500), clustered_rows(900)
    _, distance, second = reference.nearest_descriptors(a, b)
    found = DescriptorTree.build(b).find(a, with_second=True)
    np.testing.assert_allclose(np.linalg.norm(a - b[found.index], axis=1), distance, atol=1e-6)
    np.testing.assert_allclose(np.sqrt(found.sq_second), second, atol=1e-6)


def test_of_equal_rows_the_first_is_taken():
    a = clustered_rows(400)
    found = DescriptorTree.build(np.concatenate([a, a, a])).find(a, with_second=True)
    np.testing.assert_array_equal(found.index, reference.nearest_descriptors(a, a)[0])
    assert not found.sq_distance.any()
    assert not found.sq_second.any()


def test_what_is_known_beforehand_changes_nothing():
    a, b = clustered_rows(800), clustered_rows(900)
    tree = DescriptorTree.build(b)
    free = tree.find(a)
    for factor in (1.0, 1.5):
        found = tree.find(a, within=factor * free.sq_distance)
        np.testing.assert_array_equal(found.index, free.index)
        np.testing.assert_array_equal(found.sq_distance, free.sq_distance)


@pytest.mark.parametrize("part", [7, 1000])
@pytest.mark.parametrize("num_processors", [1, 3])
def test_processors_and_the_order_of_queries_change_nothing(monkeypatch, num_processors, part):
    a, b = clustered_rows(800), clustered_rows(900)
    expected = DescriptorTree.build(b).find(a, with_second=True)
    monkeypatch.setattr(parallel, "num_processors", lambda: num_processors)
    monkeypatch.setattr(parallel, "_PART", part)
    order = RNG.permutation(len(a))
    found = DescriptorTree.build(b).find(a[order], with_second=True)
    np.testing.assert_array_equal(found.index, expected.index[order])
    np.testing.assert_array_equal(found.sq_distance, expected.sq_distance[order])
    np.testing.assert_array_equal(found.sq_second, expected.sq_second[order])


def test_distance_there_is_distance_back():
    a, b = unit_rows(300), unit_rows(400)
    there, back = DescriptorTree.build(b).find(a), DescriptorTree.build(a).find(b)
    mutual = np.flatnonzero(back.index[there.index] == np.arange(len(a)))
    assert len(mutual) > 50
    np.testing.assert_array_equal(there.sq_distance[mutual], back.sq_distance[there.index[mutual]])


@pytest.mark.parametrize("num", [1, 15, 16, 17, 256, 257, 2000, 5000])
def test_blocks_hold_every_row_and_lie_together(num):
    heads = RNG.normal(size=(num, 8)).astype(np.float32)
    order = descriptor_tree.sort_into_blocks(heads)
    assert order.shape[1] == LANES
    assert len(order) % LANES == 0
    assert set(order.ravel()) == set(range(num))
    if num >= 2000:
        assert order.size < 1.3 * num
        assert heads[order].std(1).mean() < 0.8 * heads.std(0).mean()


def test_directions_are_orthonormal_and_those_of_the_largest_spread():
    rows = clustered_rows(2000)
    directions = descriptor_tree.find_directions(rows)
    np.testing.assert_allclose(directions.T @ directions, np.eye(8), atol=1e-5)
    largest = np.sort(np.linalg.eigvalsh(np.cov(rows.T)))[-8:].sum()
    assert np.var(rows @ directions, axis=0).sum() > 0.99 * largest
