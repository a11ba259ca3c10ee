"""Maps of runs: placed as they were, joined by loops that agree, never by guess; a broken end leaves what was there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from assertions import assert_same_bits, assert_same_pose
from mini_data import scan_room, sensor_pose
from simulated_scans import Place, scan_at

from svc_ros.core import se3
from svc_ros.core.config import Config, preset, with_values
from svc_ros.core.errors import InputError
from svc_ros.core.scan import Scan
from svc_ros.pipeline.map import Map
from svc_ros.pipeline.mapping.building import Run, Tracked, build_map

pytest.importorskip("gtsam", reason="gtsam not installed: pip install 'svc_ros[graph]'")

S = 1_000_000_000
CONFIG = with_values(preset("lidar_indoor"), {"loop_closure.min_gap_s": 5.0, "loop_closure.keyframe_distance_m": 0.5})
ALONG = (-3.0, -2.0, -1.0, 0.0, 1.0)
THERE = [sensor_pose(x, 0.0, 0.0) for x in ALONG]
BACK = [sensor_pose(x, 0.2, 180.0) for x in reversed(ALONG)]


def run(
    source: str, way: Sequence[np.ndarray], start_s: int = 0, config: Config = CONFIG, drift: np.ndarray | None = None
) -> Run:
    """Scans of the room, a second apart; odometry begins at the identity."""
    begin, step = se3.invert(way[0]), np.eye(4) if drift is None else drift
    tracked = [
        (Scan(scan_room(T, seed=k), (start_s + k) * S, "lidar"), np.linalg.matrix_power(step, k) @ begin @ T)
        for k, T in enumerate(way)
    ]
    return Run(source, tracked, config)


def other_building(source: str, seed: int) -> Run:
    """Scans of a simulated building, half a metre apart; odometry is what is true."""
    found = [scan_at(Place("indoor", "OS0-64", seed, 10.0 + 1.5 * k)) for k in range(3)]
    scans = [Scan(scan.points, k * S, "lidar") for k, (scan, _) in enumerate(found)]
    return Run(source, [(scan, se3.nearest_pose(T)) for scan, (_, T) in zip(scans, found, strict=True)], CONFIG)


def assert_placed(found: Map, way: Sequence[np.ndarray], deg: float = 0.5, m: float = 0.05) -> None:
    for T, truth in zip(found.poses, way, strict=True):
        assert_same_pose(T, se3.invert(way[0]) @ truth, deg, m)


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory) -> Map:
    return build_map([run("there", THERE)], tmp_path_factory.mktemp("maps") / "there")


def test_a_run_is_placed_by_its_odometry(there: Map) -> None:
    assert_placed(there, THERE, 1e-6, 1e-6)
    assert there.stamps_ns.tolist() == [k * S for k in range(len(THERE))]
    assert [(edge.source, edge.target) for edge in there.graph.edges] == [(1, 0), (2, 1), (3, 2), (4, 3)]
    assert np.linalg.eigvalsh(there.covariances[1:]).min() > 0.0
    assert there.covariances[4, 0, 0] > there.covariances[1, 0, 0]
    assert there.config == CONFIG


def test_loops_correct_what_odometry_drifted(tmp_path: Path) -> None:
    drift = se3.make_pose(np.eye(3), (0.03, 0.0, 0.0))
    found = build_map([run("both ways", [*THERE, *BACK], drift=drift)], tmp_path / "map")
    last = se3.invert(THERE[0]) @ BACK[-1]
    assert len(found.graph.edges) > 9
    assert abs(found.poses[-1, 0, 3] - last[0, 3]) < 0.1 < 9 * 0.03


def test_a_further_run_is_joined_by_loops(there: Map, tmp_path: Path) -> None:
    whole = build_map([run("back", BACK, 100)], tmp_path / "whole", there)
    assert_placed(whole, [*THERE, *BACK])
    assert whole.sessions.tolist() == [0] * 5 + [1] * 5
    assert [each.source for each in whole.runs] == ["there", "back"]
    between = [edge for edge in whole.graph.edges if whole.sessions[edge.source] != whole.sessions[edge.target]]
    assert len(between) >= 2
    for k in range(5):
        assert_same_bits(whole.keyframe(k).scan.points, there.keyframe(k).scan.points)
    again = build_map([run("there again", THERE, 200)], tmp_path / "whole", whole)  # in its own place
    assert_placed(again, [*THERE, *BACK, *THERE])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["whole"]


def test_several_runs_become_one_map(tmp_path: Path) -> None:
    whole = build_map([run("there", THERE), run("back", BACK, 100)], tmp_path / "map")
    assert_placed(whole, [*THERE, *BACK])


def test_a_run_of_another_place_is_not_joined(there: Map, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"elsewhere: expected at least two loops with there .* are not joined"):
        build_map([other_building("elsewhere", 3)], tmp_path / "map", there)
    assert list(tmp_path.iterdir()) == []


def test_one_place_alone_joins_nothing(there: Map, tmp_path: Path) -> None:
    """Two scans of one spot are one piece of evidence."""
    spot = [BACK[1], BACK[1] @ sensor_pose(0, 0, 60) @ se3.make_pose(np.eye(3), (0, 0, -1.2))]
    with pytest.raises(InputError, match="spot: expected at least two loops with there from different places"):
        build_map([run("spot", spot, 100)], tmp_path / "map", there)


def test_keyframes_of_another_kind_are_not_joined(there: Map, tmp_path: Path) -> None:
    other = with_values(CONFIG, {"preprocess.voxel_size_m": 0.2})
    with pytest.raises(InputError, match=r"expected preprocess\.voxel_size_m 0\.3"):
        build_map([run("back", BACK, 100, other)], tmp_path / "map", there)


@pytest.mark.parametrize(
    ("scans", "said"),
    [
        ([], "odd: expected scans of one frame whose odometry is known, found none"),
        ([(Scan(scan_room(THERE[0]), S, "lidar"), None)], "whose odometry is known, found none"),
        ([(Scan(scan_room(THERE[k]), k * S, f"lidar{k}"), THERE[k]) for k in (0, 1)], "found those of lidar0, lidar1"),
        ([(Scan(scan_room(THERE[0]), k * S, "lidar"), THERE[k]) for k in (3, 0)], "odd: expected rising stamps"),
    ],
)
def test_a_run_that_is_none_is_named(tmp_path: Path, scans: list[tuple[Scan, np.ndarray]], said: str) -> None:
    with pytest.raises(InputError, match=said):
        build_map([Run("odd", scans, CONFIG)], tmp_path / "map")
    assert list(tmp_path.iterdir()) == []


def test_a_map_that_nothing_extends_is_not_moved(there: Map, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected at least one run, found none"):
        build_map([], tmp_path / "map", there)
    assert there.folder.is_dir()


def test_a_map_that_cannot_be_put_is_kept(tmp_path: Path) -> None:
    """The place is taken while the map is built."""
    out = tmp_path / "map"

    def scans() -> Iterator[Tracked]:
        yield from run("there", THERE[:2]).scans
        out.write_text("dear")

    with pytest.raises(InputError, match=r"found a file in its place; the new map is whole: ") as refused:
        build_map([Run("there", scans(), CONFIG)], out)
    assert len(Map.read(str(refused.value).rsplit(": ", 1)[1])) == 2
    assert out.read_text() == "dear"


def test_a_map_stays_where_the_next_one_fails(tmp_path: Path) -> None:
    build_map([run("there", THERE[:2])], tmp_path / "map")
    with pytest.raises(InputError):
        build_map([Run("odd", [], CONFIG)], tmp_path / "map")
    assert len(Map.read(tmp_path / "map")) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["map"]
