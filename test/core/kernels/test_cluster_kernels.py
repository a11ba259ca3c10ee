"""Clusters: equal to the components of a graph, whatever the order; small ones count for less than wide ones."""

from __future__ import annotations

import numpy as np
import pytest
import reference_images as reference

from svc_ros.core.kernels.cluster import label, sum_by_extent


def labels_of(points: np.ndarray, edge: float) -> np.ndarray:
    labels = np.empty(len(points), np.int64)
    label(np.ascontiguousarray(points, dtype=float), edge, labels)
    return labels


def line(num: int, step: float) -> np.ndarray:
    return np.column_stack([step * np.arange(num), np.zeros((num, 2))])


def cases() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "none": np.zeros((0, 3)), "one": np.array([[1.0, -2.0, 3.0]]), "same_place": np.ones((20, 3)),
        "dense": rng.normal(size=(2000, 3)) * 3, "sparse": rng.normal(size=(2000, 3)) * 30,
        "thin": rng.uniform(-20, 20, (1500, 3)) * [1, 1, 0.01], "chain": rng.permutation(line(500, 0.9)),
        "backwards": line(300, 0.9)[::-1], "corners": np.arange(60.0)[:, None] * np.ones(3),
        "two": np.vstack([line(40, 0.5), line(40, 0.5) + np.array([0, 7.0, 0])]),
        "far": rng.normal(size=(300, 3)) * 1e5,
        "on_borders": rng.integers(-6, 6, (300, 3)).astype(float) * 3,
        "at_the_sensor": np.zeros((4, 3)),
    }  # fmt: skip


CASES = cases()


@pytest.mark.parametrize("edge", [0.3, 1.0, 4.0])
@pytest.mark.parametrize("case", CASES)
def test_clusters_are_the_components_of_touching_cells(case, edge):
    points = CASES[case]
    np.testing.assert_array_equal(labels_of(points, edge), reference.clusters(points, edge))


@pytest.mark.parametrize("angle", [0.05, 0.5, 3.0])
@pytest.mark.parametrize("case", CASES)
def test_sums_by_extent_are_those_of_every_cluster_alone(case, angle):
    points = CASES[case]
    labels = labels_of(points, 1.0)
    found = sum_by_extent(points, labels, angle)
    assert found == pytest.approx(reference.sum_by_extent(points, labels, angle))
    assert 0.0 <= found <= len(points)


def test_the_order_changes_the_names_but_not_who_belongs_together():
    """Cells begin at the first point, so that one stays the first."""
    rng = np.random.default_rng(1)
    points = CASES["sparse"][:700]
    order = np.concatenate(([0], 1 + rng.permutation(699)))
    one, other = labels_of(points, 4.0)[order], labels_of(points[order], 4.0)
    np.testing.assert_array_equal(one[:, None] == one, other[:, None] == other)
    assert 1 < len(np.unique(one)) < 700


def test_one_point_extends_over_nothing_and_a_wide_wall_counts_fully():
    assert sum_by_extent(np.array([[5.0, 0, 0]]), np.zeros(1, np.int64), 0.5) == 0.0
    y, z = (values.ravel() for values in np.meshgrid(np.linspace(-5, 5, 40), np.linspace(-1, 1, 10)))
    wall = np.column_stack([np.full(y.size, 5.0), y, z])
    assert sum_by_extent(wall, labels_of(wall, 1.0), np.radians(30.0)) == len(wall)
    small = wall * [1.0, 0.05, 0.05]
    assert sum_by_extent(small, labels_of(small, 1.0), np.radians(30.0)) < 0.25 * len(small)


def test_the_same_shape_counts_alike_at_any_range_of_the_same_angle():
    rng = np.random.default_rng(3)
    shape = rng.uniform(-0.3, 0.3, (50, 3)) + np.array([6.0, 0, 0])
    near, far = (sum_by_extent(scale * shape, np.zeros(50, np.int64), 0.5) for scale in (1.0, 8.0))
    assert near == pytest.approx(far)
