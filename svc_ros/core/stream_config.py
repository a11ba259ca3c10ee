"""Values of what works on a stream of scans: scan matching, loop closure and localisation."""

from __future__ import annotations

from dataclasses import dataclass

from svc_ros.core.config_fields import Group, value


@dataclass(frozen=True)
class ScanMatchingConfig(Group):
    """Motion by KISS-ICP, judged against keyframes."""

    map_voxel_size_m: float = value(1.0, "edge of the voxels of KISS-ICP's map", "m", 0.01, 10.0)
    max_iterations: int = value(100, "most ICP rounds of one motion", "", 1, 1000)
    first_threshold_m: float = value(2.0, "error that the first predictions may have", "m", 1e-3, 100.0)
    verify_points: int = value(3000, "least points that a scan is judged with, if it has them", "", 100, 1_000_000)
    min_probability: float = value(0.75, "an accepted pose that is less probable is left undecided", "", 0.0, 1.0)
    min_recovery_probability: float = value(0.85, "the same of a pose that a registration found", "", 0.0, 1.0)
    keyframe_overlap: float = value(0.6, "with less oriented overlap a scan becomes the next keyframe", "", 0.0, 1.0)
    keyframe_distance_m: float = value(8.0, "farther from its keyframe a scan becomes the next one", "m", 0.01, 1000.0)
    max_keyframes: int = value(20, "most keyframes that are kept, the newest", "", 1, 10_000)
    recovery_attempts: int = value(2, "most keyframes that a scan with a rejected motion is registered to", "", 0, 100)


@dataclass(frozen=True)
class LoopClosureConfig(Group):
    """Keyframes, candidates for loops among them, and how many are judged."""

    keyframe_distance_m: float = value(2.0, "a scan this far from the last keyframe becomes one", "m", 0.0, 1000.0)
    keyframe_rotation_deg: float = value(30.0, "a scan turned this far from it becomes one, too", "deg", 0.0, 180.0)
    max_keyframes: int = value(500, "most keyframes that are kept, the newest", "", 2, 100_000)
    min_probability: float = value(0.85, "an accepted pose that is less probable is left undecided", "", 0.0, 1.0)
    min_gap_s: float = value(20.0, "least time between the two scans of a loop", "s", 0.0, 1e6)
    max_distance_m: float = value(15.0, "keyframes farther by odometry are no candidates by distance", "m", 0.0, 1e5)
    max_near: int = value(1, "most candidates of a keyframe by distance", "", 0, 1000)
    max_similar: int = value(1, "most candidates of a keyframe by the look of the place", "", 0, 1000)
    min_similarity: float = value(0.72, "least similarity of places that look the same", "", 0.0, 1.0)


@dataclass(frozen=True)
class AgreementConfig(Group):
    """Loops of a run held against each other, and how far odometry is believed for it."""

    drift_ratio: float = value(0.05, "odometry's error (one sigma) over the length of its way", "", 1e-4, 1.0)
    drift_deg_per_metre: float = value(1.0, "its error in direction for each metre", "deg/m", 1e-4, 90.0)
    independent_m: float = value(3.0, "loops between places nearer than this are one piece of evidence", "m", 0.0, 1e4)
    odometry_failure: float = value(0.01, "how often odometry is wrong by far more than that", "", 1e-9, 0.5)


@dataclass(frozen=True)
class LocalizationConfig(Group):
    """Finding the sensor in a map of keyframes, and judging where others say that it is."""

    max_similar: int = value(4, "most keyframes by the look of the place that a lost scan is registered to", "", 0, 100)
    max_neighbours: int = value(3, "most keyframes around a pose that judge it, each from its own origin", "", 1, 100)
    min_probability: float = value(0.75, "an accepted pose that is less probable confirms nothing", "", 0.0, 1.0)
    sure_probability: float = value(0.95, "a found pose less probable than this needs more scans", "", 0.0, 1.0)
    agreeing_scans: int = value(3, "where one scan is not enough so many have to agree along odometry", "", 2, 100)
    agreeing_distance_m: float = value(2.0, "these scans are at least so far apart", "m", 0.0, 1000.0)
    lost_after_s: float = value(10.0, "a place that no scan has confirmed for so long is lost", "s", 0.0, 1e6)
