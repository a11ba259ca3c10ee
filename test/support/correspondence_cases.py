"""Correspondences for tests of the hypotheses: random, degenerate, and real ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core.scan import Correspondences
from svc_ros.core.se3 import apply, make_pose

T_TRUE = make_pose(Rotation.from_euler("zyx", [40, -5, 3], degrees=True).as_matrix(), (4.0, -2.0, 0.5))
KITTI_PAIRS = [f"{k:03d}" for k in range(0, 101, 10)]


def random_case(num: int, inlier_ratio: float = 0.3, seed: int = 0) -> Correspondences:
    """`num` correspondences, a share of them right within a few centimetres, the others anything."""
    rng = np.random.default_rng(seed + num)
    x = rng.uniform(-20, 20, (num, 3)) * (1, 1, 0.2)
    y = apply(T_TRUE, x) + rng.normal(size=x.shape) * 0.02
    wrong = rng.random(num) >= inlier_ratio
    y[wrong] = rng.uniform(-20, 20, (int(wrong.sum()), 3)) * (1, 1, 0.2)
    return Correspondences.from_points(x, y)


def degenerate_cases() -> dict[str, Correspondences]:
    """Inputs on which ties and missing rank are the rule."""
    some = random_case(120, seed=5)
    x, y = some.source_points, some.target_points
    line = np.linspace(-10, 10, 90)[:, None] * (1.0, 2.0, -0.5)
    lattice = np.stack(np.meshgrid(range(5), range(5), range(4)), -1).reshape(-1, 3).astype(float)
    return {
        "duplicates": Correspondences.from_points(np.tile(x, (2, 1)), np.tile(y, (2, 1))),
        "one_target": Correspondences.from_points(x, np.repeat(y[:1], len(y), 0)),
        "one_point": Correspondences.from_points(np.ones((70, 3)), np.zeros((70, 3))),
        "collinear": Correspondences.from_points(line, apply(T_TRUE, line)),
        "lattice": Correspondences.from_points(lattice, lattice[::-1] * 1.0),
    }


def read_kitti_case(shared_data: Path, pair: str, step: int = 1) -> tuple[Correspondences, np.ndarray]:
    """Every `step`-th real FPFH correspondence of a pair 10 m apart, and the true pose."""
    start = shared_data / "correspondences" / "kitti_10m_fpfh" / pair
    source, target = (np.load(f"{start}_{side}_corr.npy")[::step] for side in ("src", "dst"))
    return Correspondences.from_points(source, target), np.loadtxt(f"{start}_T_dst_src.txt")
