"""Every number that a user may set: one frozen tree, with units, ranges and the paper's symbols.

The tree is the single source: the YAML files in `config/`, the ROS parameters and `svc_ros config` are walks over it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from svc_ros.core.config_fields import FieldInfo, Group, unknown_name, value, walk
from svc_ros.core.decision_config import CovarianceConfig, DecisionConfig
from svc_ros.core.errors import ConfigError
from svc_ros.core.matches.descriptor_names import split_names
from svc_ros.core.stream_config import AgreementConfig, LocalizationConfig, LoopClosureConfig, ScanMatchingConfig

__all__ = [
    "AUTO", "METHODS", "PRESETS", "Config", "FieldInfo", "preset", "unknown_name", "values_of", "walk", "with_values",
]  # fmt: skip

METHODS = ("svc", "svc_paper", "sc2")
AUTO = "auto"  # the preset that core.auto_preset chooses from the scans


@dataclass(frozen=True)
class PreprocessConfig(Group):
    """Range crop, voxel grid, normals (method section 5)."""

    voxel_size_m: float = value(0.3, "edge of the voxel grid that thins a scan (v)", "m", 0.005, 10.0)
    min_range_m: float = value(1.0, "points nearer to the sensor are dropped: the vehicle, the carrier", "m", 0.0, 1e4)
    max_range_m: float = value(80.0, "points farther from the sensor are dropped", "m", 0.1, 1e4)
    normal_radius_voxels: float = value(2.0, "neighbourhood of a normal, in voxels", "voxels", 1.0, 20.0)
    normal_max_neighbours: int = value(30, "most neighbours used for a normal", "", 3, 1000)
    min_points: int = value(100, "fewer points than this after the voxel grid are no scan", "", 3, 10_000_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_range_m >= self.max_range_m:
            raise ConfigError(
                f"preprocess: min_range_m ({self.min_range_m}) must be below max_range_m ({self.max_range_m})"
            )

    @property
    def normal_radius_m(self) -> float:
        """Neighbourhood of a normal [m]."""
        return self.normal_radius_voxels * self.voxel_size_m


@dataclass(frozen=True)
class FeatureConfig(Group):
    """FPFH (method section 5)."""

    radius_voxels: float = value(5.0, "neighbourhood of a descriptor, in voxels", "voxels", 1.0, 50.0)
    max_neighbours: int = value(100, "most neighbours used for a descriptor", "", 5, 10_000)


@dataclass(frozen=True)
class MatchingConfig(Group):
    """Nearest descriptors become correspondences."""

    strategy: str = value(
        "mutual", "which nearest neighbours become correspondences", choices=("one_way", "mutual", "ratio")
    )
    first_points: int = value(4500, "so many are matched at first, all if that is not accepted; 0: all", "", 0, 10**6)
    max_correspondences: int = value(5000, "the best by distance (ratio: by ratio) are kept", "", 3, 100_000)
    min_correspondences: int = value(10, "fewer are answered with too_few_correspondences", "", 3, 100_000)
    more_descriptors: str = value("", "descriptors whose matches join the last look: names with commas")

    def __post_init__(self) -> None:
        super().__post_init__()
        split_names(self.more_descriptors)  # whether they are installed matters to those who use them only


@dataclass(frozen=True)
class HypothesisConfig(Group):
    """Second-order spatial compatibility (SC2-PCR; method section 4)."""

    compatibility_threshold_m: float = value(0.1, "length difference of two compatible pairs (d_thr)", "m", 1e-3, 10.0)
    inlier_threshold_m: float = value(0.6, "residual of an inlier correspondence (tau_in)", "m", 1e-3, 10.0)
    nms_radius_m: float = value(0.6, "a seed has the largest eigenvector entry within this radius", "m", 0.0, 100.0)
    seed_ratio: float = value(0.2, "share of the correspondences that may become seeds", "", 1e-3, 1.0)
    max_seeds: int = value(2000, "most seeds, whatever their share", "", 1, 100_000)
    first_consensus: int = value(30, "size of the first consensus set (k1)", "", 3, 64)
    second_consensus: int = value(20, "size of the second consensus set (k2)", "", 3, 64)
    power_iterations: int = value(20, "rounds of the power iteration", "", 1, 1000)
    ranking: str = value("ic", "metric that ranks hypotheses", choices=("ic", "mae", "mse"))
    levelled_poses: int = value(24, "turns and shifts on the ground, tried where both scans see it", "", 0, 1000)
    gravity_aligned: bool = value(False, "z is up in both scans: poses that tilt it more than max_tilt_deg are dropped")
    max_tilt_deg: float = value(10.0, "largest tilt of a hypothesis, if gravity_aligned", "deg", 0.0, 180.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.second_consensus > self.first_consensus:
            raise ConfigError("hypotheses: second_consensus must not exceed first_consensus")


@dataclass(frozen=True)
class ShortlistConfig(Group):
    """Distinct hypotheses, each refined before it is judged."""

    max_poses: int = value(8, "distinct poses that are refined and judged", "", 1, 1000)
    rough_poses: int = value(60, "poses of the wide search, if none of the first is accepted", "", 0, 10_000)
    rough_points: int = value(300, "source points of the wide search's ICP", "", 50, 100_000)
    rough_view_points: int = value(3000, "points of each scan in the wide search's sight lines", "", 100, 1_000_000)
    rough_icp_distance_m: float = value(1.5, "largest distance of an ICP pair in the wide search", "m", 1e-3, 10.0)
    prescore_points: int = value(500, "source points of the cheap look", "", 10, 100_000)
    distinct_rotation_deg: float = value(5.0, "poses farther apart than this are distinct", "deg", 0.0, 180.0)
    distinct_translation_m: float = value(1.0, "poses farther apart than this are distinct", "m", 0.0, 100.0)
    max_moved_rotation_deg: float = value(6.0, "a given pose turned more by refinement is not right", "deg", 0.0, 180)
    max_moved_translation_m: float = value(0.72, "a given pose moved more by refinement is not right", "m", 0.0, 1e2)
    correspondence_rounds: int = value(20, "rounds of weighted Kabsch on the correspondences", "", 0, 100)
    correspondence_eps_m: float = value(1.2, "residual at which a weight is one half (eps)", "m", 1e-3, 10.0)
    icp_rounds: int = value(20, "rounds of point-to-plane ICP", "", 0, 200)
    icp_points: int = value(1000, "source points of the shortlist's ICP", "", 50, 1_000_000)
    icp_last_points: int = value(3000, "source points of the last ICP, of the pose that is judged", "", 50, 1_000_000)
    icp_distance_m: float = value(1.0, "largest distance of an ICP pair", "m", 1e-3, 10.0)


@dataclass(frozen=True)
class SightViewConfig(Group):
    """Sight lines of the default method (method section 3)."""

    tolerance_m: float = value(0.6, "range and overlap tolerance (tau)", "m", 1e-3, 10.0)
    beam_radius_voxels: float = value(0.5, "a point blocks a line that passes within this of it", "voxels", 0.05, 5.0)
    cone_beams: float = value(0.75, "cap of the cone's half angle (theta), in beam spacings", "beams", 0.1, 10.0)
    min_cone_deg: float = value(0.25, "the cap is never below this, however dense the beams", "deg", 0.01, 45.0)
    max_cone_deg: float = value(1.5, "the cap is never above this, however sparse the beams", "deg", 0.05, 45.0)
    max_incidence_deg: float = value(85.0, "cap of the angle between ray and normal (phi)", "deg", 0.0, 89.9)
    denied_margin: float = value(0.5, "surface so much of tau before what was seen is denied", "", 0.0, 10)
    denied_margin_per_range: float = value(0.01, "and by this share of its range, as noise grows with it", "", 0.0, 1.0)
    wide_cluster_deg: float = value(30.0, "denied clusters seen over less count for less", "deg", 1.0, 180.0)
    free_reach_m: float = value(30.0, "surface met head on is surely seen up to this", "m", 0.0, 1e4)
    same_side_cosine: float = value(0.3, "normals agree above this, are opposed below its negative", "", 0.0, 1.0)


@dataclass(frozen=True)
class PaperConfig(Group):
    """Algorithms 1 and 2 of the paper, used by method svc_paper only (method section 2)."""

    tolerance_m: float = value(0.6, "tolerance of overlap and of blocking (tau)", "m", 1e-3, 10.0)
    cone_cosine: float = value(0.99997, "dot product above which two directions are one sight line", "", 0.0, 1.0)
    max_blocked_ratio: float = value(0.02, "a pose passes below this blocked share (eta2)", "", 0.0, 1.0)
    max_hypotheses: int = value(200, "hypotheses that are tried in order (K)", "", 1, 100_000)


@dataclass(frozen=True)
class Config(Group):
    """The whole configuration of one registration."""

    method: str = value("svc", "how a pose is chosen and judged", choices=METHODS)
    preprocess: PreprocessConfig = field(default_factory=PreprocessConfig)
    features: FeatureConfig = field(default_factory=FeatureConfig)
    matching: MatchingConfig = field(default_factory=MatchingConfig)
    hypotheses: HypothesisConfig = field(default_factory=HypothesisConfig)
    shortlist: ShortlistConfig = field(default_factory=ShortlistConfig)
    sight_view: SightViewConfig = field(default_factory=SightViewConfig)
    paper: PaperConfig = field(default_factory=PaperConfig)
    decision: DecisionConfig = field(default_factory=DecisionConfig)
    covariance: CovarianceConfig = field(default_factory=CovarianceConfig)
    scan_matching: ScanMatchingConfig = field(default_factory=ScanMatchingConfig)
    loop_closure: LoopClosureConfig = field(default_factory=LoopClosureConfig)
    agreement: AgreementConfig = field(default_factory=AgreementConfig)
    localization: LocalizationConfig = field(default_factory=LocalizationConfig)

    @property
    def feature_radius_m(self) -> float:
        """Neighbourhood of a descriptor [m]."""
        return self.features.radius_voxels * self.preprocess.voxel_size_m


def values_of(config: Config) -> dict[str, float | int | str | bool]:
    """Every value of the tree by its dotted name, in order."""
    return {info.name: info.default for info in walk(config)}


def with_values(config: Config, values: Mapping[str, Any]) -> Config:
    """Return a copy with dotted names replaced, checked as a whole; unknown names raise ConfigError."""
    known = list(values_of(config))
    groups: dict[str, dict[str, Any]] = {}
    for name, new in values.items():
        if name not in known:
            raise ConfigError(unknown_name("config", name, known))
        group, _, leaf = name.rpartition(".")
        groups.setdefault(group, {})[leaf] = new
    changes: dict[str, Any] = groups.pop("", {})
    for group, leaves in groups.items():
        try:
            changes[group] = dataclasses.replace(getattr(config, group), **leaves)
        except ConfigError as error:
            raise ConfigError(f"{group}.{error}" if not str(error).startswith(group) else str(error)) from None
    return dataclasses.replace(config, **changes)


PRESETS: dict[str, Config] = {
    "lidar_outdoor": Config(),
    "lidar_indoor": with_values(
        Config(),
        {
            "preprocess.voxel_size_m": 0.3,
            "preprocess.min_range_m": 0.5,
            "preprocess.max_range_m": 60.0,
            "preprocess.normal_radius_voxels": 3.0,
            "preprocess.normal_max_neighbours": 100,
            "features.radius_voxels": 4.0,
            "features.max_neighbours": 400,
            "hypotheses.compatibility_threshold_m": 0.3,
            "hypotheses.nms_radius_m": 0.1,
            "hypotheses.seed_ratio": 1.0,
            "hypotheses.first_consensus": 12,
            "hypotheses.second_consensus": 6,
            "shortlist.rough_poses": 200,
            "shortlist.icp_points": 2500,
            "sight_view.tolerance_m": 0.4,
            "scan_matching.keyframe_distance_m": 3.0,
            "loop_closure.keyframe_distance_m": 1.0,
            "loop_closure.max_distance_m": 12.0,
            "localization.agreeing_distance_m": 1.0,
        },
    ),
    "rgbd_indoor": with_values(
        Config(),
        {
            "preprocess.voxel_size_m": 0.05,
            "preprocess.min_range_m": 0.0,
            "preprocess.max_range_m": 10.0,
            "hypotheses.inlier_threshold_m": 0.1,
            "hypotheses.nms_radius_m": 0.1,
            "shortlist.distinct_rotation_deg": 10.0,
            "shortlist.distinct_translation_m": 0.3,
            "shortlist.max_moved_rotation_deg": 18.0,
            "shortlist.max_moved_translation_m": 0.36,
            "shortlist.correspondence_eps_m": 0.1,
            "shortlist.icp_distance_m": 0.15,
            "shortlist.rough_icp_distance_m": 0.2,
            "sight_view.tolerance_m": 0.1,
            "sight_view.free_reach_m": 3.0,
            "decision.slip_m": 0.9,
            "covariance.points_per_constraint": 200.0,
            "covariance.floor_translation_m": 0.01,
            "paper.tolerance_m": 0.1,
            "scan_matching.map_voxel_size_m": 0.1,
            "scan_matching.first_threshold_m": 0.2,
            "scan_matching.keyframe_distance_m": 0.5,
            "loop_closure.keyframe_distance_m": 0.3,
            "loop_closure.max_distance_m": 3.0,
            "agreement.independent_m": 0.6,
            "localization.agreeing_distance_m": 0.3,
        },
    ),
}


def preset(name: str) -> Config:
    """Return the named preset or raise ConfigError with the nearest name; `auto` needs scans: see choose_preset."""
    if name == AUTO:
        raise ConfigError(f"preset: auto is chosen from scans, and here are none: name one of {', '.join(PRESETS)}")
    if name not in PRESETS:
        raise ConfigError(unknown_name("preset", name, [*PRESETS, AUTO]))
    return PRESETS[name]
