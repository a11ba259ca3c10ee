"""Labelled poses of simulated scans by what real sensors do, in groups that can each be left out of a fit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from lib.evidence import Judged, Row, measure_all
from lib.simulated_pairs import (
    CAMERA,
    GROUPS,
    MIXED,
    NARROW,
    PRESETS,
    SMEAR,
    TRIPOD,
    Pair,
    Place,
    overlapping_pair,
    places,
    scan_elsewhere,
)
from svc_ros.core import se3
from svc_ros.core.registration import extract_features, register
from svc_ros.io.datasets import Candidate

__all__ = [
    "CAMERA", "MIXED", "NARROW", "PRESETS", "SMEAR", "TRIPOD", "Place", "gather_simulated", "judge", "places",
]  # fmt: skip


def gather_simulated(job: tuple[Place, int]) -> list[Row]:
    """The rows of all poses at one place; `job` ends with the place's number."""
    place, number = job
    measured = [measure_all(judged, number + k) for k, judged in enumerate(judge(place))]
    return [row for rows in measured for row in rows]


def judge(place: Place) -> Iterator[Judged]:
    """The true pose and wrong ones between two scans of one world; what `register` finds between two worlds."""
    pair = overlapping_pair(place)
    T, name = pair.T_target_source, f"{place.scene} by {place.sensor}, seed {place.seed}"
    candidates = [Candidate(T, "correct", "truth"), *_wrong_poses(place, pair)]
    yield Judged(place.dataset, name, (pair.source, pair.target), place.config, candidates, T)
    strange = scan_elsewhere(place)
    source, target = (extract_features(scan, place.config) for scan in (strange, pair.target))
    found = register(source, target, place.config).best_candidate
    if found is not None:
        scans, wrong = (strange, pair.target), Candidate(found, "wrong", "register")
        yield Judged(place.dataset, f"{name}: another world", scans, place.config, [wrong], found)


def _wrong_poses(place: Place, pair: Pair) -> list[Candidate]:
    """Slips along both main directions, a short and a long one each; turns about the vertical where the source is."""
    rng, T = place.rng(14), pair.T_target_source
    least, most = GROUPS[place.dataset].slip_m
    middle = 0.5 * (least + most)
    poses = []
    for direction in se3.rotate(se3.invert(pair.T_world_target), pair.directions):
        for length in (rng.uniform(least, middle), rng.uniform(middle, most)):
            shift = rng.choice([-1.0, 1.0]) * length * direction
            poses.append(Candidate(se3.make_pose(T[:3, :3], T[:3, 3] + shift), "wrong", "slip"))
    up = pair.T_world_source[:3, :3].T @ [0.0, 0.0, 1.0]
    for angle in GROUPS[place.dataset].wrong_turns_deg:
        turn = Rotation.from_rotvec(np.radians(rng.choice([-1.0, 1.0]) * angle) * up).as_matrix()
        poses.append(Candidate(T @ se3.make_pose(turn, np.zeros(3)), "wrong", "turn"))
    return poses
