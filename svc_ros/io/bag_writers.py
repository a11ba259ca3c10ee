"""Bags that this package writes: decisions as one MCAP file, simulated clouds and transforms as a ROS 2 bag folder.

Messages are stamped with the time of the scan that they are about, never with the time of writing.
"""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from svc_ros.core.errors import InputError
from svc_ros.core.result import RegistrationResult
from svc_ros.core.se3 import check_pose
from svc_ros.io.mcap_folder import POSE_TYPE, TRANSFORM_TYPE, McapFolder
from svc_ros.io.point_cloud2 import cloud_layout
from svc_ros.io.results import decision_values
from svc_ros.io.transforms import normalise_frame

NODE_NAME = "svc_registration"
RESULT_TOPICS = {
    "transform": TRANSFORM_TYPE,
    "pose": POSE_TYPE,
    "rejected": "std_msgs/msg/Bool",
    "decision": "diagnostic_msgs/msg/DiagnosticArray",
}
# Of an accepted pose whose method gives none, as the node has it: 1 m and 10 deg, so that nobody takes it for certain.
UNKNOWN_COVARIANCE = np.diag([1.0, 1.0, 1.0, *[np.radians(10.0) ** 2] * 3])
_MAX_STAMP_NS = 2**31 * 1_000_000_000  # builtin_interfaces/Time counts seconds in 32 bits


