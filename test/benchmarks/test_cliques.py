"""Three-point hypotheses of the benchmarks: the triangles are those of a dense slow twin, and the pose is found."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from assertions import assert_same_bits, assert_same_pose
from correspondence_cases import T_TRUE, random_case

from svc_ros.core.config import HypothesisConfig
from svc_ros.core.scan import Correspondences

CONFIG = HypothesisConfig(compatibility_threshold_m=0.3)

pytestmark = pytest.mark.usefixtures("scripts")


def slow_weights(case: Correspondences, threshold_m: float) -> np.ndarray:
    x = case.source_points
    tight = (reference.length_differences(x, case.target_points) < 0.5 * threshold_m).astype(int)
    weights = tight * (tight @ tight)
    weights[np.linalg.norm(x[:, None] - x, axis=2) < 5.0 * threshold_m] = 0
    return weights


def corner_weights(weights: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """What each third corner of one edge is worth: 0 unless joined to both ends."""
    a, b = weights[edge[0]], weights[edge[1]]
    return np.where((a > 0) & (b > 0), a + b, 0)


@pytest.mark.parametrize("num", [63, 64, 120])
def test_triangles_are_the_heaviest_on_the_heaviest_edge_of_each_corner(num):
    from lib import cliques

    case = random_case(num)
    expected = slow_weights(case, 0.3)
    weights = cliques.weigh_edges(case, 0.3)
    np.testing.assert_array_equal(weights, expected)
    edges = cliques.heaviest_edges(weights)
    assert {i for i in range(num) if expected[i].any()} == set(edges.ravel().tolist())
    assert all(expected[a, b] in (expected[a].max(), expected[b].max()) for a, b in edges)
    for edge in edges:
        triangles = cliques.extend(edge[None], weights)
        worth = corner_weights(expected, edge)
        found = [worth[np.setdiff1d(triangle, edge)[0]] for triangle in triangles]
        best = np.sort(worth)[-2:]
        assert sorted(found) == best[best > 0].tolist()


def test_the_right_pose_comes_first_and_the_same_every_time():
    from lib import cliques

    first, second = (cliques.generate_clique_hypotheses(random_case(200), CONFIG) for _ in range(2))
    assert_same_pose(first.T_target_source[0], T_TRUE, 1.0, 0.2)
    assert_same_bits(first.T_target_source, second.T_target_source)


def test_nothing_compatible_is_no_hypothesis():
    from lib import cliques

    x = random_case(64).source_points
    assert len(cliques.generate_clique_hypotheses(Correspondences.from_points(x, x * 3.0), CONFIG)) == 0
