"""Mode `localization`: each cloud of a stream gets a decision on its place in a map, each told pose one more."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.errors import TransformUnavailableError
from svc_ros.core.scan import Array, Scan
from svc_ros.io.g2o import adjoint
from svc_ros.io.results import UNKNOWN_COVARIANCE
from svc_ros.pipeline.localisation import LocalisationState, Localiser
from svc_ros.pipeline.map import Map
from svc_ros.pipeline.stream import StreamDecision, refuse_scan
from svc_ros.replay.stream import Odometry, odometry_by_matching
from svc_ros.ros.streams.decision import CloudReader, Decision, MapPlace, drop_decision
from svc_ros.ros.streams.loop_engine import warm_up_loops
from svc_ros.ros.streams.matching_engine import from_stream, judge_stream_again
from svc_ros.ros.streams.worker import DropJob, Job, PairJob, ScanJob
from svc_ros.ros.topics.poses import PoseBuffer

_KEPT_ODOMETRY = 1000
_MAX_SKEW_NS = 50_000_000  # what is told of a moment just before the first scan holds for that scan
TOLD, TOLD_FOR_NS = "told", 5_000_000_000  # who has told nothing for so long tells nothing wrong


@dataclass(frozen=True, eq=False)
class ToldPose:
    """Where somebody says that the cloud's frame stood in the map, T_map_cloud (4, 4); stamp_ns: 0 for now."""

    T_map_cloud: Array
    stamp_ns: int = 0


class MapSources(Protocol):
    """What localization asks for besides clouds. Where TF has no answer, TransformUnavailableError."""

    frame_of_map: str

    def origin(self, frame: str, stamp_ns: int) -> Array:
        """See CloudReader."""
        ...

    def base(self, frame: str, stamp_ns: int) -> Array:
        """T_base_cloud (4, 4); the identity where no base is asked for."""
        ...

    def odometry(self, scan: Scan) -> Array | None:
        """Where odometry says that the scan stands."""
        ...

    def told(self, scan: Scan) -> ToldPose | None:
        """The newest pose that somebody told up to the scan's stamp, each only once."""
        ...


class MapSettings(Protocol):
    """What of the node's settings says which map, and how the sensor moves."""

    @property
    def map_folder(self) -> str:
        """Where the map is."""
        ...

    @property
    def odometry(self) -> str:
        """Where odometry comes from: own, topic or tf."""
        ...


