"""What the paper published, and the data here that stand in its columns."""

from __future__ import annotations

import argparse
import atexit
import dataclasses
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from lib.common import SET_ORDER, Dataset, config_of
from lib.pairs import choose, describe
from svc_ros.core.config import Config
from svc_ros.core.registration import prepare
from svc_ros.core.scan import Correspondences, Features
from svc_ros.io.correspondence_files import read_correspondences, write_correspondences
from svc_ros.io.datasets import Pair, SuccessThresholds, read_dataset
from svc_ros.io.suites import read_suite
from svc_ros.io.transform_files import read_transform

GIVEN_SET = "kitti_10m_fpfh"
# Registration recall [%], rotation error [deg], translation error [cm]: Tab. 1 (3DMatch), 2 (GeoTransformer) and 3.
PUBLISHED = {
    "3DMatch FPFH": {"sc2": (83.26, 2.09, 6.66), "svc_paper": (88.66, 2.18, 6.87)},
    "3DMatch FCGF": {"sc2": (93.16, 2.09, 6.51), "svc_paper": (94.58, 2.07, 6.60)},
    "3DLoMatch FPFH": {"sc2": (38.46, 4.04, 10.32), "svc_paper": (45.76, 4.04, 10.62)},
    "3DLoMatch FCGF": {"sc2": (58.62, 3.79, 10.37), "svc_paper": (67.77, 3.93, 10.83)},
    "3DMatch GeoTransformer": {"sc2": (96.06, 1.63, 5.57), "svc_paper": (97.29, 1.67, 5.65)},
    "3DLoMatch GeoTransformer": {"sc2": (78.11, 3.01, 8.69), "svc_paper": (82.37, 3.09, 8.90)},
    "KITTI FPFH": {"sc2": (99.64, 0.34, 7.81), "svc_paper": (99.64, 0.34, 7.77)},
    "KITTI FCGF": {"sc2": (98.20, 0.33, 20.76), "svc_paper": (98.74, 0.33, 20.53)},
}
TABLE_OF = {"FPFH": "Tab. 1", "FCGF": "Tab. 1", "GeoTransformer": "Tab. 2"}
METHODS = ("sc2", "svc_paper", "svc")
_SUITES = {"3DMatch": "3dmatch", "3DLoMatch": "3dlomatch", "KITTI": "kitti"}


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a table: a data set, and the published column that it stands for."""

    title: str
    published: str
    dataset: Dataset

    @property
    def table(self) -> str:
        """Number of the paper's table."""
        benchmark, _, descriptor = self.published.partition(" ")
        return "Tab. 3" if benchmark == "KITTI" else TABLE_OF[descriptor]


def add_benchmarks(parser: argparse.ArgumentParser) -> None:
    """Options that name whole benchmarks; what is not named is stood in for by what the data folder has."""
    for benchmark, suite in _SUITES.items():
        parser.add_argument(f"--{suite}", type=Path, metavar="DIR",
                            help=f"{benchmark}, as `svc_ros evaluate --suite {suite}` reads it")  # fmt: skip
    for name in ("fcgf", "geotransformer"):
        parser.add_argument(f"--{name}", type=Path, metavar="DIR",
                            help=f"correspondences by {name}: DIR/SUITE/PAIR.npz, needs the benchmarks")  # fmt: skip


def read_columns(options: argparse.Namespace) -> list[Column]:
    """Whole benchmarks where they are named, else the sets of the data folder that come from the same recordings."""
    columns = []
    for benchmark, suite in _SUITES.items():
        folder = getattr(options, suite)
        if folder is None:
            columns += _stand_ins(benchmark, options.data)
            continue
        dataset = read_suite(suite, folder)
        columns.append(Column(f"{benchmark} FPFH", f"{benchmark} FPFH", dataset))
        for name, given in (("FCGF", options.fcgf), ("GeoTransformer", options.geotransformer)):
            if given is not None and f"{benchmark} {name}" in PUBLISHED:
                with_given = dataclasses.replace(dataset, correspondences=given / suite)
                columns.append(Column(f"{benchmark} {name}", f"{benchmark} {name}", with_given))
    return columns


def _stand_ins(benchmark: str, data: Path) -> list[Column]:
    found = []
    names = {"3DMatch": ("rgbd_redkitchen",), "KITTI": ("hdl64_kitti_a", "hdl64_kitti_05_loop")}.get(benchmark, ())
    for name in names:
        if (data / name / "dataset.json").is_file():
            found.append(Column(f"{benchmark} FPFH: {name}", f"{benchmark} FPFH", read_dataset(data / name)))
    given = data.parent / "correspondences" / GIVEN_SET
    if benchmark == "KITTI" and given.is_dir():
        found.append(Column(f"KITTI FPFH: {GIVEN_SET}", "KITTI FPFH", read_given_set(given)))
    return found


def read_given_set(folder: Path) -> Dataset:
    """Pairs `NNN_pts_src.ply`, `NNN_pts_dst.ply` with their correspondences, which are written as .npz to a folder of
    this process's own."""
    kept = Path(tempfile.mkdtemp(prefix="correspondences-"))
    atexit.register(shutil.rmtree, kept, ignore_errors=True)
    pairs = []
    for pose in sorted(folder.glob("*_T_dst_src.txt")):
        name = pose.name.partition("_")[0]
        points = (np.load(folder / f"{name}_{end}_corr.npy", allow_pickle=False) for end in ("src", "dst"))
        write_correspondences(kept / f"{name}.npz", *points)
        pairs.append(Pair(f"{name}_pts_src.ply", f"{name}_pts_dst.ply", read_transform(pose), name=name))
    return Dataset(
        folder, GIVEN_SET, "Velodyne HDL-64E, thinned to 0.3 m", "lidar_outdoor", 0.0, 80.0, np.zeros(3),
        SuccessThresholds(5.0, 0.6), pairs, correspondences=kept,
    )  # fmt: skip


def choose_pairs(dataset: Dataset, limit: int) -> list[Pair]:
    """At most `limit` pairs with a reference, evenly over their overlaps or, where these are not known, the list."""
    return choose(dataclasses.replace(dataset, negatives=[]), limit)


def read_inputs(dataset: Dataset, pair: Pair, config: Config) -> tuple[Features, Features, Correspondences | None]:
    """What `register` takes for a pair; scans that were described before are not described again."""
    if dataset.correspondences is None:
        return describe(dataset, pair.source, config), describe(dataset, pair.target, config), None
    given = read_correspondences(dataset.correspondences / f"{pair.file_name}.npz")
    source, target = (_bare(dataset, path, config) for path in (pair.source, pair.target))
    return source, target, given


@lru_cache(maxsize=40)
def _bare(dataset: Dataset, path: str, config: Config) -> Features:
    prepared = prepare(dataset.read_scan(path), config)
    return Features(prepared, np.zeros((len(prepared), 0), np.float32))


def config_for(dataset: Dataset, method: str) -> Config:
    """The data set's preset with that method."""
    return config_of(dataset, {"method": method})


def other_sets(data: Path, names: Sequence[str] = SET_ORDER) -> list[Dataset]:
    """Sets of the data folder that are there, by name."""
    return [read_dataset(data / name) for name in names if (data / name / "dataset.json").is_file()]
