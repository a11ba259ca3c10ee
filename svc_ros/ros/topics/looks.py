"""What a person looks at: aligned source, blocked points, sight lines, denied surface. Made for subscribers only."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from geometry_msgs.msg import Point, Vector3
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from svc_ros.core.result import RegistrationResult, Verdict
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.se3 import apply
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence
from svc_ros.core.sight.weak_directions import names_of
from svc_ros.report.sight_lines import DENIED_SIZE, MAX_DENIED, MAX_LINES, choose_denied, choose_lines
from svc_ros.ros.streams.decision import Decision, Look
from svc_ros.ros.topics.conversions import cloud_message, header

_LINE_WIDTH_M, _TEXT_HEIGHT_M = 0.02, 0.5
_GREEN, _RED = ColorRGBA(r=0.1, g=0.8, b=0.2, a=0.35), ColorRGBA(r=0.9, g=0.1, b=0.1, a=1.0)
_VERDICT_COLOURS = {
    Verdict.ACCEPTED: ColorRGBA(r=0.1, g=0.8, b=0.2, a=1.0),
    Verdict.UNDECIDED: ColorRGBA(r=0.9, g=0.7, b=0.1, a=1.0),
}
_DEPTH = QoSProfile(depth=2)


class LookOutputs:
    """Publishes `~/aligned`, `~/blocked_points` and `~/sight_lines`, for one thread at a time."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._aligned = node.create_publisher(PointCloud2, "~/aligned", _DEPTH)
        self._blocked = node.create_publisher(PointCloud2, "~/blocked_points", _DEPTH)
        self._lines = node.create_publisher(MarkerArray, "~/sight_lines", _DEPTH)

    def publish(self, decision: Decision) -> None:
        """Send what somebody looks at of one decision."""
        look, evidence = decision.look, decision.result.evidence
        if look is None or decision.source is None:
            return
        stamp_ns = decision.source.stamp_ns
        if decision.result.accepted and self._aligned.get_subscription_count():
            points = apply(look.T_frame_target @ look.T_target_source, look.points)
            self._aligned.publish(cloud_message(points, stamp_ns, look.frame_id))
        if evidence is None:
            return
        if self._blocked.get_subscription_count():
            points, from_source = blocked_points(look, evidence)
            self._blocked.publish(cloud_message(points, stamp_ns, look.frame_id, {"from_source": from_source}))
        if self._lines.get_subscription_count():
            markers = sight_line_markers(look, evidence, stamp_ns)
            markers.markers.append(verdict_marker(look, decision.result, stamp_ns))
            self._lines.publish(markers)

    def destroy(self) -> None:
        """Give the publishers back."""
        for publisher in (self._aligned, self._blocked, self._lines):
            self._node.destroy_publisher(publisher)


def blocked_points(look: Look, evidence: SightViewEvidence) -> tuple[Array, Array]:
    """Points (B, 3) [m] whose sight line is blocked, in the look's frame; (B,) 1 where they are the source's."""
    near = look.target.points[evidence.source_in_target.blocked_idx]
    far = apply(look.T_target_source, look.source.points[evidence.target_in_source.blocked_idx])
    from_source = np.repeat([0.0, 1.0], [len(near), len(far)])
    return apply(look.T_frame_target, np.concatenate([near, far])), from_source


def sight_line_markers(look: Look, evidence: SightViewEvidence, stamp_ns: int) -> MarkerArray:
    """Lines from both sensors to what they saw, green where the way is clear, red where a point stands in it; and red
    points, surface that the other sensor looked through.

    The first marker deletes all earlier ones; of each colour and scan at most MAX_LINES lines and MAX_DENIED points are
    drawn, evenly chosen.
    """
    first = Marker(header=header(stamp_ns, look.frame_id), action=Marker.DELETEALL)
    T_frame_source = look.T_frame_target @ look.T_target_source
    markers = [
        *_markers(look.target, evidence.source_in_target, look.T_frame_target, "target"),
        *_markers(look.source, evidence.target_in_source, T_frame_source, "source"),
        *_denied(look.target, evidence.target_surface, look.T_frame_target, "target"),
        *_denied(look.source, evidence.source_surface, T_frame_source, "source"),
    ]
    for marker in markers:
        marker.header = first.header
    return MarkerArray(markers=[first, *markers])


def verdict_marker(look: Look, result: RegistrationResult, stamp_ns: int) -> Marker:
    """Verdict, reason and weak directions as a text above the place where the judged pose puts the source's sensor."""
    text = f"{result.verdict.value}: {result.reason.value}"
    if result.weak_directions:
        text += f"\nweak: {names_of(result.weak_directions)}"
    T_frame_source = look.T_frame_target @ look.T_target_source
    marker = Marker(header=header(stamp_ns, look.frame_id), ns="verdict", type=Marker.TEXT_VIEW_FACING, text=text)
    marker.color = _VERDICT_COLOURS.get(result.verdict, _RED)
    (marker.pose.position,) = _points(apply(T_frame_source, look.source.sensor_origin[None]))
    marker.pose.position.z += 2.0 * _TEXT_HEIGHT_M
    marker.pose.orientation.w = 1.0
    marker.scale.z = _TEXT_HEIGHT_M
    return marker


def _markers(scan: PreparedScan, lines: SightLines, T_frame_scan: Array, side: str) -> Iterator[Marker]:
    """The clear and the blocked lines of one scan as two markers; a marker without lines is left out."""
    drawn = choose_lines(lines, len(scan), MAX_LINES)
    (origin,) = _points(apply(T_frame_scan, scan.sensor_origin[None]))
    for number, (kind, colour, chosen) in enumerate(
        (("clear", _GREEN, drawn.clear_idx), ("blocked", _RED, drawn.blocked_idx))
    ):
        if len(chosen) == 0:
            continue
        ends = _points(apply(T_frame_scan, scan.points[chosen]))
        marker = Marker(ns=f"{side}_{kind}", id=number, type=Marker.LINE_LIST, action=Marker.ADD, color=colour)
        marker.scale = Vector3(x=_LINE_WIDTH_M, y=0.0, z=0.0)
        marker.pose.orientation.w = 1.0
        marker.points = [point for end in ends for point in (origin, end)]
        yield marker


def _denied(scan: PreparedScan, surface: SeenSurface, T_frame_scan: Array, side: str) -> Iterator[Marker]:
    """The points of one scan that the other sensor looked through, as one marker; none where there are none."""
    chosen = choose_denied(surface, MAX_DENIED)
    if len(chosen) == 0:
        return
    size = DENIED_SIZE * scan.voxel_size_m
    marker = Marker(ns=f"{side}_denied", id=2, type=Marker.POINTS, action=Marker.ADD, color=_RED)
    marker.scale = Vector3(x=size, y=size, z=0.0)
    marker.pose.orientation.w = 1.0
    marker.points = _points(apply(T_frame_scan, scan.points[chosen]))
    yield marker


def _points(points: Array) -> list[Point]:
    return [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]
