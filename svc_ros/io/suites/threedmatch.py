"""3DMatch and 3DLoMatch: fragments of RGB-D scenes, gt.log and gt.info of each scene.

Understood are the folders of the geometric registration benchmark (`SCENE/cloud_bin_0.ply` beside
`SCENE-evaluation/gt.log`) and of the repositories that evaluate on it (`fragments/SCENE/`, `data/test/SCENE/` beside
`gt_result/SCENE-evaluation/`, `benchmarks/3DLoMatch/SCENE/` ...).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from svc_ros.core.errors import InputError
from svc_ros.io.suites.redwood_log import PairOfFragments, read_info, read_log
from svc_ros.io.suites.suite import Criterion, Suite, SuitePair, success_of

_TRUTH_FOLDERS = ("", "gt_result", "benchmarks", "metadata/benchmarks", "configs/benchmarks")
_FRAGMENT_FOLDERS = ("", "fragments", "data/test", "data/indoor/test", "indoor/test", "test")
_SUFFIXES = (".ply", ".pcd", ".npy", ".npz", ".bin")
_OF_A_SCENE = "-evaluation"
# The paper's and the learned methods' criterion, over all pairs of gt.log; and the benchmark's own, over the pairs
# that are not neighbours in time.
CRITERIA = (
    Criterion.within(15.0, 0.3),
    Criterion("rmse 0.2 m, not consecutive", max_rmse_m=0.2, min_gap=2),
)


def read_3dmatch(root: Path) -> Suite:
    """3DMatch (overlap above 0.3): 1623 pairs in eight scenes, 1279 of them not consecutive. Raises InputError."""
    return _read(root, "3DMatch", evaluation_folders=True)


def read_3dlomatch(root: Path) -> Suite:
    """3DLoMatch (overlap 0.1-0.3): 1781 pairs in eight scenes, 1726 of them not consecutive. Raises InputError."""
    return _read(root, "3DLoMatch", evaluation_folders=False)


def _read(root: Path, benchmark: str, evaluation_folders: bool) -> Suite:
    scenes = _find_truths(root, benchmark, evaluation_folders)
    pairs = [pair for scene, folder in scenes.items() for pair in _pairs_of(root, scene, folder)]
    return Suite(
        root=root,
        name=benchmark,
        sensor="RGB-D fragments (50 fused frames, origin at the first camera)",
        preset="rgbd_indoor",
        min_range_m=0.0,
        max_range_m=10.0,
        sensor_origin=np.zeros(3),
        success=success_of(CRITERIA),
        pairs=list(pairs),
        criteria=CRITERIA,
    )


def _find_truths(root: Path, benchmark: str, evaluation_folders: bool) -> dict[str, Path]:
    """Folder with gt.log of every scene, by the scene's name."""
    looked_for = []
    for folder in _TRUTH_FOLDERS:
        patterns = [f"{benchmark}/*/gt.log"] + ([f"*{_OF_A_SCENE}/gt.log"] if evaluation_folders else [])
        for pattern in patterns:
            looked_for.append(str(Path(folder, pattern)))
            found = sorted(path.parent for path in (root / folder).glob(pattern))
            if found:
                return {path.name.removesuffix(_OF_A_SCENE): path for path in found}
    raise InputError(f"{root}: expected the ground truth of {benchmark} in one of {', '.join(looked_for)}, found none")


def _pairs_of(root: Path, scene: str, truth: Path) -> list[SuitePair]:
    poses, information = read_log(truth / "gt.log"), read_info(truth / "gt.info")
    fragments = _find_fragments(root, scene, poses)
    missing = next((key for key in poses if key not in information), None)
    if missing is not None:
        raise InputError(f"{truth / 'gt.info'}: expected every pair of gt.log, found no pair {missing[0]} {missing[1]}")
    return [
        SuitePair(
            fragments[j], fragments[i], T, name=f"{scene}/{i}_{j}", group=scene, indices=(i, j),
            information=information[i, j],
        )
        for (i, j), T in poses.items()
    ]  # fmt: skip


def _find_fragments(root: Path, scene: str, pairs: Iterable[PairOfFragments]) -> dict[int, str]:
    """Path of every fragment that a pair names, relative to the root."""
    folder = next((root / name / scene for name in _FRAGMENT_FOLDERS if (root / name / scene).is_dir()), None)
    if folder is None:
        places = ", ".join(str(Path(name, scene)) for name in _FRAGMENT_FOLDERS)
        raise InputError(f"{root}: expected the fragments of {scene} in one of {places}, found none")
    return {k: str(_fragment(folder, k).relative_to(root)) for k in sorted({k for pair in pairs for k in pair})}


def _fragment(folder: Path, number: int) -> Path:
    stem = folder / f"cloud_bin_{number}"
    for suffix in _SUFFIXES:
        path = stem.with_suffix(suffix)
        if path.is_file():
            return path
    if stem.with_suffix(".pth").is_file():
        raise InputError(f"{stem}.pth: expected one of {', '.join(_SUFFIXES)}; save the points of .pth files as .npy")
    raise InputError(f"{folder}: expected cloud_bin_{number} as one of {', '.join(_SUFFIXES)}, found none")
