"""The answer to one job, with what its publishers may want to show. No rclpy here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.result import Reason, RegistrationResult
from svc_ros.core.scan import Array, PreparedScan, Scan
from svc_ros.io.clouds.point_cloud2 import scan_from_cloud
from svc_ros.pipeline.decide import dropped, refused
from svc_ros.pipeline.stream import StreamDecision
from svc_ros.ros.streams.worker import Cloud, CloudLabel, DropJob, Job, PairJob, ScanJob


@dataclass(frozen=True, eq=False)
class Look:
    """What there is to look at: both scans as they were judged, the pose, and where to draw them.

    points: (N, 3) [m], the source as it is shown when aligned; T_target_source: (4, 4), the judged pose, right or not;
    T_frame_target: (4, 4), where the target stands in the frame `frame_id` that everything is drawn in.
    """

    points: Array
    source: PreparedScan
    target: PreparedScan
    T_target_source: Array
    T_frame_target: Array
    frame_id: str


@dataclass(frozen=True, eq=False)
class OdometryEstimate:
    """Where the robot's base stands, or the sensor where there is no base.

    T_odom_base: (4, 4); covariance: (6, 6), order x y z [m] then rotations [rad], left perturbation in the odometry
    frame; velocity: (6,) [m/s, rad/s] in the base's own frame and its covariance (6, 6), None for the first scan.
    """

    T_odom_base: Array
    covariance: Array
    velocity: Array | None = None
    velocity_covariance: Array | None = None


@dataclass(frozen=True, eq=False)
class MapPlace:
    """What is known of the robot in a map after a scan.

    T_map_base: (4, 4), where its base stands, or the cloud's frame where there is no base; None unless this scan says
    so for sure; covariance: (6, 6) as in OdometryEstimate, in the map's frame, which itself is taken for exact;
    T_map_odom: (4, 4), where odometry begins, None unless localised.
    """

    T_map_base: Array | None = None
    covariance: Array | None = None
    T_map_odom: Array | None = None


@dataclass(frozen=True, eq=False)
class Decision:
    """The answer to one job, or one of its answers.

    origin: where the judged pose of a stream came from, empty for pairs; vertices: numbers of source and target in the
    pose graph, where both are in it; place: with the decision on a scan's own place in a map; loop: the same decision
    as the pipeline has it, of loops.
    """

    result: RegistrationResult
    source: CloudLabel | None
    target: CloudLabel | None
    timings_ms: dict[str, float] = field(default_factory=dict)
    look: Look | None = None
    odometry: OdometryEstimate | None = None
    origin: str = ""
    vertices: tuple[int, int] | None = None
    place: MapPlace | None = None
    loop: StreamDecision | None = None


def as_they_are(decisions: list[Decision]) -> list[Decision]:
    """What is told of decisions that no others change."""
    return decisions


@dataclass(frozen=True, eq=False)
class Judgement:
    """A job that the worker is done with, and whose candidates are still to be judged.

    judge: the decisions, at least one; called at most once, by any thread; settle: what is told of them, called when it
    is, by one thread at a time.
    """

    job: PairJob | ScanJob
    config: Config
    judge: Callable[[], list[Decision]]
    settle: Callable[[list[Decision]], list[Decision]] = as_they_are

    def drop(self, reason: Reason, detail: str) -> list[Decision]:
        """The one decision where nothing is judged."""
        return [drop_decision(self.job.drop(reason, detail), self.config)]

    def decide(self) -> list[Decision]:
        """The decisions; what `judge` raises is one of them."""
        try:
            return self.judge()
        except Exception as error:
            return [Decision(refused(error, self.config), *labels(self.job))]


Outcome = list[Decision] | Judgement


class Engine(Protocol):
    """What a mode computes; belongs to the worker's thread, but for what is said to be safe."""

    def process(self, job: Job, config: Config) -> Outcome:
        """The decisions on one job, or what is still to be judged for them; never raises."""
        ...

    def warm_up(self, config: Config) -> None:
        """Import and compile what the first job needs."""
        ...

    def reset(self) -> None:
        """Forget everything that earlier jobs left."""
        ...

    def judge_again(self, config: Config) -> dict[str, Any]:
        """Judge the pose that was told last once more, as JSON values; InputError where there is none."""
        ...

    def numbers(self) -> dict[str, Any]:
        """Counts for the status; safe from any thread."""
        ...


class CloudReader:
    """Reads clouds into scans. origin_of: where the sensor stood in a frame, (frame, stamp_ns) -> (3,) [m]."""

    def __init__(self, origin_of: Callable[[str, int], Array]) -> None:
        self._origin_of = origin_of

    def origin(self, cloud: Cloud) -> Array:
        """Where the sensor stood in the cloud's frame, (3,) [m]; TransformUnavailableError where nobody knows."""
        return self._origin_of(str(cloud.message.header.frame_id), cloud.stamp_ns)

    def scan(self, cloud: Cloud, origin: Array | None = None) -> Scan:
        """The cloud as a scan, its sensor at `origin` (3,) where that is known already.

        InputError or TransformUnavailableError says why it is none.
        """
        origin = self.origin(cloud) if origin is None else origin
        return scan_from_cloud(cloud.message, sensor_origin=origin).scan


def named_side(side: str, error: InputError | TransformUnavailableError) -> InputError | TransformUnavailableError:
    """The same error, with the side of the pair that it is about."""
    return type(error)(f"{side}: {error}")


def labels(job: Job) -> tuple[CloudLabel | None, CloudLabel | None]:
    """Source and target of a job."""
    if isinstance(job, DropJob):
        return job.source, job.target
    if isinstance(job, PairJob):
        return job.source.label, job.target.label
    return job.cloud.label, job.cloud.label


def drop_decision(job: DropJob, config: Config) -> Decision:
    """The decision on what was given up."""
    return Decision(dropped(job.reason, job.detail, config.method), job.source, job.target)


def received_s(job: Job) -> float | None:
    """When the last cloud of a job came (steady clock); None for what is dropped."""
    if isinstance(job, DropJob):
        return None
    return max(job.source.received_s, job.target.received_s) if isinstance(job, PairJob) else job.cloud.received_s
