"""g2o files: round trips, the meaning of the information matrix, malformed lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import InputError
from svc_ros.core.se3 import invert, make_pose
from svc_ros.io.g2o import GraphEdge, PoseGraph, read_g2o, write_g2o

VERTEX = "VERTEX_SE3:QUAT 0 1 2 3 0 0 0 1"
IDENTITY_UPPER = " ".join(f"{v:g}" for v in np.eye(6)[np.triu_indices(6)])
EDGE = f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {IDENTITY_UPPER}"


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return make_pose(Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), rng.normal(size=3) * 10)


def random_covariance(rng: np.random.Generator) -> np.ndarray:
    A = rng.normal(size=(6, 6)) * np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])[:, None]
    return A @ A.T + np.diag([1e-4] * 3 + [1e-6] * 3)


@pytest.fixture
def graph() -> PoseGraph:
    rng = np.random.default_rng(0)
    poses = np.array([random_pose(rng) for _ in range(5)])
    edges = [GraphEdge(k + 1, k, invert(poses[k]) @ poses[k + 1], random_covariance(rng)) for k in range(4)]
    return PoseGraph(poses, [*edges, GraphEdge(4, 0, random_pose(rng), random_covariance(rng))])


def line_file(folder: Path, *lines: str) -> Path:
    path = folder / "graph.g2o"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_round_trip_keeps_poses_edges_and_covariances(tmp_path: Path, graph: PoseGraph) -> None:
    write_g2o(tmp_path / "a.g2o", graph)
    back = read_g2o(tmp_path / "a.g2o")
    np.testing.assert_allclose(back.poses, graph.poses, atol=1e-9)
    assert [(e.source, e.target) for e in back.edges] == [(e.source, e.target) for e in graph.edges]
    for found, expected in zip(back.edges, graph.edges, strict=True):
        np.testing.assert_allclose(found.T_target_source, expected.T_target_source, atol=1e-9)
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-5, atol=1e-11)


def test_the_form_is_that_of_g2o(tmp_path: Path) -> None:
    T = make_pose(Rotation.from_euler("z", 90, degrees=True).as_matrix(), (1, 2, 3))
    graph = PoseGraph(np.array([np.eye(4), T]), [GraphEdge(1, 0, T, np.eye(6))])
    write_g2o(tmp_path / "a.g2o", graph)
    first, second, fixed, edge = (tmp_path / "a.g2o").read_text().splitlines()
    half = f"{np.sqrt(0.5):.12g}"
    assert first == "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1"
    assert second == f"VERTEX_SE3:QUAT 1 1 2 3 0 0 {half} {half}"
    assert fixed == "FIX 0"
    assert edge.startswith(f"EDGE_SE3:QUAT 0 1 1 2 3 0 0 {half} {half} ")  # from the target to the source
    assert len(edge.split()) == 1 + 2 + 7 + 21


def test_information_is_that_of_g2o_s_own_error(tmp_path: Path) -> None:
    """Errors drawn from the covariance, measured as g2o does: their covariance is the inverse of the information."""
    rng = np.random.default_rng(3)
    T, covariance = random_pose(rng), 1e-4 * random_covariance(rng)
    write_g2o(tmp_path / "a.g2o", PoseGraph(np.array([np.eye(4), T]), [GraphEdge(1, 0, T, covariance)]))
    values = [float(v) for v in (tmp_path / "a.g2o").read_text().splitlines()[-1].split()[10:]]
    information = np.zeros((6, 6))
    information[np.triu_indices(6)] = values
    information += np.triu(information, 1).T
    errors = []
    for shift_and_turn in rng.multivariate_normal(np.zeros(6), covariance, 20_000):
        (a, b, c), twist = shift_and_turn[3:], np.zeros((4, 4))
        twist[:3, :3], twist[:3, 3] = [[0, -c, b], [c, 0, -a], [-b, a, 0]], shift_and_turn[:3]
        delta = invert(T) @ (np.eye(4) + twist + 0.5 * twist @ twist) @ T  # a perturbation on the left, to second order
        quaternion = Rotation.from_matrix(delta[:3, :3]).as_quat(canonical=True)
        errors.append(np.concatenate([delta[:3, 3], quaternion[:3]]))
    whitened = information @ np.cov(np.array(errors).T)
    np.testing.assert_allclose(np.linalg.eigvals(whitened).real, np.ones(6), atol=0.06)


def test_second_order_is_enough_above() -> None:
    twist = np.zeros((4, 4))
    twist[0, 1], twist[1, 0], twist[0, 3] = -1e-3, 1e-3, 1e-2
    np.testing.assert_allclose(np.eye(4) + twist + 0.5 * twist @ twist, expm(twist), atol=1e-8)


def test_an_empty_graph_is_a_file(tmp_path: Path) -> None:
    write_g2o(tmp_path / "a.g2o", PoseGraph(np.zeros((0, 4, 4)), []))
    assert len(read_g2o(tmp_path / "a.g2o").poses) == 0


def test_comments_and_blank_lines_are_skipped(tmp_path: Path) -> None:
    path = line_file(tmp_path, "# a graph", "", VERTEX, VERTEX.replace(" 0 1", " 1 1", 1), EDGE + "  # a loop")
    graph = read_g2o(path)
    assert len(graph.poses) == 2
    np.testing.assert_allclose(graph.poses[0][:3, 3], (1, 2, 3))
    assert (graph.edges[0].source, graph.edges[0].target) == (1, 0)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("VERTEX_SE2 0 1 2 3", "expected one of VERTEX_SE3:QUAT"),
        ("VERTEX_SE3:QUAT 0 1 2 3 0 0 0", "expected 8 values after VERTEX_SE3:QUAT, found 7"),
        ("VERTEX_SE3:QUAT 0 1 2 x 0 0 0 1", "expected numbers"),
        ("VERTEX_SE3:QUAT 0 1 2 nan 0 0 0 1", "expected finite numbers"),
        ("VERTEX_SE3:QUAT 0 1 2 3 0 0 0 2", "quaternion of length 1"),
        (EDGE.replace(IDENTITY_UPPER, "0 " * 21), "positive definite"),
    ],
)
def test_malformed_lines_are_named(tmp_path: Path, line: str, words: str) -> None:
    path = line_file(tmp_path, VERTEX, line)
    with pytest.raises(InputError, match=words) as caught:
        read_g2o(path)
    assert f"{path}:2" in str(caught.value)


def test_gaps_in_the_numbers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="numbered from 0"):
        read_g2o(line_file(tmp_path, VERTEX, VERTEX.replace(" 0 1", " 2 1", 1)))


def test_missing_and_unwritable_files_are_named(tmp_path: Path, graph: PoseGraph) -> None:
    with pytest.raises(InputError, match=r"nothing\.g2o: cannot be read"):
        read_g2o(tmp_path / "nothing.g2o")
    with pytest.raises(InputError, match="cannot be written"):
        write_g2o(tmp_path / "no" / "folder.g2o", graph)


def test_impossible_graphs_are_refused() -> None:
    with pytest.raises(InputError, match="vertices 0 to 0"):
        PoseGraph(np.eye(4)[None], [GraphEdge(1, 0, np.eye(4), np.eye(6))])
    with pytest.raises(InputError, match="positive definite"):
        GraphEdge(1, 0, np.eye(4), np.zeros((6, 6)))
