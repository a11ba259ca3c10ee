"""Scans that decisions join: the poses that follow from accepted links, and from nothing else.

Where no accepted link leads from one scan to another, the scans fall into parts, each in the frame of its own first
scan: a link that was not accepted never becomes a pose.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svc_ros.core import se3
from svc_ros.core.errors import InputError
from svc_ros.core.result import RegistrationResult, Verdict
from svc_ros.core.scan import Array, IndexArray


@dataclass(frozen=True, eq=False)
class Link:
    """The decision on one pair: indices of its scans, the verdict, and T_target_source (4, 4) if accepted."""

    source: int
    target: int
    verdict: Verdict
    T_target_source: Array | None = None

    def __post_init__(self) -> None:
        if (self.verdict is Verdict.ACCEPTED) != (self.T_target_source is not None):
            raise InputError("Link: T_target_source belongs to an accepted verdict and to no other")
        if self.T_target_source is not None:
            object.__setattr__(self, "T_target_source", se3.check_pose(self.T_target_source, "Link.T_target_source"))

    @classmethod
    def of(cls, result: RegistrationResult, source: int, target: int) -> Link:
        """The link that a registration of two scans gives."""
        return cls(source, target, result.verdict, result.T_target_source)


@dataclass(frozen=True, eq=False)
class Part:
    """Scans that accepted links join. scan_idx: (S,), the first one's frame is the part's;
    T_part_scan: (S, 4, 4)."""

    scan_idx: IndexArray
    T_part_scan: Array


def join_scans(num_scans: int, links: Sequence[Link]) -> list[Part]:
    """Place scans by accepted links, breadth first from the lowest index; parts in the order of their first scan.

    Where links form a loop, the way with the fewest links counts. Raises InputError for an index out of range.
    """
    ways: dict[int, list[tuple[int, Array]]] = {k: [] for k in range(num_scans)}
    for link in links:
        if not (0 <= link.source < num_scans and 0 <= link.target < num_scans):
            raise InputError(f"link {link.source} -> {link.target}: expected scans from 0 to {num_scans - 1}")
        if link.T_target_source is not None:
            ways[link.target].append((link.source, link.T_target_source))
            ways[link.source].append((link.target, se3.invert(link.T_target_source)))
    parts: list[Part] = []
    placed: set[int] = set()
    for first in range(num_scans):
        if first not in placed:
            poses = _reach(first, ways)
            placed |= poses.keys()
            scan_idx = np.array(sorted(poses), np.int64)
            parts.append(Part(scan_idx, np.stack([poses[int(k)] for k in scan_idx])))
    return parts


def _reach(first: int, ways: dict[int, list[tuple[int, Array]]]) -> dict[int, Array]:
    poses, queue = {first: np.eye(4)}, deque([first])
    while queue:
        here = queue.popleft()
        for there, T_here_there in ways[here]:
            if there not in poses:
                poses[there] = poses[here] @ T_here_there
                queue.append(there)
    return poses
