"""A scan at a pose in a map, judged against the keyframes around it, each from where its own sensor stood.

Never against one merged cloud: a cloud that several sensors saw has no origin from which a sight line could be denied.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.registration import verify
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Array, IndexArray, PreparedScan
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.place import PlaceLook

_LOOKED_THROUGH = 4  # times the wanted neighbours: those that show too little of the scan give way to farther ones
_SPREAD = 2.0  # keyframe distances between neighbours: two that stood in one spot have seen the same


class KeyframeMap(Protocol):
    """Keyframes of earlier runs in one frame, the map's."""

    @property
    def config(self) -> Config:
        """What its scans were prepared with."""
        ...

    @property
    def poses(self) -> Array:
        """T_map_scan of every keyframe, (N, 4, 4) [m]."""
        ...

    @property
    def stamps_ns(self) -> IndexArray:
        """Their stamps, (N,)."""
        ...

    def __len__(self) -> int: ...

    def keyframe(self, index: int) -> Keyframe:
        """One of them."""
        ...

    def near(self, T_map_scan: Array, radius_m: float, most: int) -> list[int]:
        """At most so many that stood within the radius of a pose (4, 4), the nearest first."""
        ...

    def similar(self, look: PlaceLook, most: int) -> list[tuple[int, float]]:
        """At most so many whose places look most like this one, with their likeness, the most alike first."""
        ...


@dataclass(frozen=True, eq=False)
class Placed:
    """A judged pose of a scan in the map.

    result: the verdict, against the keyframe `target` (its index; None where none is near); T_map_scan: (4, 4), where
    the judged pose puts the scan; scans: (source, target) as they were judged, as in StreamDecision.
    """

    result: RegistrationResult
    T_map_scan: Array
    target: int | None = None
    scans: tuple[PreparedScan, PreparedScan] | None = None

    @property
    def probability(self) -> float:
        """How sure the verdict is that the pose is right; 0 where nothing was judged."""
        return self.result.probability or 0.0

    @property
    def is_denied(self) -> bool:
        """Whether sight lines say no to the pose."""
        return self.result.verdict is Verdict.REJECTED and self.result.reason is Reason.SIGHT_VIEW_BLOCKED

    @property
    def is_moved(self) -> bool:
        """Whether another pose than the one that was asked about fits better."""
        return self.result.verdict is Verdict.REJECTED and self.result.reason is Reason.AMBIGUOUS


def judge_among_neighbours(
    this: Keyframe, T_map_scan: Array, keyframes: KeyframeMap, config: Config, num_points: int | None = None
) -> Placed:
    """Judge a pose (4, 4) of a scan against the nearest keyframes that show enough of it, and refine it.

    All of them look at the same scan, so that their answers are no independent ones: one that denies the pose along
    its sight lines is enough to reject it; it is accepted where one accepts and none denies, and no more probable than
    the surest makes it. num_points: least points that each pair is judged with, None for all.
    """
    looks: list[Placed] = []
    num_telling = 0
    for index in _spread_out(T_map_scan, keyframes, config):
        look = _look(this, T_map_scan, keyframes, index, config, num_points)
        if look.is_denied and not shows_enough(look, config):
            continue  # of what hardly overlaps, the little that is seen may be at its edges
        looks.append(look)
        num_telling += shows_enough(look, config)
        if look.result.accepted:
            T_map_scan = look.T_map_scan
        if look.is_denied or num_telling == config.localization.max_neighbours:
            break
    # What decides is a denial, else the surest acceptance, else what is nearest to acceptance.
    if looks:
        return max(looks, key=lambda look: (look.is_denied, look.result.accepted, _is_open(look), look.probability))
    return nowhere(f"no keyframe of the map within {config.preprocess.max_range_m:g} m shows it", config)


def nowhere(why: str, config: Config) -> Placed:
    """Of a scan that nothing in the map can be held against."""
    return Placed(
        RegistrationResult(Verdict.UNDECIDED, Reason.INSUFFICIENT_EVIDENCE, config.method, detail=why), np.eye(4)
    )


def place_against(
    this: Keyframe, result: RegistrationResult, keyframes: KeyframeMap, index: int, target: Keyframe
) -> Placed:
    """What a registration of a scan to one keyframe says about its place in the map."""
    T = np.eye(4) if result.best_candidate is None else result.best_candidate
    return Placed(result, se3.nearest_pose(keyframes.poses[index] @ T), index, (this.scan, target.scan))


def is_same_place(T_map_scan: Array, other: Array, config: Config, drift_m: float = 0.0) -> bool:
    """Whether two poses (4, 4) of a scan are one, as far as refinement may move a pose; drift_m: and so much more."""
    angle, distance = se3.pose_error(T_map_scan, other)
    limits = config.shortlist
    return angle <= limits.max_moved_rotation_deg and distance <= limits.max_moved_translation_m + drift_m


def shows_enough(look: Placed, config: Config) -> bool:
    """Whether so much of the scan was seen that a verdict against its pose tells something."""
    evidence = look.result.evidence
    if evidence is None or evidence.oriented_overlap_ratio < config.decision.min_oriented_overlap:
        return False
    return look.is_denied or not is_of_one_wall(look, config)


def is_of_one_wall(look: Placed, config: Config) -> bool:
    """Whether the scan shows hardly more than one wall: that a different pose fits better tells nothing then."""
    if look.scans is None:
        return True
    normals = look.scans[0].normals
    structure = np.linalg.eigvalsh(normals.T @ normals / max(len(normals), 1))[1]  # 0 of one wall, 1/3 of any three
    return bool(structure * config.decision.min_oriented_overlap < config.decision.min_constraint)


def _spread_out(T_map_scan: Array, keyframes: KeyframeMap, config: Config) -> list[int]:
    """The keyframes around a pose, the nearest first, but those that stood close to an earlier one at the end."""
    most = _LOOKED_THROUGH * config.localization.max_neighbours
    apart_m = _SPREAD * config.loop_closure.keyframe_distance_m
    first: list[int] = []
    later: list[int] = []
    for index in keyframes.near(T_map_scan, config.preprocess.max_range_m, most):
        ways = keyframes.poses[first, :3, 3] - keyframes.poses[index, :3, 3]
        (first if (np.linalg.norm(ways, axis=1) >= apart_m).all() else later).append(index)
    return first + later


def _look(
    this: Keyframe, T_map_scan: Array, keyframes: KeyframeMap, index: int, config: Config, num_points: int | None
) -> Placed:
    with keyframes.keyframe(index).lent() as target:
        scans = this.scan, target.scan
        if num_points is not None:
            scans = this.thinned(num_points), target.thinned(num_points)
        result = verify(*scans, se3.invert(keyframes.poses[index]) @ T_map_scan, config)
    assert result.best_candidate is not None  # a pose was given
    return Placed(result, se3.nearest_pose(keyframes.poses[index] @ result.best_candidate), index, scans)


def _is_open(look: Placed) -> bool:
    return look.result.verdict is Verdict.UNDECIDED
