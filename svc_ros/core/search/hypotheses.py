"""SC2-PCR: seeds -> consensus sets -> poses, ranked over all correspondences (method section 4)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from svc_ros.core import se3
from svc_ros.core.config import HypothesisConfig
from svc_ros.core.kernels import compatibility as kernels
from svc_ros.core.parallel import in_parts, on_all_processors
from svc_ros.core.scan import Array, Correspondences, HypothesisSet, IndexArray
from svc_ros.core.search.compatibility import compute_compatibility, leading_eigenvector

Generator = Callable[[Correspondences, HypothesisConfig], HypothesisSet]

_SEEDS, _POINTS = 128, 256  # that one thread takes at once


def generate_hypotheses(correspondences: Correspondences, config: HypothesisConfig) -> HypothesisSet:
    """Poses T_target_source that many correspondences agree on, best first; empty where there are none."""
    x, y = correspondences.source_points, correspondences.target_points
    compatibility = compute_compatibility(correspondences, config.compatibility_threshold_m)
    confidence = leading_eigenvector(compatibility, config.power_iterations)
    seeds = select_seeds(x, confidence, config)
    sets, sizes = find_consensus_sets(correspondences, seeds, compatibility.loose, compatibility.tight, config)
    weights = np.zeros(sets.shape)
    kernels.set_weights(sets, sizes, x, y, config.compatibility_threshold_m, config.power_iterations, weights)
    T, valid = se3.kabsch(x[sets], y[sets], weights)
    T = T[valid & (sizes >= 3)]
    return rank(drop_tilted(T, config.max_tilt_deg) if config.gravity_aligned else T, correspondences, config)


def pool_hypotheses(correspondences: Correspondences, config: HypothesisConfig) -> HypothesisSet:
    """Those of the configured compatibility threshold and of one as large as the inlier threshold, best first.

    A narrow threshold parts few right matches from very many wrong ones; where all right matches are off by more, along
    a wide road between structures that repeat, only the wide one finds their sets.
    """
    found = [generate_hypotheses(correspondences, config)]
    if config.inlier_threshold_m > config.compatibility_threshold_m:
        wide = dataclasses.replace(config, compatibility_threshold_m=config.inlier_threshold_m)
        found.append(generate_hypotheses(correspondences, wide))
    T, num_inliers, score = (
        np.concatenate([getattr(each, name) for each in found]) for name in ("T_target_source", "num_inliers", "score")
    )
    order = np.argsort(-score, kind="stable")
    return HypothesisSet(T[order], num_inliers[order], score[order])


def generate_from_each(generate: Generator, sets: Sequence[Correspondences], config: HypothesisConfig) -> HypothesisSet:
    """Those of every set of correspondences by itself, ranked over all of them together: few right ones of one
    descriptor would be lost among many wrong ones of another."""
    found = [generate(each, config) for each in sets]
    if len(found) == 1:
        return found[0]
    return rank(np.concatenate([each.T_target_source for each in found]), Correspondences.of_all(sets), config)


def select_seeds(source_points: Array, confidence: Array, config: HypothesisConfig) -> IndexArray:
    """Local maxima of the confidence in source space, best first, at most a share of all; never padded."""
    order = np.argsort(-confidence, kind="stable")
    points, score, is_maximum = source_points[order], confidence[order], np.zeros(len(order), bool)

    def mark(part: slice) -> None:
        kernels.mark_local_maxima(part.start, part.stop, points, score, config.nms_radius_m, is_maximum)

    on_all_processors(mark, in_parts(len(order), _POINTS))
    limit = min(config.max_seeds, max(1, int(config.seed_ratio * len(confidence))))
    return order[is_maximum][:limit]


def find_consensus_sets(
    correspondences: Correspondences,
    seeds: IndexArray,
    loose: NDArray[np.uint64],
    tight: NDArray[np.uint64],
    config: HypothesisConfig,
) -> tuple[IndexArray, IndexArray]:
    """Consensus sets (S, k2) of the seeds as correspondence indices, and how many of each row are valid (S,)."""
    sets = np.zeros((len(seeds), config.second_consensus), np.int64)
    sizes = np.zeros(len(seeds), np.int64)

    def fill(part: slice) -> None:
        kernels.consensus_sets(
            seeds[part], correspondences.source_points, correspondences.target_points,
            config.compatibility_threshold_m, loose, tight, config.first_consensus, config.second_consensus,
            sets[part], sizes[part],
        )  # fmt: skip

    on_all_processors(fill, in_parts(len(seeds), _SEEDS))
    return sets, sizes


def drop_tilted(T: Array, max_tilt_deg: float) -> Array:
    """The poses (H, 4, 4) that tilt the z axis by at most `max_tilt_deg` [deg], however they turn about it."""
    tilt = np.degrees(np.arctan2(np.hypot(T[:, 0, 2], T[:, 1, 2]), T[:, 2, 2]))  # exact near 0 and near 180 deg
    return T[tilt <= max_tilt_deg]


def rank(T: Array, correspondences: Correspondences, config: HypothesisConfig) -> HypothesisSet:
    """Score poses (H, 4, 4) over all correspondences by the configured metric and sort them, best first.

    ic counts the inliers; mae and mse sum 1 - e / tau_in and its square over them (larger is better in all three).
    """
    num_inliers = np.zeros(len(T), np.int64)
    mae, mse = np.zeros(len(T)), np.zeros(len(T))
    x, y = correspondences.source_points, correspondences.target_points
    T = np.ascontiguousarray(T)

    def score_part(part: slice) -> None:
        kernels.score_poses(T[part], x, y, config.inlier_threshold_m, num_inliers[part], mae[part], mse[part])

    on_all_processors(score_part, in_parts(len(T), _SEEDS))
    score = {"ic": num_inliers.astype(np.float64), "mae": mae, "mse": mse}[config.ranking]
    order = np.argsort(-score, kind="stable")
    return HypothesisSet(T[order], num_inliers[order], score[order])
