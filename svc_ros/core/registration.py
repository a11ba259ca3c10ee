"""The story: from two scans to a verdict with its evidence."""

from __future__ import annotations

from numpy.typing import ArrayLike

from svc_ros.core import selection
from svc_ros.core.config import Config
from svc_ros.core.descriptors import load_descriptors, more_matches
from svc_ros.core.features import compute_features
from svc_ros.core.hypotheses import generate_from_each, generate_hypotheses, pool_hypotheses
from svc_ros.core.matching import match
from svc_ros.core.pair import Pair
from svc_ros.core.parallel import on_all_processors
from svc_ros.core.preprocess import preprocess
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Correspondences, Features, PreparedScan, Scan
from svc_ros.core.se3 import check_pose, nearest_pose
from svc_ros.core.stopwatch import Stopwatch


def prepare(scan: Scan, config: Config) -> PreparedScan:
    """Crop, thin and orient one scan: all that `verify` needs. Raises TooFewPointsError."""
    return preprocess(scan, config.preprocess)


def extract_features(scan: Scan | PreparedScan, config: Config) -> Features:
    """Prepare and describe one scan, to be reused in every pair it takes part in. Raises TooFewPointsError."""
    return compute_features(scan if isinstance(scan, PreparedScan) else prepare(scan, config), config)


def register(
    source: Scan | Features, target: Scan | Features, config: Config, correspondences: Correspondences | None = None
) -> RegistrationResult:
    """Find the pose of the source in the target's frame, and say whether it is right.

    Scans are prepared and described here; pass Features to reuse them. Correspondences computed elsewhere take the
    place of all matching. No alignment is a verdict, never an exception; broken input raises an InputError
    (TooFewPointsError for a scan without enough points), what is wrong with a configured descriptor a ConfigError,
    MissingDependencyError or DescriptorError.
    """
    pair = _prepared_pair(source, target, config)
    if correspondences is not None:
        return _answer(pair, [correspondences])
    load_descriptors(config)  # what cannot be used is told at the first pair, not at the first one that is hard
    # Describe every point.
    with pair.watch.stage("features"):
        described = _described(source, pair.source, config), _described(target, pair.target, config)
    # Match the descriptors; a part of many is enough for most pairs, and all are matched where it is not.
    if config.method == "svc" and 0 < config.matching.first_points < max(map(len, described)):
        result = _answer(pair.without_wide_search(), [_matched(pair, described, config.matching.first_points)])
        if result.accepted:
            return result
    return _answer(pair, [_matched(pair, described), *_matched_otherwise(pair)])


def _answer(pair: Pair, matches: list[Correspondences]) -> RegistrationResult:
    """The verdict that correspondences lead to, a set of each descriptor."""
    config, counts = pair.config, pair.counts
    counts["correspondences"], most = sum(map(len, matches)), max(map(len, matches))
    if most < config.matching.min_correspondences:
        detail = f"{most} correspondences, at least {config.matching.min_correspondences} are needed"
        return _unanswered(Reason.TOO_FEW_CORRESPONDENCES, detail, pair)
    matches = [each for each in matches if len(each) >= config.matching.min_correspondences]
    # Poses that many correspondences agree on.
    generate = pool_hypotheses if config.shortlist.rough_poses and config.method == "svc" else generate_hypotheses
    with pair.watch.stage("hypotheses"):
        hypotheses = generate_from_each(generate, matches, config.hypotheses)
    counts["hypotheses"] = len(hypotheses)
    if len(hypotheses) == 0:
        return _unanswered(Reason.NO_HYPOTHESIS, "no consistent set of correspondences", pair)
    # Choose one of them and judge it, each method in its own way.
    return selection.METHODS[config.method](pair, Correspondences.of_all(matches), hypotheses)


def verify(
    source: Scan | PreparedScan | Features,
    target: Scan | PreparedScan | Features,
    T_target_source: ArrayLike,
    config: Config,
) -> RegistrationResult:
    """Judge a pose that somebody else found. It is refined first, within bounds; raises InputError if it is no pose."""
    T = nearest_pose(check_pose(T_target_source))
    return selection.VERIFIERS[config.method](_prepared_pair(source, target, config), T)


def _prepared_pair(
    source: Scan | PreparedScan | Features, target: Scan | PreparedScan | Features, config: Config
) -> Pair:
    """Thin the scans and turn their normals to the sensor, unless that was done before; its time begins here."""
    watch = Stopwatch()
    both_raw = isinstance(source, Scan) and isinstance(target, Scan)
    with watch.stage("prepare"):
        source_scan, target_scan = (on_all_processors if both_raw else map)(
            lambda scan: _prepared(scan, config), (source, target)
        )
    counts = {"source_points": len(source_scan), "target_points": len(target_scan)}
    return Pair(source_scan, target_scan, config, counts, watch)


def _prepared(scan: Scan | PreparedScan | Features, config: Config) -> PreparedScan:
    if isinstance(scan, Features):
        return scan.prepared
    return prepare(scan, config) if isinstance(scan, Scan) else scan


def _described(given: Scan | Features, prepared: PreparedScan, config: Config) -> Features:
    return given if isinstance(given, Features) else compute_features(prepared, config)


def _matched(pair: Pair, described: tuple[Features, Features], num_points: int | None = None) -> Correspondences:
    with pair.watch.stage("matching"):
        return match(*described, pair.config.matching, num_points)


def _matched_otherwise(pair: Pair) -> list[Correspondences]:
    """What descriptors beside FPFH match, where any are configured."""
    if not pair.config.matching.more_descriptors:
        return []
    with pair.watch.stage("more_matches"):
        found = more_matches(pair.source, pair.target, pair.config)
    pair.counts["more_correspondences"] = sum(map(len, found))
    return found


def _unanswered(reason: Reason, detail: str, pair: Pair) -> RegistrationResult:
    return RegistrationResult(
        Verdict.REJECTED, reason, pair.config.method, probability=0.0, counts=pair.counts, time_ms=pair.watch.times(),
        detail=detail,
    )  # fmt: skip
