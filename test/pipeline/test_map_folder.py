"""Maps on disk: read back bit for bit, found by place and by look, bounded; whatever is broken is named."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from assertions import assert_given_back, assert_same_bits
from map_cases import CONFIG, STANDS, S, room_graph, write_room_map

from svc_ros.core.config import with_values
from svc_ros.core.errors import InputError
from svc_ros.core.registration import verify
from svc_ros.core.scan import PreparedScan
from svc_ros.io.maps.layout import ARRAYS
from svc_ros.pipeline import map as map_module
from svc_ros.pipeline.map import Map
from svc_ros.pipeline.place import look_at_place


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[PreparedScan]]:
    folder = tmp_path_factory.mktemp("maps") / "room"
    return folder, write_room_map(folder)


@pytest.fixture
def copied(written: tuple[Path, list[PreparedScan]], tmp_path: Path) -> Path:
    return Path(shutil.copytree(written[0], tmp_path / "copy"))


def test_what_was_written_is_read_back_bit_for_bit(written: tuple[Path, list[PreparedScan]]) -> None:
    found, graph = Map.read(written[0]), room_graph()
    assert len(found) == len(STANDS)
    assert found.config == CONFIG
    assert found.sessions.tolist() == [0, 0, 0, 0, 1]
    assert found.stamps_ns.tolist() == [k * S for k in range(1, 6)]
    assert [run.source for run in found.runs] == ["first_bag", "second_bag"]
    assert_same_bits(found.poses, graph.poses)
    assert_same_bits(found.covariances, graph.covariances)
    for edge, expected in zip(found.graph.edges, graph.edges, strict=True):
        assert (edge.source, edge.target) == (expected.source, expected.target)
        assert_same_bits(edge.T_target_source, expected.T_target_source)
        assert_same_bits(edge.covariance, expected.covariance)


def test_scans_are_read_back_bit_for_bit(written: tuple[Path, list[PreparedScan]]) -> None:
    found = Map.read(written[0])
    for k, expected in enumerate(written[1]):
        keyframe = found.keyframe(k)
        scan, image, wanted = keyframe.scan, keyframe.scan.range_image, expected.range_image
        assert image is not None
        assert wanted is not None
        for name in ("points", "normals", "free_directions", "sensor_origin"):
            assert_same_bits(getattr(scan, name), getattr(expected, name))
            assert getattr(scan, name).flags.aligned  # else kernels are compiled once more
        for name in ("voxel_size_m", "stamp_ns", "frame_id", "beam_spacing_deg"):
            assert getattr(scan, name) == getattr(expected, name)
        for name in ("near", "far"):
            assert_same_bits(getattr(image, name), getattr(wanted, name))
        for name in ("size_deg", "dense_ratio", "seen_ratio"):
            assert getattr(image, name) == getattr(wanted, name)
        for table, wanted_table in zip(image.tables, wanted.tables, strict=True):
            assert_same_bits(table, wanted_table)
        assert_same_bits(keyframe.T_odom_scan, STANDS[k])
        assert_same_bits(keyframe.look.spectrum, look_at_place(expected).spectrum)
    assert len(written[1][1].free_directions) == 2


def test_a_pose_is_judged_as_against_the_scan_that_was_written(written: tuple[Path, list[PreparedScan]]) -> None:
    found, scans = Map.read(written[0]), written[1]
    T = np.linalg.inv(STANDS[0]) @ STANDS[1]
    direct, by_map = (verify(scans[1], target, T, CONFIG) for target in (scans[0], found.keyframe(0).scan))
    assert direct.accepted
    assert by_map.probability == direct.probability
    assert_same_bits(by_map.T_target_source, direct.T_target_source)


def test_near_keyframes_come_nearest_first(written: tuple[Path, list[PreparedScan]]) -> None:
    found = Map.read(written[0])
    assert found.near(STANDS[1], 0.0, 5) == [1]
    assert found.near(STANDS[2], 2.6, 5) == [2, 1, 3]
    assert found.near(STANDS[2], 2.6, 2) == [2, 1]
    assert found.near(np.eye(4) + np.diag([0, 0, 0], 1), 0.1, 5) == []


def test_similar_keyframes_come_most_alike_first(written: tuple[Path, list[PreparedScan]]) -> None:
    found = Map.read(written[0])
    for k, scan in enumerate(written[1]):
        (first, likeness), *others = found.similar(look_at_place(scan), 3)
        assert first == k
        assert likeness == pytest.approx(1.0, abs=1e-5)
        assert len(others) == 2
        assert all(each < likeness for _, each in others)


def test_keyframes_in_memory_are_bounded(
    written: tuple[Path, list[PreparedScan]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_module, "_MAX_KEPT", 2)
    found = Map.read(written[0])
    first, second = found.keyframe(0), found.keyframe(1)
    assert found.keyframe(0) is first
    found.keyframe(2)  # the one that was asked for longest ago leaves
    assert found.keyframe(0) is first
    assert found.keyframe(1) is not second


def test_a_map_gives_its_files_back(copied: Path) -> None:
    with Map.read(copied) as found, pytest.raises(AssertionError, match=r"points\.npy"):
        assert_given_back(copied)
    assert_given_back(copied)
    assert len(found.near(STANDS[1], 2.6, 5)) == 3  # what is small is in memory


def test_keyframes_that_are_held_take_no_file_handles(
    written: tuple[Path, list[PreparedScan]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_module, "_MAX_KEPT", 1)
    handles = Path("/proc/self/fd")
    if not handles.is_dir():
        pytest.skip("no /proc to count them in")
    found = Map.read(written[0])
    before = len(list(handles.iterdir()))
    held = [found.keyframe(k % len(STANDS)) for k in range(20)]
    assert len({id(keyframe) for keyframe in held}) == 20
    assert len(list(handles.iterdir())) <= before


def test_several_threads_get_the_same_keyframes(
    written: tuple[Path, list[PreparedScan]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_module, "_MAX_KEPT", 3)
    found, scans = Map.read(written[0]), written[1]
    order = np.random.default_rng(0).integers(len(scans), size=200).tolist()
    with ThreadPoolExecutor(4) as pool:
        for k, points in zip(order, pool.map(lambda k: found.keyframe(k).scan.points, order), strict=True):
            assert_same_bits(points, scans[k].points)
        same = list(pool.map(lambda _: found.keyframe(0), range(20)))
    assert all(each is same[0] for each in same)


def test_a_map_that_is_replaced_stays_what_it_was_for_its_readers(copied: Path, tmp_path: Path) -> None:
    found, points = Map.read(copied), Map.read(copied).keyframe(3).scan.points
    copied.rename(tmp_path / "old")
    write_room_map(copied, with_values(CONFIG, {"preprocess.voxel_size_m": 0.5}))
    shutil.rmtree(tmp_path / "old")
    assert_same_bits(found.keyframe(3).scan.points, points)
    assert len(Map.read(copied).keyframe(3).scan) < len(points)


def test_scans_must_be_prepared_as_the_maps_are(written: tuple[Path, list[PreparedScan]]) -> None:
    found = Map.read(written[0])
    found.check_fits(with_values(CONFIG, {"decision.min_probability": 0.9}))
    with pytest.raises(InputError, match=r"room: expected preprocess.voxel_size_m 0.3, .* found 0.2"):
        found.check_fits(with_values(CONFIG, {"preprocess.voxel_size_m": 0.2}))


def edited(**changes: object) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "map.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))

    return change


def cut(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:-7])


def zeroed(name: str, at: int) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_bytes(
        (data := (folder / name).read_bytes())[:at] + b"\x00" + data[at + 1 :]
    )


def without(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def text(name: str, words: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_text(words)


def array(name: str, change: Callable[[np.ndarray], np.ndarray | None]) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        values = np.load(folder / name)
        changed = change(values)
        np.save(folder / name, values if changed is None else changed)

    return write


def setting(place: object, value: object) -> Callable[[np.ndarray], None]:
    return lambda values: values.__setitem__(place, value)


def setting_field(field: str, value: int) -> Callable[[np.ndarray], None]:
    return lambda values: values[field].__setitem__(1, value)


@pytest.mark.parametrize(
    ("breaking", "said"),
    [
        (shutil.rmtree, "copy: expected the folder of a map, found none"),
        (without("map.json"), "map.json: the description of a map cannot be read: No such file"),
        (text("map.json", "{"), "map.json: expected JSON, found"),
        (text("map.json", "[]"), "map.json: expected the description of a map, found another"),
        (edited(format="other"), "map.json: expected the description of a map, found another"),
        (edited(version=2), "map.json: expected version 1 of the format, found 2"),
        (edited(rows={}), "map.json: expected rows, sessions and preprocess, found .*points"),
        (edited(sessions=[{}]), "map.json: expected rows, sessions and preprocess, found .*source"),
        (edited(sessions=[{"source": "", "frame_id": ""}]), "scans.npy: expected numbers of sessions from 0 to 0"),
        (without("config.yaml"), "config.yaml: configuration cannot be read"),
        (text("config.yaml", "preprocess: {voxel_size_m: 0.1}"), "config.yaml: expected preprocess.voxel_size_m 0.3"),
        (without("points.npy"), "points.npy: cannot be read: No such file"),
        (text("points.npy", ""), "points.npy: expected a .npy file, found another"),
        (text("normals.npy", "no array at all"), "normals.npy: expected a .npy file, found another"),
        *((zeroed("poses.npy", at), "poses.npy: expected a .npy file, found another") for at in (3, 20, 40)),
        (zeroed("poses.npy", 6), "poses.npy: .* expected version 1 or 2 of NumPy.s format, found 0.0"),
        *((cut(f"{name}.npy"), rf"{name}.npy: expected \d+ bytes, found \d+") for name in ARRAYS),
        (array("points.npy", lambda a: a.astype(np.float32)), "points.npy: expected float64 .* found float32"),
        (array("poses.npy", lambda a: a[:3]), r"poses.npy: expected float64 of shape \(5, 4, 4\), found .*\(3, 4, 4\)"),
        (array("range_far.npy", lambda a: a[:-1]), "range_far.npy: expected float32 of shape"),
        (array("looks.npy", lambda a: a[:, :10]), r"looks.npy: expected complex64 of shape \(5, 20, 61\)"),
        (array("poses.npy", setting((2, 0, 0), 3.0)), "poses.npy: expected poses, found something else in row 2"),
        (array("poses.npy", setting((1, 0, 3), np.nan)), "poses.npy: expected poses, found something else in row 1"),
        (array("covariances.npy", setting((4, 0, 0), np.inf)), "covariances.npy: expected covariances, .* in row 4"),
        (array("scans.npy", setting_field("first_point", 10**9)), "scans.npy: expected numbers of rows of points.npy"),
        (array("scans.npy", setting_field("num_cells", -1)), "scans.npy: expected numbers of rows of range_near.npy"),
        (array("edges.npy", setting_field("target", 5)), "edges.npy: expected numbers of keyframes from 0 to 4"),
        (array("edges.npy", lambda a: np.zeros_like(a)), "edges.npy: .*positive definite covariance"),
    ],
)
def test_what_is_broken_is_named(copied: Path, breaking: Callable[[Path], object], said: str) -> None:
    breaking(copied)
    with pytest.raises(InputError, match=said):
        Map.read(copied)


def test_a_file_that_was_cut_since_is_named(copied: Path) -> None:
    found = Map.read(copied)
    cut("points.npy")(copied)
    found.keyframe(0)
    with pytest.raises(InputError, match=r"points.npy: expected rows up to \d+, found an end before them"):
        found.keyframe(4)


@pytest.mark.parametrize(
    ("breaking", "said"),
    [
        (array("points.npy", setting(slice(None), np.nan)), "copy: keyframe 1: PreparedScan.points: expected finite"),
        (array("scans.npy", setting_field("num_rows", 3)), r"copy: keyframe 1: range image: expected \d+ cells"),
    ],
)
def test_a_broken_keyframe_is_named_when_it_is_asked_for(
    copied: Path, breaking: Callable[[Path], object], said: str
) -> None:
    breaking(copied)
    with pytest.raises(InputError, match=said):
        Map.read(copied).keyframe(1)
