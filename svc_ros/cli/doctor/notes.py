"""What one pass over a topic keeps of its clouds, for the checks of a bag or of a topic that is heard now."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from svc_ros.core.auto_preset import NEAREST_M, Outlook, look_out
from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.range_image import build_range_image
from svc_ros.core.scan import Array
from svc_ros.core.scans.preprocess import estimate_beam_spacing_deg
from svc_ros.io.bags import Bag
from svc_ros.io.clouds.point_cloud2 import CloudReading, scan_from_cloud
from svc_ros.io.clouds.point_times import TIME_FIELDS
from svc_ros.io.stamps import ns_from_stamp

SAMPLED = 20  # clouds that are looked at closely where every one would add nothing
TRIED = 3  # pairs of neighbours that are kept for a registration
_FIELD_TYPES = {1: "int8", 2: "uint8", 3: "int16", 4: "uint16", 5: "int32", 6: "uint32", 7: "float32", 8: "float64"}
_KEPT_POINTS = 500_000  # of one cloud: as many tell all that is asked of them
FindOrigin = Callable[[str, int], Array | None]


@dataclass(frozen=True)
class View:
    """One cloud as seen by its sensor.

    points: (N, 3) [m], relative to the sensor, of a large cloud evenly fewer; outlook: by which a preset is chosen,
    None without points to tell; crossed_ratio: see `RangeImage`; num_free: directions that are told to be free of any
    return; sweep_s: span of the points' times, or None.
    """

    points: Array
    outlook: Outlook | None
    crossed_ratio: float
    num_free: int
    sweep_s: float | None


@dataclass
class CloudNotes:
    """What is kept of every cloud of a topic; `views` and `pairs` of some."""

    layouts: Counter[str] = field(default_factory=Counter)
    frames: Counter[str] = field(default_factory=Counter)
    refused: list[str] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    bag_times_ns: list[int] = field(default_factory=list)
    num_points: list[int] = field(default_factory=list)
    num_usable: int = 0  # points that are neither NaN, inf nor zero
    num_nan: int = 0
    num_zero: int = 0
    num_repeated: int = 0
    num_without_origin: int = 0
    no_origin: str = ""  # why, of the first of them
    num_timed: int = 0
    time_fields: set[str] = field(default_factory=set)
    views: list[View] = field(default_factory=list)
    pairs: list[tuple[CloudReading, CloudReading]] = field(default_factory=list)

    def add(self, bag_time_ns: int, message: Any, find_origin: FindOrigin) -> CloudReading | None:
        """Take note of one message; the reading is None where it cannot be read."""
        self.layouts[_layout(message)] += 1
        self.frames[str(message.header.frame_id)] += 1
        self.stamps_ns.append(ns_from_stamp(message.header.stamp))
        self.bag_times_ns.append(bag_time_ns)
        self.time_fields |= {str(f.name) for f in message.fields} & set(TIME_FIELDS)
        try:
            reading = scan_from_cloud(message, sensor_origin=self._origin(message, find_origin))
        except InputError as error:
            self.refused.append(str(error))
            return None
        self.num_points.append(reading.num_points)
        self.num_usable += len(reading.scan)
        self.num_nan += reading.num_dropped_nan
        self.num_zero += reading.num_dropped_zero
        self.num_timed += reading.scan.point_times_s is not None
        return reading

    def _origin(self, message: Any, find_origin: FindOrigin) -> Array | None:
        try:
            return find_origin(str(message.header.frame_id), ns_from_stamp(message.header.stamp))
        except TransformUnavailableError as error:
            self.num_without_origin += 1
            self.no_origin = self.no_origin or str(error)
            return None


def take_notes(bag: Bag, topic: str, find_origin: FindOrigin) -> CloudNotes:
    """Go through all clouds of a topic once.

    find_origin: from a cloud's frame and stamp [ns] to where its sensor stands in that frame, (3,) [m]; None: at its
    origin, as for clouds of which it raises TransformUnavailableError.
    """
    num = bag.num_scans(topic)
    return notes_of(bag.raw_clouds(topic), find_origin, max(1, num // SAMPLED), set(_first_of_pairs(num)))


def notes_of(
    clouds: Iterable[tuple[int, Any]], find_origin: FindOrigin, every: int, firsts: Collection[int]
) -> CloudNotes:
    """Go through clouds, each with the time [ns] at which it was recorded or received.

    every: each so manieth is looked at closely; firsts: which are kept, each with the next one, to be registered.
    """
    notes, previous = CloudNotes(), None
    for k, (time_ns, message) in enumerate(clouds):
        reading = notes.add(time_ns, message, find_origin)
        if reading is not None and previous is not None:
            notes.num_repeated += _same_points(previous, reading)
            if k - 1 in firsts:
                notes.pairs.append((previous, reading))
        if reading is not None and k % every == 0 and len(reading.scan):
            notes.views.append(_view(reading))
        previous = reading
    return notes


def _first_of_pairs(num: int) -> Iterator[int]:
    """Indices of the first scans of TRIED neighbouring pairs, evenly over the bag."""
    yield from (int(k) for k in np.unique(np.linspace(0, max(num - 2, 0), TRIED).astype(int)))


def _same_points(one: CloudReading, other: CloudReading) -> bool:
    return len(one.scan) > 0 and np.array_equal(one.scan.points, other.scan.points)


def _layout(message: Any) -> str:
    fields = (f"{f.name} {_FIELD_TYPES.get(int(f.datatype), f'type {f.datatype}')}" for f in message.fields)
    order = ", big-endian" if message.is_bigendian else ""
    return f"{', '.join(fields) or 'no fields'}; {message.point_step} bytes a point{order}"


def _view(reading: CloudReading) -> View:
    scan = reading.scan
    points = scan.points - scan.sensor_origin
    times, free = scan.point_times_s, scan.free_directions
    image = build_range_image(points, np.zeros(3), NEAREST_M, estimate_beam_spacing_deg(points, np.zeros(3)))
    return View(
        points[:: 1 + len(points) // _KEPT_POINTS], look_out(scan.points, scan.sensor_origin), image.crossed_ratio,
        0 if free is None else len(free), None if times is None or not len(times) else float(np.ptp(times)),
    )  # fmt: skip
