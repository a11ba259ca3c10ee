"""Transforms between named frames, recorded over time: what tf2 answers live, answered from a bag.

An edge holds `T_parent_child`. A timed edge answers inside its recorded span only and is interpolated between its
samples (translation along the line, rotation along the great circle); a static edge answers at any time.
"""

from __future__ import annotations

import itertools
from bisect import bisect_left
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.se3 import Array, check_pose, invert, make_pose, nearest_pose
from svc_ros.io.stamps import text_from_ns


def interpolate_poses(T_before: ArrayLike, T_after: ArrayLike, share: float) -> Array:
    """Pose (4, 4) at `share` in [0, 1] of the way between two poses (4, 4): lerp of t, slerp of R."""
    T0, T1 = np.asarray(T_before, np.float64), np.asarray(T_after, np.float64)
    R = Slerp([0.0, 1.0], Rotation.from_matrix(np.stack([T0[:3, :3], T1[:3, :3]])))(share).as_matrix()
    return make_pose(R, (1.0 - share) * T0[:3, 3] + share * T1[:3, 3])


def normalise_frame(frame: str) -> str:
    """The frame's name without the leading slash that ROS 1 recordings carry; an empty one raises InputError."""
    name = frame.strip().lstrip("/")
    if not name:
        raise InputError(f"frame: expected a name, found {frame!r}")
    return name


@dataclass
class _Edge:
    """All samples of one parent-child pair; the later of two samples with one stamp stays."""

    static: bool
    samples: dict[int, Array] = field(default_factory=dict)
    stamps: list[int] = field(default_factory=list)  # sorted keys of samples, rebuilt when it is shorter than them

    def add(self, stamp_ns: int, T: Array) -> None:
        self.samples[0 if self.static else stamp_ns] = T

    def at(self, stamp_ns: int, max_gap_ns: int | None) -> Array:
        """Pose at the stamp, or TransformUnavailableError with the reason only (the caller names the frames)."""
        if self.static:
            return self.samples[0]
        if stamp_ns in self.samples:
            return self.samples[stamp_ns]
        before, after = self._neighbours(stamp_ns)
        if max_gap_ns is not None and after - before > max_gap_ns:
            raise TransformUnavailableError(
                f"its samples at {text_from_ns(before)} s and {text_from_ns(after)} s are farther apart than "
                f"the largest gap of {text_from_ns(max_gap_ns)} s"
            )
        share = (stamp_ns - before) / (after - before)
        return interpolate_poses(self.samples[before], self.samples[after], share)

    def _neighbours(self, stamp_ns: int) -> tuple[int, int]:
        if len(self.stamps) != len(self.samples):
            self.stamps = sorted(self.samples)
        at = bisect_left(self.stamps, stamp_ns)
        if at in (0, len(self.stamps)):
            raise TransformUnavailableError(
                f"it is recorded from {text_from_ns(self.stamps[0])} s to {text_from_ns(self.stamps[-1])} s only"
            )
        return self.stamps[at - 1], self.stamps[at]


class TransformTree:
    """Frames joined by recorded transforms.

    max_gap_ns: two neighbouring samples farther apart than this are not interpolated (None: any gap is).
    """

    def __init__(self, max_gap_ns: int | None = None) -> None:
        self._max_gap_ns = max_gap_ns
        self._edges: dict[str, dict[str, _Edge]] = {}  # child -> parent -> edge; more than one parent is a fault
        self._faults: dict[str, str] = {}

    @property
    def frames(self) -> list[str]:
        """Names of all frames, sorted."""
        parents = {parent for edges in self._edges.values() for parent in edges}
        return sorted(parents | set(self._edges) | set(self._faults))

    def add(self, parent: str, child: str, stamp_ns: int, T_parent_child: ArrayLike, static: bool = False) -> None:
        """Record one sample: p_parent = T_parent_child p_child, T (4, 4) [m].

        Raises InputError for a T that is no rigid motion, a frame that is its own parent, and an edge that is added
        both as static and over time. Samples may arrive in any order; of two with one stamp the later added stays.
        """
        parent, child = normalise_frame(parent), normalise_frame(child)
        if parent == child:
            raise InputError(f"transform {parent} -> {child}: a frame cannot be its own parent")
        T = nearest_pose(check_pose(T_parent_child, f"transform {parent} -> {child}"))
        edge = self._edges.setdefault(child, {}).setdefault(parent, _Edge(static))
        if edge.static != static:
            raise InputError(f"transform {parent} -> {child}: recorded both as static and over time")
        edge.add(int(stamp_ns), T)

    def mark_faulty(self, child: str, cause: str) -> None:
        """Remember that the recording says something impossible about `child`: look-ups through it are refused.

        A bag with one broken transform stays usable for the frames that do not depend on it.
        """
        self._faults.setdefault(child.strip().lstrip("/"), cause)

    def lookup(self, target_frame: str, source_frame: str, stamp_ns: int) -> Array:
        """T_target_source (4, 4) [m] at a stamp, interpolated, through the frames' nearest common ancestor.

        Raises TransformUnavailableError naming both frames, the stamp, and what is missing: a frame, a connection,
        or a transform at that time.
        """
        target, source = normalise_frame(target_frame), normalise_frame(source_frame)
        question = f"transform {target} <- {source} at {text_from_ns(stamp_ns)} s"
        self._check_known(question, target, source)
        up_target, up_source = self._ancestors(target, question), self._ancestors(source, question)
        common = next((frame for frame in up_target if frame in set(up_source)), None)
        if common is None:
            self._check_faults([*up_target, *up_source], question)
            raise TransformUnavailableError(
                f"{question}: the frames are not connected ({target} hangs on {up_target[-1]}, {source} on "
                f"{up_source[-1]}; frames recorded: {', '.join(self.frames)})"
            )
        T_common_target = self._climb(up_target, common, stamp_ns, question)
        return np.asarray(invert(T_common_target) @ self._climb(up_source, common, stamp_ns, question))

    def _check_known(self, question: str, *wanted: str) -> None:
        frames = self.frames
        missing = [frame for frame in wanted if frame not in frames]
        if missing and len(set(wanted)) > 1:
            known = ", ".join(frames) or "none"
            raise TransformUnavailableError(f"{question}: no frame {missing[0]!r} (frames recorded: {known})")

    def _check_faults(self, frames: list[str], question: str) -> None:
        for frame in frames:
            if frame in self._faults:
                raise TransformUnavailableError(f"{question}: {self._faults[frame]}")

    def _ancestors(self, frame: str, question: str) -> list[str]:
        """The frame, its parent, its grandparent ... up to the root."""
        chain = [frame]
        while parents := self._edges.get(chain[-1]):
            if len(parents) > 1:
                raise TransformUnavailableError(
                    f"{question}: frame {chain[-1]!r} has more than one parent ({', '.join(sorted(parents))})"
                )
            parent = next(iter(parents))
            if parent in chain:
                raise TransformUnavailableError(f"{question}: the frames form a loop ({' -> '.join([*chain, parent])})")
            chain.append(parent)
        return chain

    def _climb(self, chain: list[str], ancestor: str, stamp_ns: int, question: str) -> Array:
        """T_ancestor_frame, where `chain` starts at the frame and passes the ancestor."""
        T = np.eye(4)
        for child, parent in itertools.pairwise(chain):
            if child == ancestor:
                break
            self._check_faults([child], question)
            try:
                T = self._edges[child][parent].at(stamp_ns, self._max_gap_ns) @ T
            except TransformUnavailableError as error:
                raise TransformUnavailableError(f"{question}: {parent} -> {child}: {error}") from None
        return T
