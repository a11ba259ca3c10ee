"""From many hypotheses to a few distinct poses, each refined before it is judged."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from svc_ros.core import se3
from svc_ros.core.config import Config, HypothesisConfig, ShortlistConfig
from svc_ros.core.kernels import agreement as agreement_kernels
from svc_ros.core.parallel import on_all_processors
from svc_ros.core.scan import Array, Correspondences, HypothesisSet, IndexArray, PreparedScan
from svc_ros.core.search.prescore import prescore


def select_distinct(T: Array, config: ShortlistConfig, limit: int) -> IndexArray:
    """Indices of at most `limit` poses (H, 4, 4), in order, none near one that stands before it."""
    return select_apart(np.ones(len(T), bool), lambda i: find_near(T, T[i], config), limit)


def select_apart(wanted: NDArray[np.bool_], near: Callable[[int], NDArray[np.bool_]], limit: int) -> IndexArray:
    """Indices of at most `limit` of the wanted (H,), in order, none near one that is chosen before it.

    near: index -> mask (H,) of those that stand for the same.
    """
    chosen: list[int] = []
    free = wanted.copy()
    for i in range(len(free)):
        if len(chosen) == limit:
            break
        if free[i]:
            chosen.append(i)
            free &= ~near(i)
    return np.asarray(chosen, np.int64)


def find_near(T: Array, pose: Array, config: ShortlistConfig) -> NDArray[np.bool_]:
    """Mask (H,) of the poses (H, 4, 4) that are the same as `pose` (4, 4) within the distinctness limits."""
    angle = se3.rotation_angle_deg(np.einsum("hji,jk->hik", T[:, :3, :3], pose[:3, :3]))
    distance = np.linalg.norm(T[:, :3, 3] - pose[:3, 3], axis=1)
    return np.asarray((angle <= config.distinct_rotation_deg) & (distance <= config.distinct_translation_m))


def refine_on_correspondences(
    T: Array, correspondences: Correspondences, hypotheses: HypothesisConfig, config: ShortlistConfig, rounds: int = -1
) -> Array:
    """Weighted Kabsch on the inliers, weights 1 / (1 + (e / eps)^2), until their number stops changing.

    At most that many rounds; as many as configured unless told otherwise.
    """
    refined = np.array(T, np.float64)
    agreement_kernels.refine(
        refined, correspondences.source_points, correspondences.target_points, hypotheses.inlier_threshold_m,
        config.correspondence_eps_m, config.correspondence_rounds if rounds < 0 else rounds,
    )  # fmt: skip
    return refined


def order_by_agreement(T: Array, source: PreparedScan, target: PreparedScan, config: Config) -> Array:
    """The poses (H, 4, 4), those first that put most of the source on agreeing target surface."""
    agreement = prescore(T, source, target, config.sight_view.tolerance_m, config.shortlist.prescore_points)
    return T[np.argsort(-agreement, kind="stable")]


def shortlist(
    hypotheses: HypothesisSet, correspondences: Correspondences, by_agreement: Array, config: Config
) -> Array:
    """The best distinct hypotheses (S, 4, 4), refined on the correspondences.

    Drawn from the order by the scans' own agreement and, for a quarter of the places, from the hypotheses' rank.
    """
    limits = config.shortlist
    T = hypotheses.T_target_source
    by_rank = T[select_distinct(T, limits, max(1, limits.max_poses // 4))]
    first = by_agreement[select_distinct(by_agreement, limits, limits.max_poses)]
    poses = np.concatenate((by_rank, first))
    for rounds in (min(3, limits.correspondence_rounds), limits.correspondence_rounds):  # many soon become one
        refine = partial(
            refine_on_correspondences, correspondences=correspondences, hypotheses=config.hypotheses, config=limits,
            rounds=rounds,
        )  # fmt: skip
        poses = np.array(on_all_processors(refine, poses))
        poses = poses[select_distinct(poses, limits, limits.max_poses)]
    return poses
