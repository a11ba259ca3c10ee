"""A bag with a reference trajectory as a data set: pairs of scans near enough to be aligned, and pairs far apart."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.scan import Array, IndexArray, Scan
from svc_ros.core.se3 import invert, rotation_angle_deg
from svc_ros.evaluation.bag_reference import MAX_ROTATION_DEG, MAX_TRANSLATION_M, Reference
from svc_ros.io.bags import Bag, Damage
from svc_ros.io.clouds.point_cloud2 import scan_from_cloud
from svc_ros.io.datasets import Dataset, Pair, SuccessThresholds
from svc_ros.io.stamps import ns_from_stamp

_NS = 1_000_000_000
_PAIRS_A_SCAN = 3  # pairs that share a scan tell less than others
_NEAR_SHARE, _LEAST_SHARE = 0.35, 0.08  # of the largest distance: near pairs, and scans that stood still


_SUCCESS = SuccessThresholds(MAX_ROTATION_DEG, MAX_TRANSLATION_M)  # as a replay judges


@dataclass(frozen=True)
class Spacing:
    """Which scans are pairs: at most far_m [m] and max_turn_deg [deg] apart; at least apart_m [m]: a negative.

    revisit_s: some pairs are of different passes, at least so far apart in time [s]; success: within both is right.
    """

    far_m: float
    apart_m: float
    max_turn_deg: float = 180.0
    revisit_s: float = 20.0
    success: SuccessThresholds = _SUCCESS


SPACINGS = {  # by preset
    "lidar_outdoor": Spacing(15.0, 80.0),
    "lidar_indoor": Spacing(4.0, 20.0),
    "rgbd_indoor": Spacing(1.0, 5.0, 45.0, success=SuccessThresholds(10.0, 0.2)),
}


@dataclass(frozen=True)
class BagSource:
    """Where pairs come from: a bag, its cloud topic (None: the only one), and the reference as a TUM file.

    reference_frame: whose poses those are (None: the clouds'); sensor_frame: see `pipeline.replay_clouds.BagPart`.
    strict: refuse a bag that is damaged.
    """

    bag: Path
    reference: Path
    topic: str | None = None
    reference_frame: str | None = None
    sensor_frame: str | None = None
    strict: bool = False


@dataclass(frozen=True, eq=False)
class BagDataset(Dataset):
    """Pairs of a bag; the scans that take part lie in `root`, as the bag has them. damage: of the bag."""

    damage: Sequence[Damage] = ()

    def read_scan(self, relative: str) -> Scan:
        """One scan by its number in the bag."""
        with np.load(self.root / f"{relative}.npz") as parts:
            return Scan(parts["points"], sensor_origin=parts["origin"], free_directions=parts.get("free"))


@dataclass(frozen=True, eq=False)
class _Frames:
    """The clouds whose pose is known: number (N,) in the bag, stamps_ns (N,), poses (N, 4, 4) [m] world <- cloud."""

    number: IndexArray
    stamps_ns: IndexArray
    poses: Array


def dataset_of_bag(source: BagSource, preset: str, config: Config, num: tuple[int, int], folder: Path) -> BagDataset:
    """Choose pairs and negatives of a bag and write their scans to `folder`; the same choice whenever it is made.

    num: most pairs and most negatives. Pairs are spread over the whole bag and alternate between near and farther
    scans of one pass and scans of different passes. Raises InputError where bag or reference cannot be read, where
    their times do not overlap, and where no two scans are a pair.
    """
    spacing = SPACINGS[preset]
    with Bag(source.bag, source.strict) as bag:
        topic = bag.resolve_cloud_topic(source.topic)
        frames = _read_frames(bag, topic, Reference.read(source.reference, bag, source.reference_frame), source)
        pairs, negatives = choose_pairs(frames.stamps_ns, frames.poses, spacing, num)
        if not pairs:
            raise InputError(
                f"{source.bag} {topic}: expected scans {_LEAST_SHARE * spacing.far_m:.2g} to {spacing.far_m:g} m apart "
                f"by {source.reference}, found none among {len(frames.number)} (preset {preset})"
            )
        used = {int(frames.number[k]) for pair in (*pairs, *negatives) for k in pair}
        _write_scans(bag, topic, source, (used, folder))
    name, limits = "/".join(source.bag.parts[-2:]), config.preprocess
    return BagDataset(
        folder, name, "", preset, limits.min_range_m, limits.max_range_m, np.zeros(3), spacing.success,
        [_pair(frames, *pair) for pair in pairs], [_pair(frames, *pair) for pair in negatives], damage=bag.damage,
    )  # fmt: skip


def choose_pairs(
    stamps_ns: IndexArray, poses: Array, spacing: Spacing, num: tuple[int, int], seed: int = 0
) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Pairs and negatives as indices (source, target), at most `num` of each; stamps_ns (N,), poses (N, 4, 4) [m].

    No pair comes twice, in either direction, and no scan is the source of more than three.
    """
    rng = np.random.default_rng(seed)
    picker = _Picker(stamps_ns, poses, spacing, rng)
    return picker.pick(("near", "farther", "revisit"), num[0]), picker.pick(("apart",), num[1])


class _Picker:
    """Draws partners for scans, by kind of pair."""

    def __init__(self, stamps_ns: IndexArray, poses: Array, spacing: Spacing, rng: np.random.Generator) -> None:
        self._stamps_ns, self._poses, self._spacing, self._rng = stamps_ns, poses, spacing, rng
        self._taken: set[tuple[int, int]] = set()

    def pick(self, kinds: Sequence[str], num: int) -> list[tuple[int, int]]:
        """At most `num` pairs, evenly from all scans; their kinds take turns, as far as a scan has partners of each."""
        found: list[tuple[int, int]] = []
        size = len(self._stamps_ns)
        for turn in range(_PAIRS_A_SCAN):
            wanted = min(num - len(found), size)
            for k in np.unique(np.linspace(0, size - 1, wanted).round().astype(int)):
                partner = self._partner(int(k), np.roll(kinds, -(len(found) + turn)).tolist())
                if partner is not None:
                    found.append((int(k), partner))
        return found

    def _partner(self, k: int, kinds: Sequence[str]) -> int | None:
        masks = self._masks(k)
        for kind in kinds:
            free = [j for j in np.flatnonzero(masks[kind]).tolist() if (min(j, k), max(j, k)) not in self._taken]
            if free:
                j = int(self._rng.choice(free))
                self._taken.add((min(j, k), max(j, k)))
                return j
        return None

    def _masks(self, k: int) -> Mapping[str, NDArray[np.bool_]]:
        """Which scans (N,) are a pair of each kind with scan k."""
        limits, poses = self._spacing, self._poses
        distance = np.linalg.norm(poses[:, :3, 3] - poses[k, :3, 3], axis=1)
        turn = rotation_angle_deg(poses[k, :3, :3].T @ poses[:, :3, :3])
        later = np.abs(self._stamps_ns - self._stamps_ns[k]) >= limits.revisit_s * _NS
        near_m = _NEAR_SHARE * limits.far_m
        seen = (distance >= _LEAST_SHARE * limits.far_m) & (distance <= limits.far_m) & (turn <= limits.max_turn_deg)
        return {
            "near": seen & (distance <= near_m),
            "farther": seen & (distance > near_m),
            "revisit": seen & later,
            "apart": distance >= limits.apart_m,
        }


def _read_frames(bag: Bag, topic: str, reference: Reference, source: BagSource) -> _Frames:
    found: list[tuple[int, int, Array]] = []
    number = -1
    for number, stamp_ns, cloud_frame, _ in _clouds(bag, topic):
        pose = reference.pose(stamp_ns, cloud_frame)
        if pose is not None:
            found.append((number, stamp_ns, pose))
    if len(found) < 2:
        raise InputError(
            f"{source.bag} {topic}: expected clouds with a pose in {source.reference}, "
            f"found {len(found)} of {number + 1} (other stamps, or no transform to --reference-frame?)"
        )
    numbers, stamps, poses = zip(*found, strict=True)
    return _Frames(np.array(numbers, np.int64), np.array(stamps, np.int64), np.stack(poses))


def _clouds(bag: Bag, topic: str) -> Iterator[tuple[int, int, str, Any]]:
    """Number, stamp [ns], frame and message of every cloud."""
    for number, (_, message) in enumerate(bag.raw_clouds(topic)):
        yield number, ns_from_stamp(message.header.stamp), str(message.header.frame_id), message


def _write_scans(bag: Bag, topic: str, source: BagSource, wanted: tuple[set[int], Path]) -> None:
    """wanted: numbers of clouds, and the folder that gets one file of each."""
    numbers, folder = wanted
    transforms = bag.transforms() if source.sensor_frame else None
    for number, stamp_ns, frame, message in _clouds(bag, topic):
        if number not in numbers:
            continue
        try:
            origin = None
            if transforms is not None and source.sensor_frame is not None:
                origin = transforms.lookup(frame, source.sensor_frame, stamp_ns)[:3, 3]
            scan = scan_from_cloud(message, sensor_origin=origin).scan
        except (InputError, TransformUnavailableError) as error:
            raise InputError(f"{source.bag}: {topic}, cloud {number}: {error}") from None
        parts: dict[str, Any] = {"points": _small(scan.points), "origin": scan.sensor_origin}
        if scan.free_directions is not None:
            parts["free"] = scan.free_directions
        np.savez(folder / f"{number}.npz", **parts)


def _small(points: Array) -> NDArray[np.floating]:
    """As float32 where that loses nothing, as of nearly all sensors."""
    half = points.astype(np.float32)
    return half if np.array_equal(half, points) else points


def _pair(frames: _Frames, source: int, target: int) -> Pair:
    T = invert(frames.poses[target]) @ frames.poses[source]
    names = str(frames.number[source]), str(frames.number[target])
    return Pair(names[0], names[1], T, distance_m=float(np.linalg.norm(T[:3, 3])))