class ResultWriter:
    """Decisions as one MCAP file with the topics of the node, `/svc_registration/...`:

    transform (TransformStamped, accepted only; header.frame_id = target's frame, child_frame_id = source's),
    pose (PoseWithCovarianceStamped, accepted only; UNKNOWN_COVARIANCE where the method gives none), rejected (Bool)
    and decision (DiagnosticArray, level OK if accepted, else WARN) for every pair. Scans of one sensor share one
    frame: the child is then named `FRAME/source`, because a frame cannot be its own parent; a scan without a frame is
    called `target` or `source`.

    The file appears when the writer is closed, also after an error, and replaces an older one.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if self.path.suffix != ".mcap" or self.path.is_dir():
            raise InputError(f"{path}: expected the name of an .mcap file")
        self._workplace = contextlib.ExitStack()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            folder = self._workplace.enter_context(
                tempfile.TemporaryDirectory(dir=self.path.parent, prefix=f".{self.path.stem}-")
            )
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        self._folder = Path(folder, "bag")  # the library writes a folder, of which the one file is taken
        self._bag = McapFolder(self._folder)
        for name, msgtype in RESULT_TOPICS.items():
            self._bag.add_topic(f"/{NODE_NAME}/{name}", msgtype, latched=name == "decision")

    def write(
        self,
        result: RegistrationResult,
        source_stamp_ns: int,
        target_stamp_ns: int,
        source_frame: str = "",
        target_frame: str = "",
    ) -> None:
        """Write one decision, stamped with the source's time; stamps beyond 32 bits of seconds raise InputError."""
        stamp = _checked_stamp(source_stamp_ns)
        parent, child = distinct_frames(target_frame, source_frame)
        header, bag = self._bag.header(stamp, parent), self._bag
        if result.T_target_source is not None:
            self._put("transform", stamp, bag.transform(header, child, result.T_target_source))
            covariance = UNKNOWN_COVARIANCE if result.covariance is None else result.covariance
            self._put("pose", stamp, bag.pose(header, result.T_target_source, covariance))
        self._put("rejected", stamp, bag.make(RESULT_TOPICS["rejected"], data=not result.accepted))
        values = decision_values(result, source_stamp_ns, target_stamp_ns)
        message = f"{result.verdict.value}: {result.reason.value}"
        status = bag.status(f"{NODE_NAME}: decision", "OK" if result.accepted else "WARN", message, values)
        self._put("decision", stamp, bag.make(RESULT_TOPICS["decision"], header=header, status=[status]))

    def close(self) -> None:
        """Finish the file and put it in its place; a second call does nothing."""
        if self._folder.is_dir():
            with self._workplace:
                self._bag.close()
                (self._folder / f"{self._folder.name}.mcap").replace(self.path)

    def _put(self, name: str, stamp_ns: int, message: Any) -> None:
        self._bag.write(f"/{NODE_NAME}/{name}", stamp_ns, message)

    def __enter__(self) -> ResultWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class CloudBagWriter:
    """A ROS 2 bag folder (MCAP) of clouds and transforms. An existing folder is refused with InputError."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if self.path.exists():
            raise InputError(f"{path}: exists already; bags are not overwritten")
        try:
            self._bag = McapFolder(self.path)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        self._bag.add_topic("/tf", "tf2_msgs/msg/TFMessage")
        self._bag.add_topic("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
        self._statics: dict[str, Any] = {}
        self._is_open = True

    def write_points(self, stamp_ns: int, frame_id: str, points: ArrayLike, topic: str = "/points") -> None:
        """Write a cloud as float32 x y z intensity: points (N, 3) [m], or (N, 4) with the intensity (else zeros)."""
        values, stamp = np.asarray(points, np.float64), _checked_stamp(stamp_ns)
        if values.ndim != 2 or values.shape[1] not in (3, 4):
            raise InputError(f"points: expected shape N x 3 or N x 4, found {values.shape}")
        intensity = values[:, 3] if values.shape[1] == 4 else np.zeros(len(values))
        layout = cloud_layout(values[:, :3], {"intensity": intensity})
        make = self._bag.make
        fields = [make("sensor_msgs/msg/PointField", **field._asdict()) for field in layout.fields]
        if topic not in self._bag.connections:
            self._bag.add_topic(topic, "sensor_msgs/msg/PointCloud2")
        message = make(
            "sensor_msgs/msg/PointCloud2", header=self._bag.header(stamp, frame_id), fields=fields,
            height=layout.height, width=layout.width, point_step=layout.point_step, row_step=layout.row_step,
            is_bigendian=layout.is_bigendian, is_dense=layout.is_dense, data=np.frombuffer(layout.data, np.uint8),
        )  # fmt: skip
        self._bag.write(topic, stamp, message)

    def write_transform(self, stamp_ns: int, parent: str, child: str, T: ArrayLike, static: bool = False) -> None:
        """Write p_parent = T p_child, T (4, 4) [m], to /tf, or to /tf_static with all static ones before it.

        The last message on /tf_static is thus complete, which is all that a late subscriber gets.
        """
        pose, stamp = check_pose(T, f"transform {parent} -> {child}"), _checked_stamp(stamp_ns)
        stamped = self._bag.transform(self._bag.header(stamp, normalise_frame(parent)), normalise_frame(child), pose)
        transforms = [stamped]
        if static:
            self._statics[normalise_frame(child)] = stamped
            transforms = list(self._statics.values())
        message = self._bag.make("tf2_msgs/msg/TFMessage", transforms=transforms)
        self._bag.write("/tf_static" if static else "/tf", stamp, message)

    def close(self) -> None:
        """Finish the bag; a second call does nothing."""
        if self._is_open:
            self._is_open = False
            self._bag.close()

    def __enter__(self) -> CloudBagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def distinct_frames(target_frame: str, source_frame: str) -> tuple[str, str]:
    """Names (parent, child) for a transform between two scans: never empty, never the same."""
    parent, child = target_frame.lstrip("/") or "target", source_frame.lstrip("/") or "source"
    return parent, f"{child}/source" if child == parent else child


def _checked_stamp(stamp_ns: int) -> int:
    if not 0 <= stamp_ns < _MAX_STAMP_NS:
        raise InputError(f"stamp: expected nanoseconds from 0 to {_MAX_STAMP_NS}, found {stamp_ns}")
    return int(stamp_ns)
