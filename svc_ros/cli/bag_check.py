"""What a bag holds and whether its clouds can be registered; one pass over each topic."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from svc_ros.cli.finding import Finding, Level
from svc_ros.core.config import PRESETS
from svc_ros.core.errors import InputError, SvcError, TransformUnavailableError
from svc_ros.io.bags import Bag, TopicInfo
from svc_ros.io.point_cloud2 import CloudReading, scan_from_cloud
from svc_ros.io.stamps import ns_from_stamp, text_from_ns
from svc_ros.io.transforms import TransformTree

_FIELD_TYPES = {1: "int8", 2: "uint8", 3: "int16", 4: "uint16", 5: "int32", 6: "uint32", 7: "float32", 8: "float64"}
_MANY = 0.5  # share of dropped points above which somebody should look
_GAP_FACTOR = 2.5  # times the median step, beyond which scans are missing
_CLOCK_S = 1.0  # header and bag time farther apart than this come of different clocks
_SAMPLED = 20  # clouds and stamps that are looked at where every one would add nothing
_CAMERA_CONCENTRATION = 0.8  # length of the mean viewing direction: a depth camera looks one way, a LiDAR around
_CAMERA_RANGE_M = 8.0
_INDOOR_RANGE_M = 35.0


@dataclass
class _CloudNotes:
    """What is kept of every cloud of a topic."""

    layouts: Counter[str] = field(default_factory=Counter)
    frames: Counter[str] = field(default_factory=Counter)
    refused: list[str] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    bag_times_ns: list[int] = field(default_factory=list)
    num_points: list[int] = field(default_factory=list)
    num_nan: int = 0
    num_zero: int = 0
    views: list[tuple[float, float]] = field(default_factory=list)  # (99th percentile of range [m], concentration)

    def add(self, bag_time_ns: int, message: Any, look_closely: bool) -> None:
        self.layouts[_layout(message)] += 1
        self.frames[str(message.header.frame_id)] += 1
        self.stamps_ns.append(ns_from_stamp(message.header.stamp))
        self.bag_times_ns.append(bag_time_ns)
        try:
            reading = scan_from_cloud(message)
        except InputError as error:
            self.refused.append(str(error))
            return
        self.num_points.append(reading.num_points)
        self.num_nan += reading.num_dropped_nan
        self.num_zero += reading.num_dropped_zero
        if look_closely and len(reading.scan):
            self.views.append(_view(reading))


def check_bag(path: str | Path, topic: str | None = None) -> list[Finding]:
    """Look at a bag's topics and at every cloud of one topic (None: of all PointCloud2 topics).

    Raises InputError for a bag that cannot be read and for a topic that it does not have.
    """
    with Bag(path) as bag:
        names = [bag.resolve_cloud_topic(topic)] if topic else [info.name for info in bag.cloud_topics]
        findings = [_check_topic(info) for info in bag.topics]
        if not names:
            findings.append(Finding("clouds", "error", "no topic of type PointCloud2", "record the sensor's points"))
            return findings
        tree, problem = _transforms(bag)
        for name in names:
            findings += _check_clouds(name, _read_notes(bag, name), tree)
    return [*findings, *problem]


def _read_notes(bag: Bag, topic: str) -> _CloudNotes:
    notes = _CloudNotes()
    every = max(1, bag.num_scans(topic) // _SAMPLED)
    for i, (bag_time_ns, message) in enumerate(bag.raw_clouds(topic)):
        notes.add(bag_time_ns, message, look_closely=i % every == 0)
    return notes


def _transforms(bag: Bag) -> tuple[TransformTree, list[Finding]]:
    try:
        return bag.transforms(), []
    except SvcError as error:
        return TransformTree(), [Finding("transforms", "error", str(error), "record /tf and /tf_static again")]


def _check_topic(info: TopicInfo) -> Finding:
    found = f"{info.type or 'several types'}, {info.count} messages"
    if info.count:
        return Finding(f"topic {info.name}", "ok", found)
    return Finding(f"topic {info.name}", "warn", found, "nothing was recorded: was the publisher running?")


def _check_clouds(name: str, notes: _CloudNotes, tree: TransformTree) -> list[Finding]:
    if not notes.stamps_ns:
        return [Finding(name, "error", "no cloud recorded")]
    checks = [
        _check_fields(notes),
        *_check_points(notes),
        *_check_stamps(notes.stamps_ns),
        _check_clocks(notes),
        *_check_frames(notes, tree),
        *_suggest_preset(notes),
    ]
    return [Finding(f"{name} {check.name}", check.level, check.found, check.advice) for check in checks]


def _layout(message: Any) -> str:
    fields = (f"{f.name} {_FIELD_TYPES.get(int(f.datatype), f'type {f.datatype}')}" for f in message.fields)
    order = ", big-endian" if message.is_bigendian else ""
    return f"{', '.join(fields) or 'no fields'}; {message.point_step} bytes a point{order}"


def _check_fields(notes: _CloudNotes) -> Finding:
    found = " | ".join(layout for layout, _ in notes.layouts.most_common())
    if not notes.refused:
        return Finding("fields", "ok", found)
    share = f"{len(notes.refused)} of {len(notes.stamps_ns)} clouds refused: {notes.refused[0]}"
    level: Level = "warn" if notes.num_points else "error"
    return Finding("fields", level, f"{found}; {share}", "mend the driver that writes these clouds")


def _check_points(notes: _CloudNotes) -> list[Finding]:
    if not notes.num_points:
        return []
    total, empty = sum(notes.num_points), notes.num_points.count(0)
    low, middle, high = min(notes.num_points), int(np.median(notes.num_points)), max(notes.num_points)
    return [
        Finding("points", "warn" if empty else "ok", f"{middle} a cloud ({low} to {high}), {empty} clouds empty",
                "empty clouds are rejected with too_few_points" if empty else ""),
        _check_dropped("NaN share", notes.num_nan, total),
        _check_dropped("zero-point share", notes.num_zero, total),
    ]  # fmt: skip


def _check_dropped(name: str, num_dropped: int, total: int) -> Finding:
    share = num_dropped / total if total else 0.0
    many = share > _MANY
    advice = "most points carry nothing: look at the sensor's range and at its driver" if many else ""
    return Finding(name, "warn" if many else "ok", f"{share:.1%}", advice)


def _check_stamps(stamps_ns: list[int]) -> list[Finding]:
    if not any(stamps_ns):
        return [Finding("stamps", "error", "all zero", "the driver must stamp its clouds; pairs are made by stamp")]
    steps = np.diff(np.array(stamps_ns, np.int64))
    forward = steps[steps > 0]
    rate = f", {1e9 / np.median(forward):.1f} Hz" if len(forward) else ""
    span = f"{text_from_ns(min(stamps_ns))} to {text_from_ns(max(stamps_ns))} s{rate}"
    findings = [Finding("stamps", "ok", span)]
    if backwards := int((steps < 0).sum()):
        advice = "a backwards jump clears pairing; check clocks, or split the bag there"
        findings.append(Finding("stamp order", "warn", f"{backwards} backwards", advice))
    if repeated := len(stamps_ns) - len(set(stamps_ns)):
        advice = "scans with one stamp cannot be told apart"
        findings.append(Finding("stamp repeats", "warn", f"{repeated} duplicates", advice))
    if len(forward) and (gaps := int((forward > _GAP_FACTOR * np.median(forward)).sum())):
        longest = f"{gaps} gaps, the longest {forward.max() / 1e9:.3f} s"
        findings.append(Finding("stamp gaps", "warn", longest, "scans are missing: disk, network or driver too slow"))
    return findings


def _check_clocks(notes: _CloudNotes) -> Finding:
    delay = (np.array(notes.bag_times_ns, np.int64) - np.array(notes.stamps_ns, np.int64)) / 1e9
    middle, spread = float(np.median(delay)), float(delay.max() - delay.min())
    found = f"recorded {middle:+.3f} s after the header's stamp (spread {spread:.3f} s)"
    if abs(middle) <= _CLOCK_S and spread <= _CLOCK_S:
        return Finding("header and bag time", "ok", found)
    advice = "different clocks: transforms may not exist at the header's stamp"
    return Finding("header and bag time", "warn", found, advice)


def _check_frames(notes: _CloudNotes, tree: TransformTree) -> list[Finding]:
    frames = list(notes.frames)
    if "" in frames:
        return [Finding("frame", "error", "frame_id is empty", "the driver must name the sensor's frame")]
    level: Level = "ok" if len(frames) == 1 else "warn"
    advice = "" if len(frames) == 1 else "one topic should carry one sensor: its sight lines start in one place"
    found = Finding("frame", level, ", ".join(frames), advice)
    return [found, *(_check_connection(frame, notes.stamps_ns, tree) for frame in frames)]


def _check_connection(frame: str, stamps_ns: list[int], tree: TransformTree) -> Finding:
    """Look the frame up from every other frame at some of the clouds' stamps."""
    name = f"transforms of {frame}"
    advice = "the sensor must stand at the origin of this frame; else record /tf and /tf_static, or give sensor_origin"
    others = [other for other in tree.frames if other != frame.lstrip("/")]
    sampled = stamps_ns[:: max(1, len(stamps_ns) // _SAMPLED)]
    answers = {other: sum(_connected(tree, other, frame, stamp) for stamp in sampled) for other in others}
    reached = {other: count for other, count in answers.items() if count}
    if not reached:
        return Finding(name, "warn", f"connected to none of: {', '.join(others) or 'no frame recorded'}", advice)
    told = ", ".join(f"{other} {count / len(sampled):.0%}" for other, count in reached.items())
    found = f"found at the clouds' stamps: {told}"
    if min(reached.values()) == len(sampled):
        return Finding(name, "ok", found)
    return Finding(name, "warn", found, "/tf does not span all clouds")


def _connected(tree: TransformTree, target: str, source: str, stamp_ns: int) -> bool:
    try:
        tree.lookup(target, source, stamp_ns)
    except TransformUnavailableError:
        return False
    return True


def _view(reading: CloudReading) -> tuple[float, float]:
    ranges = np.linalg.norm(reading.scan.points, axis=1)
    directions = reading.scan.points[ranges > 0] / ranges[ranges > 0, None]
    return float(np.quantile(ranges, 0.99)), float(np.linalg.norm(directions.mean(0))) if len(directions) else 0.0


def _suggest_preset(notes: _CloudNotes) -> list[Finding]:
    """A guess from how far and how narrowly the sensor looks; a person knows better."""
    if not notes.views:
        return []
    reach, concentration = np.median(np.array(notes.views), axis=0)
    wanted = "lidar_indoor" if reach < _INDOOR_RANGE_M else "lidar_outdoor"
    if concentration > _CAMERA_CONCENTRATION and reach < _CAMERA_RANGE_M:
        wanted = "rgbd_indoor"
    why = f"99 % of the points within {reach:.1f} m"
    advice = f"start with --preset {wanted}" if wanted in PRESETS else ""
    return [Finding("preset", "ok", f"{wanted} ({why})", advice)]
