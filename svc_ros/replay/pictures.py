"""From a decision to what a person looks at: the same lines, colours and names as the node's."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from svc_ros.core.result import Verdict
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.se3 import apply
from svc_ros.core.sight.evidence import SeenSurface, SightLines
from svc_ros.io.bags.pictures import Colour, LineGroup, Picture, PointGroup
from svc_ros.pipeline.stream import StreamDecision
from svc_ros.report.sight_lines import DENIED_SIZE, MAX_DENIED, MAX_LINES, choose_denied, choose_lines

_GREEN: Colour = (0.1, 0.8, 0.2, 0.35)
_RED: Colour = (0.9, 0.1, 0.1, 1.0)
_VERDICT_COLOURS: dict[Verdict, Colour] = {
    Verdict.ACCEPTED: (0.1, 0.8, 0.2, 1.0),
    Verdict.UNDECIDED: (0.9, 0.7, 0.1, 1.0),
}


def draw(decision: StreamDecision, odometry_frame: str) -> Picture | None:
    """The picture of a decision, in `odometry_frame` where the target's place in it is known, else in the target's own.

    None where no pose was judged.
    """
    result = decision.result
    if decision.scans is None or result.best_candidate is None or result.evidence is None:
        return None
    source, target = decision.scans
    in_odometry = decision.T_odom_target is not None
    T_frame_target = decision.T_odom_target if decision.T_odom_target is not None else np.eye(4)
    T_frame_source = T_frame_target @ result.best_candidate
    in_target, in_source = result.evidence.source_in_target, result.evidence.target_in_source
    near = apply(T_frame_target, target.points[in_target.blocked_idx])
    far = apply(T_frame_source, source.points[in_source.blocked_idx])
    return Picture(
        frame_id=odometry_frame if in_odometry else decision.target_frame.lstrip("/") or "target",
        aligned=apply(T_frame_source, source.points) if result.accepted else None,
        blocked=np.concatenate([near, far]),
        from_source=np.repeat([0.0, 1.0], [len(near), len(far)]),
        lines=[
            *_lines(target, in_target, T_frame_target, "target"),
            *_lines(source, in_source, T_frame_source, "source"),
        ],
        denied=[
            *_denied(target, result.evidence.target_surface, T_frame_target, "target"),
            *_denied(source, result.evidence.source_surface, T_frame_source, "source"),
        ],
        label=f"{result.verdict.value}: {result.reason.value}",
        label_at=apply(T_frame_source, source.sensor_origin[None])[0],
        label_colour=_VERDICT_COLOURS.get(result.verdict, _RED),
    )


def _lines(scan: PreparedScan, lines: SightLines, T_frame_scan: Array, side: str) -> Iterator[LineGroup]:
    """The clear and the blocked lines of one scan; a group without lines is left out."""
    origin = apply(T_frame_scan, scan.sensor_origin[None])[0]
    chosen = choose_lines(lines, len(scan), MAX_LINES)
    kinds = (("clear", _GREEN, chosen.clear_idx), ("blocked", _RED, chosen.blocked_idx))
    for number, (kind, colour, idx) in enumerate(kinds):
        if len(idx):
            yield LineGroup(f"{side}_{kind}", number, colour, origin, apply(T_frame_scan, scan.points[idx]))


def _denied(scan: PreparedScan, surface: SeenSurface, T_frame_scan: Array, side: str) -> Iterator[PointGroup]:
    """The points of one scan that the other sensor looked through; none where there are none."""
    idx = choose_denied(surface, MAX_DENIED)
    if len(idx):
        points = apply(T_frame_scan, scan.points[idx])
        yield PointGroup(f"{side}_denied", 2, _RED, points, DENIED_SIZE * scan.voxel_size_m)
