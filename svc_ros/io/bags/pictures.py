"""What a person looks at of one decision, as the node shows it: aligned source, blocked points, sight lines, denied
surface, verdict.

Here are the plain numbers, and their messages for a recorded file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from svc_ros.core.scan import Array
from svc_ros.io.bags.mcap_folder import McapFolder

MARKERS_TYPE = "visualization_msgs/msg/MarkerArray"
LINE_WIDTH_M, TEXT_HEIGHT_M = 0.02, 0.5
_ADD, _DELETE_ALL, _LINE_LIST, _POINTS, _TEXT = 0, 3, 5, 8, 9

Colour = tuple[float, float, float, float]  # red, green, blue, opacity, each in [0, 1]


@dataclass(frozen=True, eq=False)
class LineGroup:
    """Lines of one colour from `origin` (3,) to `ends` (L, 3) [m]; namespace and number name the marker."""

    namespace: str
    number: int
    colour: Colour
    origin: Array
    ends: Array


@dataclass(frozen=True, eq=False)
class PointGroup:
    """Points (P, 3) [m] of one colour, each a square of that size; namespace and number name the marker."""

    namespace: str
    number: int
    colour: Colour
    points: Array
    size_m: float


@dataclass(frozen=True, eq=False)
class Picture:
    """One decision in the frame `frame_id`, lengths in [m].

    aligned: (N, 3), the source where it was accepted, else None; blocked: (B, 3), points whose sight line is blocked;
    from_source: (B,), 1 where they are the source's, else 0; denied: surface that the other sensor looked through;
    label stands above label_at (3,).
    """

    frame_id: str
    aligned: Array | None
    blocked: Array
    from_source: Array
    lines: Sequence[LineGroup]
    denied: Sequence[PointGroup]
    label: str
    label_at: Array
    label_colour: Colour


def marker_array(bag: McapFolder, picture: Picture, stamp_ns: int) -> Any:
    """MarkerArray: one marker deletes the earlier ones, one for each group of lines or points, one for the label."""
    header = bag.header(stamp_ns, picture.frame_id)
    markers = [_marker(bag, header, action=_DELETE_ALL)]
    for group in picture.lines:
        both = np.empty((2 * len(group.ends), 3))
        both[0::2], both[1::2] = group.origin, group.ends
        markers.append(
            _marker(
                bag, header, ns=group.namespace, id=group.number, type=_LINE_LIST, points=_points(bag, both),
                scale=_xyz(bag, "Vector3", LINE_WIDTH_M, 0.0, 0.0), color=_colour(bag, group.colour),
            )
        )  # fmt: skip
    for points in picture.denied:
        scale = _xyz(bag, "Vector3", points.size_m, points.size_m, 0.0)
        markers.append(
            _marker(
                bag, header, ns=points.namespace, id=points.number, type=_POINTS, points=_points(bag, points.points),
                scale=scale, color=_colour(bag, points.colour),
            )
        )  # fmt: skip
    x, y, z = picture.label_at.tolist()
    place = _pose(bag, x, y, z + 2.0 * TEXT_HEIGHT_M)
    markers.append(
        _marker(
            bag, header, ns="verdict", type=_TEXT, text=picture.label, pose=place,
            scale=_xyz(bag, "Vector3", 0.0, 0.0, TEXT_HEIGHT_M), color=_colour(bag, picture.label_colour),
        )
    )  # fmt: skip
    return bag.make(MARKERS_TYPE, markers=markers)


def _marker(bag: McapFolder, header: Any, **wanted: Any) -> Any:
    """A marker with what is wanted, and nothing in all its other fields."""
    make, nothing = bag.make, np.zeros(0, np.uint8)
    never = make("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
    empty_header = bag.header(0, "")
    plain: dict[str, Any] = {
        "header": header, "ns": "", "id": 0, "type": 0, "action": _ADD, "pose": _pose(bag, 0.0, 0.0, 0.0),
        "scale": _xyz(bag, "Vector3", 0.0, 0.0, 0.0), "color": _colour(bag, (0.0, 0.0, 0.0, 0.0)), "lifetime": never,
        "frame_locked": False, "points": [], "colors": [], "texture_resource": "", "uv_coordinates": [], "text": "",
        "texture": make("sensor_msgs/msg/CompressedImage", header=empty_header, format="", data=nothing),
        "mesh_resource": "", "mesh_file": make("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        "mesh_use_embedded_materials": False,
    }  # fmt: skip
    return make("visualization_msgs/msg/Marker", **(plain | wanted))


def _pose(bag: McapFolder, x: float, y: float, z: float) -> Any:
    upright = bag.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    return bag.make("geometry_msgs/msg/Pose", position=_xyz(bag, "Point", x, y, z), orientation=upright)


def _points(bag: McapFolder, points: Array) -> list[Any]:
    kind = bag.store.types["geometry_msgs/msg/Point"]
    return [kind(x=x, y=y, z=z) for x, y, z in points.tolist()]


def _xyz(bag: McapFolder, kind: str, x: float, y: float, z: float) -> Any:
    return bag.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def _colour(bag: McapFolder, colour: Colour) -> Any:
    return bag.make("std_msgs/msg/ColorRGBA", **dict(zip("rgba", colour, strict=True)))
