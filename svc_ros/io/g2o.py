"""Pose graphs in g2o's text format: VERTEX_SE3:QUAT and EDGE_SE3:QUAT.

An edge i -> j holds T_i_j, the pose of vertex j in the frame of vertex i, and the information matrix of its error
T_i_j^-1 (T_world_i^-1 T_world_j), that is of a perturbation on the right. g2o measures that error as a shift and the
vector part of a quaternion, half the angle, so that its rotation entries are those of radians times two for each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array, frozen_array
from svc_ros.io.pose_text import parse_numbers, placed_lines, pose_from_values, text_of_numbers

_VERTEX, _EDGE, _FIX = "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "FIX"
_NUM_VALUES = {_VERTEX: 8, _EDGE: 30, _FIX: 1}
_HALF_ANGLES = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # radians in one unit of g2o's rotation error
_UPPER = np.triu_indices(6)


@dataclass(frozen=True, eq=False)
class GraphEdge:
    """What was measured between two vertices, given by their numbers.

    T_target_source: (4, 4) [m], the source in the target's frame; covariance: (6, 6), order x y z [m] then rotations
    about x y z [rad], left perturbation in the target's frame, as a RegistrationResult has it.
    """

    source: int
    target: int
    T_target_source: Array
    covariance: Array

    def __post_init__(self) -> None:
        for name, side in (("T_target_source", 4), ("covariance", 6)):
            value = frozen_array(getattr(self, name), np.float64, f"GraphEdge.{name}", (side, side))
            object.__setattr__(self, name, value)
        if np.linalg.eigvalsh(self.covariance)[0] <= 0.0:
            raise InputError(f"GraphEdge {self.target} -> {self.source}: expected a positive definite covariance")


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """Vertices 0 ... N-1 at poses (N, 4, 4) [m] in one world frame, and what was measured between them."""

    poses: Array
    edges: Sequence[GraphEdge]

    def __post_init__(self) -> None:
        object.__setattr__(self, "poses", frozen_array(self.poses, np.float64, "PoseGraph.poses", (None, 4, 4)))
        for edge in self.edges:
            if not (0 <= edge.source < len(self.poses) and 0 <= edge.target < len(self.poses)):
                raise InputError(
                    f"PoseGraph: expected edges between vertices 0 to {len(self.poses) - 1}, "
                    f"found {edge.target} -> {edge.source}"
                )


def write_g2o(path: str | Path, graph: PoseGraph) -> None:
    """Write a graph; its first vertex is fixed. Raises InputError naming a file that cannot be written."""
    lines = [f"{_VERTEX} {i} {_text_of_pose(pose)}" for i, pose in enumerate(graph.poses)]
    if lines:
        lines.append(f"{_FIX} 0")
    for edge in graph.edges:
        information = text_of_numbers(_information(edge)[_UPPER])
        lines.append(f"{_EDGE} {edge.target} {edge.source} {_text_of_pose(edge.T_target_source)} {information}")
    try:
        Path(path).write_text("".join(f"{line}\n" for line in lines), "utf-8")
    except OSError as error:
        raise InputError(f"{path}: pose graph cannot be written: {error.strerror}") from None


def read_g2o(path: str | Path) -> PoseGraph:
    """Read a graph whose vertices are numbered from 0 without gaps, in any order of lines.

    Raises InputError naming file and line for other elements, wrong counts of values and values that are no numbers.
    """
    poses: dict[int, Array] = {}
    edges: list[GraphEdge] = []
    for place, tag, values in _elements(path):
        if tag == _VERTEX:
            poses[int(values[0])] = pose_from_values(values[1:], place)
        elif tag == _EDGE:
            edges.append(_edge_from(values, place))
    if sorted(poses) != list(range(len(poses))):
        raise InputError(f"{path}: expected vertices numbered from 0 without gaps, found {sorted(poses)[:10]} ...")
    return PoseGraph(np.array([poses[i] for i in range(len(poses))]).reshape(-1, 4, 4), edges)


def _information(edge: GraphEdge) -> Array:
    """Information (6, 6) as g2o has it: perturbation on the right, rotation as half angles."""
    inverse = adjoint(se3.invert(edge.T_target_source))
    on_the_right = inverse @ edge.covariance @ inverse.T
    information = np.linalg.inv(on_the_right) * np.outer(_HALF_ANGLES, _HALF_ANGLES)
    return np.asarray(0.5 * (information + information.T))


def _covariance(information: Array, T_target_source: Array) -> Array:
    """The way back from `_information`."""
    to_left = adjoint(T_target_source)
    on_the_right = np.linalg.inv(information / np.outer(_HALF_ANGLES, _HALF_ANGLES))
    covariance = to_left @ on_the_right @ to_left.T
    return np.asarray(0.5 * (covariance + covariance.T))


def adjoint(T: Array) -> Array:
    """(6, 6), order shift then turn: a perturbation on the right of T as one on its left."""
    R, (x, y, z) = T[:3, :3], T[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[R, cross @ R], [np.zeros((3, 3)), R]])


def _elements(path: str | Path) -> Iterator[tuple[str, str, Array]]:
    """Yield (file:line, element, its values)."""
    for place, line in placed_lines(path, " as a pose graph"):
        words = line.partition("#")[0].split()
        if not words:
            continue
        expected = _NUM_VALUES.get(words[0])
        if expected is None:
            raise InputError(f"{place}: expected one of {', '.join(_NUM_VALUES)}, found {words[0]!r:.40}")
        if len(words) != expected + 1:
            raise InputError(f"{place}: expected {expected} values after {words[0]}, found {len(words) - 1}")
        yield place, words[0], parse_numbers(words[1:], place)


def _edge_from(values: Array, place: str) -> GraphEdge:
    information = np.zeros((6, 6))
    information[_UPPER] = values[9:]
    information += np.triu(information, 1).T
    T = pose_from_values(values[2:9], place)
    try:
        return GraphEdge(int(values[1]), int(values[0]), T, _covariance(information, T))
    except (InputError, np.linalg.LinAlgError):
        raise InputError(f"{place}: expected a positive definite information matrix") from None


def _text_of_pose(T: Array) -> str:
    return text_of_numbers(np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat()]))