class LocalizationEngine:
    """Finds one sensor in a map and follows it; a change of the configuration begins the search anew.

    own_odometry: take the sensor's own motion (scan matching) instead of what `sources` say.
    """

    def __init__(self, sources: MapSources, keyframes: Map, own_odometry: bool) -> None:
        self._sources, self._map, self._own_odometry = sources, keyframes, own_odometry
        self._reader = CloudReader(sources.origin)
        self._odometry_of: Odometry = sources.odometry
        self._localiser: Localiser | None = None
        self._config: Config | None = None
        self._way = PoseBuffer(_KEPT_ODOMETRY)  # T_odom_cloud of the last scans
        self._last: StreamDecision | None = None
        self._last_ns, self._told_ns, self._judged_ns = 0, -TOLD_FOR_NS, 0
        self._num_told, self._told_problem = 0, ""

    @classmethod
    def of_folder(
        cls, sources: MapSources, settings: MapSettings, take: Callable[[Config], None]
    ) -> LocalizationEngine:
        """The engine for a map on disk. take: makes what the map was made with the values of the node.

        Raises InputError for a folder that is no map, what `take` raises, MissingDependencyError for own odometry.
        """
        keyframes, own_odometry = Map.read(settings.map_folder), settings.odometry == "own"
        try:
            take(keyframes.config)
            if own_odometry:
                odometry_by_matching(keyframes.config)  # a package that is missing is said now, not with the first scan
        except BaseException:
            keyframes.close()
            raise
        return cls(sources, keyframes, own_odometry)

    def process(self, job: Job, config: Config) -> list[Decision]:
        """The decision on a told pose, if there is one, and the one on the scan's own place; see Engine."""
        if isinstance(job, DropJob):
            return [drop_decision(job, config)]
        assert not isinstance(job, PairJob)
        start, label = time.monotonic(), job.cloud.label
        localiser = self._localiser_for(config)
        try:
            scan = self._reader.scan(job.cloud)
            T_base_cloud = self._sources.base(label.frame_id, label.stamp_ns)
            T_odom_cloud = self._odometry_of(scan)
        except Exception as error:
            localiser.pass_over(label.stamp_ns)
            refused = refuse_scan(label.stamp_ns, label.frame_id, error, config)
            place = MapPlace(T_map_odom=localiser.T_map_odom)
            return [dataclasses.replace(self._answer(refused, job, start), place=place)]
        told = self._told(scan, T_odom_cloud)
        found = localiser.add(scan, T_odom_cloud, told)
        self._last_ns = label.stamp_ns
        for decision in found:
            self._last = self._last if decision.scans is None else decision
        *on_others, own = found
        place = _place(own, T_base_cloud, localiser.T_map_odom)
        answers = [self._answer(decision, job, start) for decision in on_others]
        return [*answers, dataclasses.replace(self._answer(own, job, start), place=place)]

    def reset(self) -> None:
        """The next scan is looked for in the whole map."""
        self._localiser, self._last = None, None
        self._way.clear()
        self._told_ns, self._judged_ns, self._told_problem = -TOLD_FOR_NS, 0, ""

    def warm_up(self, config: Config) -> None:
        """See `warm_up_loops`: the same is computed here."""
        warm_up_loops(config, self._own_odometry)

    def judge_again(self, config: Config) -> dict[str, Any]:
        """Judge the last scan's pose once more, against the same keyframe; see Engine."""
        return judge_stream_again(self._last, config)

    def numbers(self) -> dict[str, Any]:
        """State, keyframes of the map, and what is known of the poses that others tell."""
        localiser = self._localiser
        state = LocalisationState.SEARCHING if localiser is None else localiser.state
        is_fresh = self._last_ns - self._told_ns < TOLD_FOR_NS
        return {
            "state": state.value,
            "map_keyframes": len(self._map),
            "told": self._num_told,
            "told_wrong": localiser is not None and is_fresh and localiser.is_told_wrong,
            "told_problem": self._told_problem,
        }

    def close(self) -> None:
        """Give the files of the map back."""
        self._map.close()

    def _localiser_for(self, config: Config) -> Localiser:
        if self._localiser is None or config != self._config:
            self.reset()
            self._localiser, self._config = Localiser(self._map, config), config
            self._odometry_of = odometry_by_matching(config) if self._own_odometry else self._sources.odometry
        return self._localiser

    def _told(self, scan: Scan, T_odom_cloud: Array | None) -> Array | None:
        """T_map_cloud (4, 4) of this scan as others tell it; what they said of an earlier moment goes with odometry."""
        if T_odom_cloud is not None:
            self._way.add(scan.stamp_ns, T_odom_cloud)
        try:
            told = self._sources.told(scan)
            if told is None or (told.stamp_ns and told.stamp_ns == self._judged_ns):
                return None  # nothing new
            T_map_cloud = told.T_map_cloud
            if told.stamp_ns not in (0, scan.stamp_ns):
                T_odom_then = self._way.at(told.stamp_ns, _MAX_SKEW_NS, 0.0)
                T_odom_now = self._way.at(scan.stamp_ns, 0, 0.0)
                T_map_cloud = T_map_cloud @ se3.invert(T_odom_then) @ T_odom_now
        except TransformUnavailableError as error:
            self._told_problem = str(error)
            return None
        self._told_ns, self._judged_ns = scan.stamp_ns, told.stamp_ns
        self._num_told, self._told_problem = self._num_told + 1, ""
        return T_map_cloud

    def _answer(self, decision: StreamDecision, job: ScanJob, start_s: float) -> Decision:
        return from_stream(decision, job, start_s, self._sources.frame_of_map, np.eye(4))


def _place(decision: StreamDecision, T_base_cloud: Array, T_map_odom: Array | None) -> MapPlace:
    """What the decision on a scan's own place says about the robot."""
    T_map_cloud, T_map_target = decision.T_odom_source, decision.T_odom_target
    if T_map_cloud is None or T_map_target is None:
        return MapPlace(T_map_odom=T_map_odom)
    relative = decision.result.covariance
    to_map = adjoint(T_map_target)
    covariance = to_map @ (UNKNOWN_COVARIANCE if relative is None else relative) @ to_map.T
    return MapPlace(T_map_cloud @ se3.invert(T_base_cloud), covariance, T_map_odom)
