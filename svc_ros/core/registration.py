"""The story: from two scans to a verdict with its evidence."""

from __future__ import annotations

from numpy.typing import ArrayLike

from svc_ros.core.config import Config
from svc_ros.core.matches.descriptors import load_descriptors
from svc_ros.core.matches.features import compute_features
from svc_ros.core.matches.matcher import Described, Given, Matcher
from svc_ros.core.methods import METHODS, VERIFIERS
from svc_ros.core.pair import Pair
from svc_ros.core.parallel import on_all_processors
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Correspondences, Features, PreparedScan, Scan
from svc_ros.core.scans.preprocess import preprocess
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
    place of all that is found in the scans. No alignment is a verdict, never an exception; broken input raises an
    InputError (TooFewPointsError for a scan without enough points), what is wrong with a configured descriptor a
    ConfigError, MissingDependencyError or DescriptorError.
    """
    pair = _prepared_pair(source, target, config)
    # Describe both scans, unless they are matched elsewhere; matches are made when a look asks for them.
    matcher = _matcher(pair, source, target, correspondences)
    # Look for the pose and judge it, each method in its own way; the default one looks up to three times.
    return METHODS[config.method](pair, matcher)


def verify(
    source: Scan | PreparedScan | Features,
    target: Scan | PreparedScan | Features,
    T_target_source: ArrayLike,
    config: Config,
) -> RegistrationResult:
    """Judge a pose that somebody else found. It is refined first, within bounds; raises InputError if it is no pose."""
    T = nearest_pose(check_pose(T_target_source))
    return VERIFIERS[config.method](_prepared_pair(source, target, config), T)


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


def _matcher(
    pair: Pair, source: Scan | Features, target: Scan | Features, correspondences: Correspondences | None
) -> Matcher:
    if correspondences is not None:
        return Given(correspondences)
    load_descriptors(pair.config)  # what cannot be used is told at the first pair, not at the first one that is hard
    known = [features if isinstance(features, Features) else None for features in (source, target)]
    return Described(pair, (known[0], known[1]))
