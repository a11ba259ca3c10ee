"""The optimised graph against a slow twin: least squares over all poses at once by scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.errors import MissingDependencyError
from svc_ros.io.g2o import GraphEdge, PoseGraph
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline import graph_optimisation
from svc_ros.pipeline.graph_optimisation import correct_trajectory, optimise

pytest.importorskip("gtsam", reason="gtsam not installed: pip install 'svc_ros[graph]'")
SIGMAS = np.array([0.05, 0.04, 0.03, 0.01, 0.02, 0.015])


def cross(v: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def exponential(twist: np.ndarray) -> np.ndarray:
    """The pose (4, 4) of a twist (6,), shift then turn."""
    return np.asarray(expm(np.block([[cross(twist[3:]), twist[:3, None]], [np.zeros((1, 4))]])))


def logarithm(T: np.ndarray) -> np.ndarray:
    """The twist (6,) of a pose that turns by less than half a circle."""
    turn = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    angle, K = np.linalg.norm(turn), cross(turn)
    # The series' coefficient of K^2, 1/12 where the angle vanishes.
    part = 1.0 / 12.0 if angle < 1e-4 else (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    return np.concatenate([(np.eye(3) - 0.5 * K + part * K @ K) @ T[:3, 3], turn])


def least_squares_twin(graph: PoseGraph) -> tuple[np.ndarray, np.ndarray]:
    """Poses and covariances (perturbation on the left, in the world) of all vertices but the first."""

    def poses(x: np.ndarray) -> np.ndarray:
        moved = [exponential(t) @ T for t, T in zip(x.reshape(-1, 6), graph.poses[1:], strict=True)]
        return np.array([graph.poses[0], *moved])

    def residuals(x: np.ndarray) -> np.ndarray:
        T = poses(x)
        errors = []
        for edge in graph.edges:
            # The measurement is perturbed on its left: T_measured = exp(e) T_true.
            error = logarithm(edge.T_target_source @ se3.invert(se3.invert(T[edge.target]) @ T[edge.source]))
            errors.append(np.linalg.solve(np.linalg.cholesky(edge.covariance), error))
        return np.concatenate(errors)

    found = least_squares(residuals, np.zeros(6 * (len(graph.poses) - 1)), xtol=1e-10, ftol=1e-12, gtol=1e-10)
    best = PoseGraph(poses(found.x), graph.edges)
    # Once more around the best, so that a perturbation is one of the pose that was found.
    graph = best
    jacobian = least_squares(residuals, np.zeros(found.x.size), max_nfev=1).jac
    full = np.linalg.inv(jacobian.T @ jacobian)
    return best.poses, np.array([full[k : k + 6, k : k + 6] for k in range(0, len(full), 6)])


def random_graph(seed: int, num: int, loops: list[tuple[int, int]], sigmas: np.ndarray = SIGMAS) -> PoseGraph:
    rng = np.random.default_rng(seed)
    truth = [exponential(rng.normal(0.0, 1.0, 6))]
    for _ in range(num - 1):
        truth.append(truth[-1] @ exponential(rng.normal(0.0, 0.5, 6)))
    edges = []
    for target, source in [*((k, k + 1) for k in range(num - 1)), *loops]:
        mixed = np.diag(sigmas) @ (np.eye(6) + 0.2 * rng.normal(size=(6, 6)))
        T = exponential(mixed @ rng.normal(size=6)) @ se3.invert(truth[target]) @ truth[source]
        edges.append(GraphEdge(source, target, T, mixed @ mixed.T))
    start = [truth[0]]
    for edge in edges[: num - 1]:
        start.append(start[-1] @ edge.T_target_source)
    return PoseGraph(np.array(start), edges)


def assert_same_as_twin(graph: PoseGraph) -> None:
    found = optimise(graph)
    poses, covariances = least_squares_twin(graph)
    np.testing.assert_allclose(found.poses, poses, atol=1e-5)
    np.testing.assert_array_equal(found.covariances[0], np.zeros((6, 6)))
    for ours, twin in zip(found.covariances[1:], covariances, strict=True):
        # The twin's residuals are on the left, gtsam's on the right: the second order differs.
        np.testing.assert_allclose(ours, twin, atol=0.02 * np.abs(twin).max())


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_random_graphs_are_as_the_slow_twin_has_them(seed: int) -> None:
    assert_same_as_twin(random_graph(seed, 6, [(0, 5), (1, 4), (5, 2), (0, 3)]))


def test_without_loops_the_poses_stay_and_uncertainty_grows() -> None:
    graph = random_graph(3, 5, [])
    assert_same_as_twin(graph)
    found = optimise(graph)
    np.testing.assert_allclose(found.poses, graph.poses, atol=1e-9)
    assert np.all(np.diff(np.linalg.det(found.covariances)) > 0.0)


def test_a_loop_that_knows_nothing_changes_nothing() -> None:
    alone = random_graph(4, 5, [])
    T = exponential(np.array([3.0, -2.0, 1.0, 0.4, 0.1, -0.3]))
    vague = PoseGraph(alone.poses, [*alone.edges, GraphEdge(4, 0, T, 1e12 * np.eye(6))])
    np.testing.assert_allclose(optimise(vague).poses, alone.poses, atol=1e-6)
    np.testing.assert_allclose(optimise(vague).covariances, optimise(alone).covariances, rtol=1e-4, atol=1e-12)


def test_a_sure_loop_pulls_the_end_to_where_it_says() -> None:
    graph = random_graph(5, 6, [(0, 5)], 1e-3 * SIGMAS)
    drifted = PoseGraph(graph.poses, [*random_graph(6, 6, [], 10.0 * SIGMAS).edges, graph.edges[-1]])
    found = optimise(drifted)
    np.testing.assert_allclose(
        se3.invert(found.poses[0]) @ found.poses[5], graph.edges[-1].T_target_source, atol=1e-3
    )


def test_the_direction_of_an_edge_does_not_matter() -> None:
    graph = random_graph(7, 5, [(0, 4), (3, 1)])
    turned = [
        GraphEdge(
            e.target, e.source, se3.invert(e.T_target_source),
            graph_optimisation.adjoint(se3.invert(e.T_target_source)) @ e.covariance
            @ graph_optimisation.adjoint(se3.invert(e.T_target_source)).T,
        )
        for e in graph.edges
    ]  # fmt: skip
    there, back = optimise(graph), optimise(PoseGraph(graph.poses, turned))
    np.testing.assert_allclose(back.poses, there.poses, atol=1e-6)
    np.testing.assert_allclose(back.covariances, there.covariances, rtol=1e-3, atol=1e-9)


def test_parts_that_nothing_joins_are_optimised_each_by_itself() -> None:
    one, other = random_graph(8, 4, [(0, 3)]), random_graph(9, 3, [(0, 2)])
    shifted = [GraphEdge(e.source + 4, e.target + 4, e.T_target_source, e.covariance) for e in other.edges]
    found = optimise(PoseGraph(np.concatenate([one.poses, other.poses]), [*one.edges, *shifted]))
    np.testing.assert_allclose(found.poses[:4], optimise(one).poses, atol=1e-7)
    np.testing.assert_allclose(found.poses[4:], optimise(other).poses, atol=1e-7)
    np.testing.assert_allclose(found.covariances[:4], optimise(one).covariances, rtol=1e-4, atol=1e-12)
    for covariance in found.covariances[4:]:
        assert np.isinf(np.diag(covariance)).all()


@pytest.mark.parametrize("num", [0, 1, 3])
def test_vertices_without_edges_stay(num: int) -> None:
    poses = random_graph(10, 3, []).poses[:num]
    found = optimise(PoseGraph(poses, []))
    np.testing.assert_array_equal(found.poses, poses)
    assert found.covariances.shape == (num, 6, 6)


def test_twice_is_the_same_to_the_last_bit() -> None:
    graph = random_graph(11, 30, [(0, 29), (3, 20), (7, 25)])
    first, again = optimise(graph), optimise(graph)
    np.testing.assert_array_equal(first.poses, again.poses)
    np.testing.assert_array_equal(first.covariances, again.covariances)


def test_without_gtsam_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph_optimisation.importlib.util, "find_spec", lambda name: None)
    graph_optimisation.load_gtsam.cache_clear()
    with pytest.raises(MissingDependencyError, match=r"pip install 'svc_ros\[graph\]'"):
        optimise(random_graph(0, 2, []))


def test_wheels_that_would_end_the_process_are_not_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph_optimisation.metadata, "version", lambda name: "4.2.2")
    monkeypatch.setattr(graph_optimisation.np, "__version__", "2.2.6")
    monkeypatch.setattr(graph_optimisation.importlib.util, "find_spec", lambda name: object())
    graph_optimisation.load_gtsam.cache_clear()
    with pytest.raises(MissingDependencyError, match="numpy<2"):
        graph_optimisation.load_gtsam()


def test_between_keyframes_the_correction_is_interpolated() -> None:
    graph = random_graph(12, 4, [(0, 3)])
    keyframes = Trajectory(np.array([10, 20, 30, 40]), graph.poses)
    found = optimise(graph)
    stamps = np.array([5, 10, 15, 40, 50])
    odometry = Trajectory(stamps, np.stack([keyframes.at(min(max(int(s), 10), 40)) for s in stamps]))
    way = correct_trajectory(odometry, keyframes, found.poses)
    assert way.stamps_ns.tolist() == stamps.tolist()
    for k, vertex in ((0, 0), (1, 0), (3, 3), (4, 3)):
        np.testing.assert_allclose(way.poses[k], found.poses[vertex], atol=1e-9)
    both = [found.poses[k] @ se3.invert(graph.poses[k]) @ odometry.poses[2] for k in (0, 1)]
    np.testing.assert_allclose(way.poses[2][:3, 3], 0.5 * (both[0] + both[1])[:3, 3], atol=1e-9)


def test_what_moves_as_a_whole_is_not_bent_between_keyframes() -> None:
    turn = se3.make_pose(Rotation.from_euler("z", 10.0, degrees=True).as_matrix(), (1.0, 2.0, 0.0))
    along = [
        se3.make_pose(Rotation.from_euler("z", 2.0 * min(k, 10), degrees=True).as_matrix(), (100.0 + 0.1 * k, 0.0, 0.0))
        for k in range(20)
    ]
    odometry = Trajectory(10 * np.arange(1, 21), np.array(along))
    for ends in ([0, 10], [3, 7, 19], [5]):  # also before the first keyframe and after the last one
        keyframes = Trajectory(odometry.stamps_ns[ends], odometry.poses[ends])
        way = correct_trajectory(odometry, keyframes, turn @ keyframes.poses)
        np.testing.assert_allclose(way.poses, turn @ odometry.poses, atol=1e-9)


def test_without_keyframes_odometry_stays() -> None:
    odometry = Trajectory(np.array([1, 2]), random_graph(0, 2, []).poses)
    nothing = Trajectory(np.zeros(0, np.int64), np.zeros((0, 4, 4)))
    assert correct_trajectory(odometry, nothing, np.zeros((0, 4, 4))) is odometry
