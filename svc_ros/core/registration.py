"""The story: from two scans to a verdict with its evidence."""

from __future__ import annotations

from numpy.typing import ArrayLike

from svc_ros.core import selection
from svc_ros.core.config import Config
from svc_ros.core.features import compute_features
from svc_ros.core.hypotheses import generate_hypotheses
from svc_ros.core.matching import match
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

    Scans are prepared and described here; pass Features to reuse them. Correspondences computed elsewhere (learned
    descriptors) take the place of FPFH matching. No alignment is a verdict, never an exception; broken input raises
    an InputError (TooFewPointsError for a scan without enough points).
    """
    watch = Stopwatch()
    # Thin the scans and turn their normals to the sensor.
    with watch.stage("prepare"):
        source_scan, target_scan = _both_prepared(source, target, config)
    # Describe every point and match the descriptors.
    if correspondences is None:
        with watch.stage("features"):
            source_features = _described(source, source_scan, config)
            target_features = _described(target, target_scan, config)
        with watch.stage("matching"):
            correspondences = match(source_features, target_features, config.matching)
    counts = _count_points(source_scan, target_scan) | {"correspondences": len(correspondences)}
    if len(correspondences) < config.matching.min_correspondences:
        detail = f"{len(correspondences)} correspondences, at least {config.matching.min_correspondences} are needed"
        return _unanswered(Reason.TOO_FEW_CORRESPONDENCES, detail, config, counts, watch)
    # Poses that many correspondences agree on.
    with watch.stage("hypotheses"):
        hypotheses = generate_hypotheses(correspondences, config.hypotheses)
    counts["hypotheses"] = len(hypotheses)
    if len(hypotheses) == 0:
        return _unanswered(Reason.NO_HYPOTHESIS, "no consistent set of correspondences", config, counts, watch)
    # Choose one of them and judge it, each method in its own way.
    choose = selection.METHODS[config.method]
    return choose(selection.Pair(source_scan, target_scan, config, counts, watch), correspondences, hypotheses)


def verify(
    source: Scan | PreparedScan | Features,
    target: Scan | PreparedScan | Features,
    T_target_source: ArrayLike,
    config: Config,
) -> RegistrationResult:
    """Judge a pose that somebody else found. It is refined first, within bounds; raises InputError if it is no pose."""
    watch = Stopwatch()
    T = nearest_pose(check_pose(T_target_source))
    with watch.stage("prepare"):
        source_scan, target_scan = _both_prepared(source, target, config)
    counts = _count_points(source_scan, target_scan)
    return selection.VERIFIERS[config.method](selection.Pair(source_scan, target_scan, config, counts, watch), T)


def _both_prepared(
    source: Scan | PreparedScan | Features, target: Scan | PreparedScan | Features, config: Config
) -> tuple[PreparedScan, PreparedScan]:
    source_scan, target_scan = on_all_processors(lambda scan: _prepared(scan, config), (source, target))
    return source_scan, target_scan


def _prepared(scan: Scan | PreparedScan | Features, config: Config) -> PreparedScan:
    if isinstance(scan, Features):
        return scan.prepared
    return prepare(scan, config) if isinstance(scan, Scan) else scan


def _described(given: Scan | Features, prepared: PreparedScan, config: Config) -> Features:
    return given if isinstance(given, Features) else compute_features(prepared, config)


def _count_points(source: PreparedScan, target: PreparedScan) -> dict[str, int]:
    return {"source_points": len(source), "target_points": len(target)}


def _unanswered(
    reason: Reason, detail: str, config: Config, counts: dict[str, int], watch: Stopwatch
) -> RegistrationResult:
    return RegistrationResult(
        Verdict.REJECTED, reason, config.method, probability=0.0, counts=counts, time_ms=watch.times(), detail=detail
    )
