"""What a bag holds and whether its clouds can be registered; one pass over each topic."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

from svc_ros.cli.doctor.clouds import check_clouds, suggest_preset
from svc_ros.cli.doctor.finding import Finding, Level
from svc_ros.cli.doctor.notes import SAMPLED, CloudNotes, take_notes
from svc_ros.cli.doctor.stamps import check_bag_times, check_stamps
from svc_ros.cli.doctor.trial import try_pairs
from svc_ros.core.errors import SvcError, TransformUnavailableError
from svc_ros.core.scan import Array
from svc_ros.io.bags import Bag, TopicInfo
from svc_ros.io.transforms import TransformTree

_FIXED_FRAMES = {"map", "odom", "world", "earth", "global", "local_map", "camera_init"}
_NEEDS_NO_TF = "the sensor stands at the origin of this frame, and odometry is its own"
_RAW_TYPES = {  # what carries scans, but not as points: the end of its type's name -> what to do
    "VelodyneScan": "packets: run the sensor's driver on them and record its PointCloud2",
    "PacketMsg": "packets: run the sensor's driver on them and record its PointCloud2",
    "HesaiScan": "packets: run the sensor's driver on them and record its PointCloud2",
    "UdpFrame": "packets: run the sensor's driver on them and record its PointCloud2",
    "NebulaPackets": "packets: run the sensor's driver on them and record its PointCloud2",
    "sensor_msgs/msg/PointCloud": "the old message: convert it to PointCloud2",
    "sensor_msgs/msg/LaserScan": "a plane of points is too little for a pose in three dimensions",
}


def check_bag(
    path: str | Path,
    topic: str | None = None,
    trial: bool = False,
    sensor_frame: str | None = None,
    strict: bool = False,
) -> list[Finding]:
    """Look at a bag's topics and at every cloud of one topic (None: of all PointCloud2 topics).

    trial: register a few neighbouring scans as well; sensor_frame: where the sensor stands, by the bag's transforms, if
    not at the origin of the clouds' frame. Raises InputError for a bag that cannot be read (strict: or is damaged) and
    for a topic that it does not have.
    """
    with Bag(path, strict) as bag:
        names = [bag.resolve_cloud_topic(topic)] if topic else [info.name for info in bag.cloud_topics]
        findings = [_check_topic(info) for info in bag.topics]
        if not names:
            return [*findings, _no_clouds(bag.topics), *_damage(bag)]
        tree, problem = _transforms(bag)
        findings += _check_choice(names)
        for name in names:
            notes = take_notes(bag, name, partial(_sensor_origin, tree, sensor_frame))
            findings += _check_cloud_topic(name, notes, tree, trial, sensor_frame)
        return [*findings, *problem, *_damage(bag)]  # more of it may be known now than before


def _damage(bag: Bag) -> list[Finding]:
    return [Finding("damage", "warn", str(damage), "what is intact is read; --strict refuses") for damage in bag.damage]


def _no_clouds(topics: Iterable[TopicInfo]) -> Finding:
    raw = [(info, advice) for info in topics if (advice := advice_on_type(info.type))]
    if not raw:
        return Finding("clouds", "error", "no topic of type PointCloud2", "record the sensor's points")
    (info, advice), *_ = raw
    return Finding("clouds", "error", f"no topic of type PointCloud2, but {info.name} of type {info.type}", advice)


def advice_on_type(type_name: str) -> str:
    """What to do with messages that carry scans, but not as points; empty for any other type."""
    return next((advice for end, advice in _RAW_TYPES.items() if type_name.endswith(end)), "")


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


def _sensor_origin(tree: TransformTree, sensor_frame: str | None, cloud_frame: str, stamp_ns: int) -> Array | None:
    return None if sensor_frame is None else tree.lookup(cloud_frame, sensor_frame, stamp_ns)[:3, 3]


def _check_cloud_topic(
    name: str, notes: CloudNotes, tree: TransformTree, trial: bool, sensor_frame: str | None
) -> list[Finding]:
    if not notes.stamps_ns:
        return [Finding(name, "error", "no cloud recorded", "was the sensor's driver running, and its QoS one that "
                        "the recorder takes? ros2 topic hz tells")]  # fmt: skip
    checks = [
        *_check_number(notes),
        *check_clouds(notes),
        *check_stamps(notes.stamps_ns),
        *check_bag_times(notes.stamps_ns, notes.bag_times_ns),
        *_check_frames(notes, tree, sensor_frame),
    ]
    if trial and not any(check.level == "error" for check in checks):
        checks += try_pairs(notes.pairs, suggest_preset(notes).preset)
    return [Finding(f"{name} {check.name}", check.level, check.found, check.advice) for check in checks]


def _check_choice(topics: Sequence[str]) -> list[Finding]:
    if len(topics) == 1:
        return []
    advice = "svc_ros replay and the node take one of them, or one each for source and target: name it"
    return [Finding("cloud topics", "ok", ", ".join(topics), advice)]


def _check_number(notes: CloudNotes) -> list[Finding]:
    if len(notes.stamps_ns) > 1:
        return []
    advice = "nothing to register it with: record a run, or compare two files by svc_ros register"
    return [Finding("number of clouds", "warn", "1", advice)]


def _check_frames(notes: CloudNotes, tree: TransformTree, sensor_frame: str | None) -> list[Finding]:
    frames = list(notes.frames)
    found = check_frame_names(frames, sensor_frame)
    if "" in frames:
        return found
    if notes.num_without_origin:
        missing = f"unknown of {notes.num_without_origin} of {len(notes.stamps_ns)} clouds: {notes.no_origin}"
        found.append(Finding("sensor frame", "error", missing, "name a frame that /tf and /tf_static connect"))
    return [*found, *(_check_connection(frame, notes.stamps_ns, tree) for frame in frames)]


def check_frame_names(frames: Sequence[str], sensor_frame: str | None = None) -> list[Finding]:
    """Look at the frames of a topic's clouds, each named once; sensor_frame: see `check_bag`."""
    if "" in frames:
        return [Finding("frame", "error", "frame_id is empty", "the driver must name the sensor's frame")]
    level: Level = "warn"
    if len(frames) > 1:
        advice = "one topic should carry one sensor: its sight lines start in one place"
    elif sensor_frame is None and frames[0].rpartition("/")[2] in _FIXED_FRAMES:
        advice = "a frame of the world, in which the sensor moves: name the sensor's by --sensor-frame or sensor_frame"
    else:
        level, advice = "ok", ""
    return [Finding("frame", level, ", ".join(frames), advice)]


def _check_connection(frame: str, stamps_ns: Sequence[int], tree: TransformTree) -> Finding:
    """Look the frame up from every other frame at some of the clouds' stamps."""
    name = f"transforms of {frame}"
    if not tree.frames:
        return Finding(name, "ok", "no transforms recorded", f"none are needed where {_NEEDS_NO_TF}")
    others = [other for other in tree.frames if other != frame.lstrip("/")]
    sampled = stamps_ns[:: max(1, len(stamps_ns) // SAMPLED)]
    answers = {other: sum(_connected(tree, other, frame, stamp) for stamp in sampled) for other in others}
    reached = {other: count for other, count in answers.items() if count}
    if not reached:
        return Finding(name, "warn", f"connected to none of: {', '.join(others)}", f"no harm where {_NEEDS_NO_TF}")
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
