"""One pair of raw scans by one method: svc_ros in its variants, and other packages."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any
from unittest.mock import patch

import numpy as np

from lib import (
    common,  # noqa: F401  it finds the checkout
    peers,
)
from lib.cliques import generate_clique_hypotheses
from lib.peers import PEERS, Attempt, Method
from svc_ros.core.config import Config, with_values
from svc_ros.core.scan import Scan
from svc_ros.core.search import looks, shortlist
from svc_ros.pipeline.decide import register_pair

CHANGES: dict[str, Mapping[str, Any]] = {
    "svc": {},
    "svc_paper": {"method": "svc_paper"},
    "sc2": {"method": "sc2"},
    "svc, one-way matches": {"matching.strategy": "one_way"},
    "svc, shortlist by rank": {},
    "svc, no look on the ground": {"hypotheses.levelled_poses": 0},
    "svc, one threshold, not on the ground": {"hypotheses.levelled_poses": 0},
    "svc, first look only": {"hypotheses.levelled_poses": 0, "shortlist.rough_poses": 0},
    "svc, wider FPFH too, not on the ground": {
        "hypotheses.levelled_poses": 0, "matching.more_descriptors": "fpfh_wide",
    },
    "svc, a fifth of the seeds": {"hypotheses.seed_ratio": 0.2},
    "svc, three-point cliques": {},
    "svc, gravity within 10 deg": {"hypotheses.gravity_aligned": True, "hypotheses.max_tilt_deg": 10.0},
    "svc, FPFH 5 voxels, normals 2": {
        "features.radius_voxels": 5.0, "features.max_neighbours": 100,
        "preprocess.normal_radius_voxels": 2.0, "preprocess.normal_max_neighbours": 30,
    },
}  # fmt: skip


def run_svc_ros(source: Scan, target: Scan, config: Config) -> Attempt:
    """register() with that configuration."""
    start = time.perf_counter()
    result = register_pair(source, target, config)
    return Attempt(result.accepted, result.best_candidate, 1e3 * (time.perf_counter() - start), result.probability)


def run_without_prescore(source: Scan, target: Scan, config: Config) -> Attempt:
    """register() with a shortlist that knows the hypotheses' rank only."""
    with patch.object(shortlist, "prescore", lambda T, *_: np.zeros(len(T))):
        return run_svc_ros(source, target, config)


def run_with_cliques(source: Scan, target: Scan, config: Config) -> Attempt:
    """register() with hypotheses from three correspondences each instead of SC2-PCR's sets."""
    cliques = generate_clique_hypotheses
    with patch.multiple(looks, generate_hypotheses=cliques, pool_hypotheses=cliques):
        return run_svc_ros(source, target, config)


def run_with_one_threshold(source: Scan, target: Scan, config: Config) -> Attempt:
    """register() whose last look has hypotheses of the configured compatibility threshold only."""
    with patch.object(looks, "pool_hypotheses", looks.generate_hypotheses):
        return run_svc_ros(source, target, config)


PATCHED: dict[str, Method] = {
    "svc, shortlist by rank": run_without_prescore,
    "svc, three-point cliques": run_with_cliques,
    "svc, one threshold, not on the ground": run_with_one_threshold,
}
METHODS = (*CHANGES, *PEERS)
COMPARED = ("svc", *PEERS)  # unless others are asked for
PREPARED = {**dict.fromkeys(CHANGES, "raw points; the set's preset"), **peers.PREPARED}
ACCEPTS = {
    **dict.fromkeys(CHANGES, "its verdict is accepted"), "sc2": "every pose that it finds", **peers.ACCEPTS,
}  # fmt: skip


def method_of(name: str, config: Config) -> tuple[Method, Config]:
    """What runs a method, and with which configuration."""
    if name in PEERS:
        return PEERS[name], config
    return PATCHED.get(name, run_svc_ros), with_values(config, CHANGES[name])


def why_not(name: str) -> str | None:
    """The reason why a method cannot run here, None if it can."""
    try:
        if name == "KISS-Matcher":
            import kiss_matcher  # noqa: F401
        elif name in PEERS:
            import open3d  # noqa: F401
    except ImportError as error:
        return f"{error}; see the extra `compare`"
    return None
