"""The four modes of a replay: which steps they take, and how the way is put together from them."""

from __future__ import annotations

import importlib.util
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from svc_ros.core.errors import InputError, MissingDependencyError
from svc_ros.core.matches.descriptors import load_descriptors
from svc_ros.evaluation.bag_reference import Reference, check_evo
from svc_ros.io.bags import Bag
from svc_ros.io.transforms import TransformTree, normalise_frame
from svc_ros.pipeline.localisation import Localiser
from svc_ros.pipeline.loop_closure import LoopCloser
from svc_ros.pipeline.map import Map
from svc_ros.replay.ahead import ahead
from svc_ros.replay.clouds import BagPart, ReplayedPair, ReplayStep, read_clouds
from svc_ros.replay.job import WITH_ODOMETRY, ReplayJob
from svc_ros.replay.known import KnownLoops
from svc_ros.replay.stream import (
    Odometry,
    localisation_steps,
    loop_steps,
    matching_steps,
    odometry_by_matching,
    odometry_by_transforms,
    track_clouds,
)
from svc_ros.replay.stream_pairs import pair_steps, see_scans
from svc_ros.replay.track import LoopTrack, MapTrack, PairTrack, StreamTrack, Track


@dataclass(frozen=True, eq=False)
class Replay:
    """What is replayed of an open bag. reference: None where none was given; num_expected: clouds, estimated where only
    a part of the bag is wanted; closer: in loop closure; localiser: in localisation; odometry: in both of them."""

    topic: str
    part: BagPart
    track: Track
    reference: Reference | None
    num_expected: int
    closer: LoopCloser | None = None
    odometry: Odometry | None = None
    localiser: Localiser | None = None


@contextmanager
def open_replay(job: ReplayJob, bag: Bag, topic: str, known: Sequence[ReplayedPair]) -> Iterator[Replay]:
    """Look at all inputs before anything is written. Raises InputError, ConfigError and MissingDependencyError.

    known: see `steps_of`. A map stays open until the end of the `with` block.
    """
    if job.report and importlib.util.find_spec("plotly") is None:
        raise MissingDependencyError("report.html needs plotly: pip install plotly, or replay with --no-report")
    load_descriptors(job.config)
    every = 1 if job.mode == "pair" else job.stride
    part = BagPart(topic, job.start_s, job.duration_s, every, job.sensor_frame)
    (first, last), (begin, end) = part.span_ns(bag), bag.span_ns
    share = (last - first + 1) / (end - begin + 1)
    num_expected = max(1, round(share * bag.num_scans(topic) / every))
    closer = LoopCloser(job.config, KnownLoops(known)) if job.mode == "loop_closure" else None
    odometry = _odometry(job, bag) if job.mode in WITH_ODOMETRY else None
    reference = _reference(job, bag)
    with ExitStack() as opened:
        keyframes = None if job.map_folder is None else opened.enter_context(Map.read(job.map_folder))
        localiser = None if keyframes is None else Localiser(keyframes, job.config)
        track = _track(job, closer, localiser)
        yield Replay(topic, part, track, reference, num_expected, closer, odometry, localiser)


def steps_of(job: ReplayJob, replay: Replay, bag: Bag, known: Sequence[ReplayedPair]) -> Generator[ReplayStep]:
    """What each cloud leads to, in order. known: the first decisions, which an earlier run made.

    Pairs and loops are taken as they are; scan matching and localisation, which go on from what they have seen, make
    them again.
    """
    clouds = ahead(read_clouds(bag, replay.part))
    if job.mode == "pair":
        return pair_steps(ahead(see_scans(clouds, job.config, len(known))), job.config, job.stride, known)
    if replay.odometry is None:
        return matching_steps(clouds, job.config)
    tracked = ahead(track_clouds(clouds, replay.odometry))
    if replay.localiser is not None:
        return localisation_steps(tracked, replay.localiser)
    assert replay.closer is not None
    return loop_steps(tracked, replay.closer)


def _track(job: ReplayJob, closer: LoopCloser | None, localiser: Localiser | None) -> Track:
    if localiser is not None:
        return MapTrack(localiser.keyframes.poses)
    if closer is not None:
        return LoopTrack(closer)
    return PairTrack() if job.mode == "pair" else StreamTrack()


def _reference(job: ReplayJob, bag: Bag) -> Reference | None:
    if job.reference is None:
        return None
    check_evo()
    return Reference.read(job.reference, bag, job.reference_frame, job.map_reference)


def _odometry(job: ReplayJob, bag: Bag) -> Odometry:
    if job.odometry_frame is None:
        return odometry_by_matching(job.config)
    transforms, frame = bag.transforms(), normalise_frame(job.odometry_frame)
    _check_frame(frame, transforms)
    return odometry_by_transforms(transforms, frame)


def _check_frame(frame: str, transforms: TransformTree) -> None:
    if frame not in transforms.frames:
        known = ", ".join(transforms.frames) or "none"
        raise InputError(f"--odometry-frame {frame}: not among the frames of the bag ({known})")
