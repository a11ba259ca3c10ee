"""Descriptors beside FPFH: which there are, what they may give, that they are kept, and what their matches do."""

from __future__ import annotations

import dataclasses
import itertools
import re
import sys
import threading
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
import reference
from assertions import assert_same_bits, assert_same_pose
from descriptor_packages import write_package
from mini_data import POSES, scan_room
from scan_cases import T_ROOM, prepared, random_scan, room_config, room_scans

from svc_ros.core import se3
from svc_ros.core.config import PRESETS, Config, preset, with_values
from svc_ros.core.errors import ConfigError, DescriptorError, InputError, MissingDependencyError
from svc_ros.core.matches import descriptors as stage
from svc_ros.core.matches import features
from svc_ros.core.matches.descriptor_names import BUILT_IN, check_names, split_names
from svc_ros.core.matches.descriptors import load_descriptors, more_matches
from svc_ros.core.registration import prepare, register
from svc_ros.core.result import Reason
from svc_ros.core.scan import Correspondences, Description, Features, PreparedScan, Scan
from svc_ros.io.config_yaml import config_to_yaml, read_config
from svc_ros.pipeline.decide import register_pair
from svc_ros.pipeline.keyframes import Keyframe

_numbers = itertools.count()


@pytest.fixture
def offer(tmp_path, monkeypatch) -> Callable[..., str]:
    """Install a package of one descriptor for the rest of the test: offer(function or code, name) gives its name."""
    stage._load.cache_clear()
    monkeypatch.syspath_prepend(str(tmp_path))

    def install(function: Callable[..., object] | str, name: str = "own") -> str:
        module = f"package_of_{name}_{next(_numbers)}"
        if isinstance(function, str):
            write_package(tmp_path, module, function, **{name: "describe"})
            return name
        write_package(tmp_path, module, "", **{name: "describe"})
        monkeypatch.setitem(sys.modules, module, SimpleNamespace(describe=function))
        return name

    yield install
    stage._load.cache_clear()


def with_descriptors(names: str, config: Config | None = None, **values: object) -> Config:
    return with_values(config or Config(), {"matching.more_descriptors": names, **values})


def unit_rows(num: int, seed: int, columns: int = 12) -> np.ndarray:
    rows = np.random.default_rng(seed).normal(size=(num, columns))
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def of_rows(rows_of: dict[str, np.ndarray]) -> Callable[[PreparedScan, Config], Description]:
    """Describes the first points of a scan by the rows that are meant for its frame."""
    return lambda scan, config: Description(scan.points[: len(rows_of[scan.frame_id])], rows_of[scan.frame_id])


def two_scans() -> tuple[PreparedScan, PreparedScan]:
    scans = random_scan(200, seed=1), random_scan(260, seed=2)
    return tuple(dataclasses.replace(s, frame_id=f, memo={}) for s, f in zip(scans, "ab", strict=True))


# --- names ---------------------------------------------------------------------------------------------------------


def test_no_preset_names_any():
    assert all(load_descriptors(config) == {} for config in PRESETS.values())
    assert more_matches(*two_scans(), Config()) == []


@pytest.mark.parametrize(("text", "names"), [("", ()), ("  ", ()), ("a", ("a",)), ("a,b-2 , c.d", ("a", "b-2", "c.d"))])
def test_names_stand_between_commas(text, names):
    assert split_names(text) == names


@pytest.mark.parametrize("text", [",", "a,", "a,,b", "a, a"])
def test_empty_and_repeated_names_are_refused_with_the_key(text):
    with pytest.raises(ConfigError, match=r"^matching\.more_descriptors: expected different names"):
        with_descriptors(text)


def test_an_unknown_name_is_told_with_those_installed_and_how_to_offer_one(offer):
    offer(of_rows({}), "spherical")
    with pytest.raises(ConfigError) as caught:
        check_names("sphericle")
    for word in ("matching.more_descriptors", "did you mean 'spherical'?", "fpfh_wide", "svc_ros.descriptors"):
        assert word in str(caught.value)
    with pytest.raises(ConfigError, match="unknown name 'none'"):  # before any scan is described
        register(*room_scans(), with_descriptors("none", room_config()))


def test_a_name_that_two_offer_is_refused(offer):
    offer(of_rows({}), "twice")
    offer(of_rows({}), "twice")
    with pytest.raises(ConfigError, match=r"'twice', found it in package package.of.twice.* and package package.of"):
        check_names("twice")
    offer(of_rows({}), "fpfh_wide")
    with pytest.raises(ConfigError, match="and svc_ros itself"):
        check_names("fpfh_wide")


def test_a_configuration_that_names_one_can_be_read_where_it_is_not_installed(tmp_path):
    """Reports of stored runs are made elsewhere, too."""
    config = with_descriptors("not_here, fpfh_wide")
    (tmp_path / "config.yaml").write_text(config_to_yaml(config, "lidar_outdoor"))
    assert read_config(tmp_path / "config.yaml", Config()) == config


def test_every_built_in_one_can_be_loaded():
    names = ", ".join(BUILT_IN)
    assert list(load_descriptors(with_descriptors(names))) == list(BUILT_IN) == ["fpfh_wide"]


# --- what is wrong with a package ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "kind", "words"),
    [
        ("import not_installed_anywhere", MissingDependencyError, "not_installed_anywhere"),
        ("1 / 0", ConfigError, "ZeroDivisionError: division by zero"),
        ("", ConfigError, "AttributeError"),
        ("describe = 5", ConfigError, "expected a function of a scan and a configuration, found 5"),
    ],
)
def test_what_cannot_be_loaded_is_told_with_its_name_and_package(offer, code, kind, words):
    name = offer(code)
    for call in (lambda: load_descriptors(with_descriptors(name)),
                 lambda: register_pair(*room_scans(), with_descriptors(name, room_config()))):  # fmt: skip
        with pytest.raises(kind) as caught:
            call()
        assert str(caught.value).startswith("descriptor 'own' of package package_of_own_")
        assert words in str(caught.value)


def failing(scan: PreparedScan, config: Config) -> Description:
    raise RuntimeError("out of memory")


WRONG: dict[str, tuple[Callable[..., object], str]] = {
    "raises": (failing, "RuntimeError: out of memory"),
    "takes nothing": (lambda: None, "TypeError: .*arguments"),
    "none": (lambda scan, config: None, "expected a Description, found NoneType"),
    "tuple": (lambda scan, config: (scan.points, scan.points), "expected a Description, found tuple"),
    "flat": (lambda scan, config: Description(scan.points[:, 0], scan.points), r"keypoints: expected shape N x 3"),
    "rows": (lambda scan, config: Description(scan.points[1:], scan.points), r"descriptors: expected shape .* x N"),
    "one column": (lambda scan, config: Description(scan.points, scan.points[:, :1]), r"2 numbers or more, .*, 1\)"),
    "no column": (lambda scan, config: Description(scan.points, scan.points[:, :0]), r"2 numbers or more, .*, 0\)"),
    "nan": (lambda scan, config: Description(scan.points, scan.points * np.nan), "expected finite numbers"),
    "text": (lambda scan, config: Description(scan.points, [["a"] * 4] * len(scan)), "expected an array of numbers"),
    "lengths": (lambda scan, config: Description(scan.points, np.ones((len(scan), len(scan)))), "one length, found 2"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_description_is_told_with_the_name(offer, case):
    function, words = WRONG[case]
    with pytest.raises(DescriptorError, match=words) as caught:
        more_matches(*two_scans(), with_descriptors(offer(function)))
    assert re.match(r"descriptor 'own' of package package.of.own.\d+: ", str(caught.value))


def test_a_pair_whose_descriptor_fails_is_a_rejection_that_says_so_and_is_logged(offer, caplog):
    config = with_descriptors(offer(failing), room_config(), **{"matching.first_points": 0})
    with pytest.raises(DescriptorError, match="out of memory"):
        register(*room_scans(), config)
    result = register_pair(*room_scans(), config)
    assert result.reason is Reason.INTERNAL_ERROR
    assert "descriptor 'own'" in result.detail
    assert "RuntimeError: out of memory" in caplog.text
    assert "in failing" in caplog.text  # the traceback leads into the package


# --- descriptions and their matches --------------------------------------------------------------------------------


def test_matches_are_those_of_the_full_distance_matrix(offer):
    rows = {"a": unit_rows(150, 1), "b": unit_rows(180, 2)}
    source, target = two_scans()
    (found,) = more_matches(source, target, with_descriptors(offer(of_rows(rows))))
    expected = np.array(reference.mutual_matches(rows["a"].astype(np.float32), rows["b"].astype(np.float32)))
    assert_same_bits(found.source_points, source.points[expected[:, 0]])
    assert_same_bits(found.target_points, target.points[expected[:, 1]])
    few = with_descriptors("own", **{"matching.max_correspondences": 7})
    assert len(more_matches(source, target, few)[0]) == 7
    assert len(more_matches(source, target, with_descriptors("own", **{"matching.strategy": "one_way"}))[0]) == 150


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e9])
def test_only_directions_are_compared_whatever_the_scale(offer, scale):
    rows = unit_rows(100, 3)
    rows[::2] = 0
    lengths = np.random.default_rng(0).uniform(0.5, 2, (100, 1)) * scale
    source, target = two_scans()
    (found,) = more_matches(source, target, with_descriptors(offer(of_rows({"a": rows, "b": rows * lengths}))))
    assert_same_bits(found.source_points, source.points[1:100:2])  # rows of zeros match nothing
    assert_same_bits(found.target_points, target.points[1:100:2])


@pytest.mark.parametrize("empty", ["a", "b", "ab"])
def test_a_scan_in_which_nothing_is_described_matches_nothing(offer, empty):
    rows = {frame: unit_rows(0 if frame in empty else 50, 1) for frame in "ab"}
    (found,) = more_matches(*two_scans(), with_descriptors(offer(of_rows(rows))))
    assert len(found) == 0


def test_each_has_its_own_matches_in_the_order_of_the_names(offer):
    rows = unit_rows(40, 5)
    first = offer(of_rows({"a": rows, "b": rows}), "first")
    second = offer(of_rows({"a": rows[:9], "b": rows}), "second")
    scans = two_scans()
    assert [len(found) for found in more_matches(*scans, with_descriptors(f"{first}, {second}"))] == [40, 9]
    assert [len(found) for found in more_matches(*scans, with_descriptors(f"{second},{first}"))] == [9, 40]


def counting(seen: list[tuple[PreparedScan, str]]) -> Callable[[PreparedScan, Config], Description]:
    def describe(scan: PreparedScan, config: Config) -> Description:
        seen.append((scan, threading.current_thread().name))
        return Description(scan.points, unit_rows(len(scan), 1))

    return describe


def test_a_scan_is_described_once_in_the_callers_thread_source_first(offer):
    seen: list[tuple[PreparedScan, str]] = []
    config = with_descriptors(offer(counting(seen)))
    source, target = two_scans()
    first = more_matches(source, target, config)
    again = more_matches(source, target, config)
    more_matches(target, source, config)
    here = threading.current_thread().name
    assert seen == [(source, here), (target, here)]
    assert_same_bits(again[0].source_points, first[0].source_points)
    more_matches(source, target, with_values(config, {"features.radius_voxels": 4.0}))  # may depend on any value
    assert [scan for scan, _ in seen[2:]] == [source, target]


def test_keyframes_keep_descriptions_and_give_back_the_rest(offer):
    seen: list[tuple[PreparedScan, str]] = []
    config = with_descriptors(offer(counting(seen)), room_config())
    keyframes = [Keyframe(prepare(scan, config), None, config) for scan in room_scans()]
    before = more_matches(keyframes[0].scan, keyframes[1].scan, config)
    register(keyframes[0].features, keyframes[1].features, config)
    for keyframe in keyframes:
        keyframe.forget_searches()
        ((_, kept),) = keyframe.scan.memo.values()
        assert kept.memo == {}
    after = more_matches(keyframes[0].scan, keyframes[1].scan, config)
    assert len(seen) == 2
    assert_same_bits(after[0].source_points, before[0].source_points)


def test_what_the_package_does_with_its_arrays_later_changes_nothing(offer):
    points, rows = np.random.default_rng(0).normal(size=(50, 3)), unit_rows(50, 1).astype(np.float32)
    config = with_descriptors(offer(lambda scan, config: Description(points, rows)))
    source, target = two_scans()
    (before,) = more_matches(source, target, config)
    points[:], rows[:] = 0.0, 1.0
    (after,) = more_matches(source, target, config)
    assert_same_bits(after.source_points, before.source_points)
    assert len(after) == 50


def test_wide_fpfh_is_fpfh_of_a_wider_radius():
    scan, config = prepare(room_scans()[0], room_config()), room_config()
    wide = with_values(config, {"features.radius_voxels": 2.4 * config.features.radius_voxels,
                                "features.max_neighbours": round(2.4 * config.features.max_neighbours)})  # fmt: skip
    found = stage.describe_by_wide_fpfh(scan, config)
    assert_same_bits(found.descriptors, features.compute_features(scan, wide).descriptors)
    assert_same_bits(found.keypoints, scan.points)
    largest = with_values(config, {"features.radius_voxels": 50.0, "features.max_neighbours": 10_000})
    few = prepared(scan.points[:200], scan.normals[:200])
    assert len(stage.describe_by_wide_fpfh(few, largest)) == 200  # stays within what may be configured


# --- in the registration -------------------------------------------------------------------------------------------


def undescribed(scan: Scan, config: Config) -> Features:
    """A scan in which FPFH matches nothing."""
    prepared_scan = prepare(scan, config)
    return Features(prepared_scan, np.zeros((len(prepared_scan), 33), np.float32))


def misdescribed(scan: Scan, config: Config) -> Features:
    """A scan in which FPFH matches at random."""
    prepared_scan = prepare(scan, config)
    return Features(prepared_scan, unit_rows(len(prepared_scan), 7 + int(scan.frame_id), 33))


def landmarks(num: int, seed: int = 0) -> Callable[[PreparedScan, Config], Description]:
    """Places of the room, described by what they are; every scan sees them, with a few centimetres of noise."""
    places = np.random.default_rng(seed).uniform((-6, -4, 0), (7, 5, 3), (num, 3))
    T_scan_world = {frame: se3.invert(POSES[int(frame)]) for frame in "012"}

    def describe(scan: PreparedScan, config: Config) -> Description:
        noise = np.random.default_rng(int(scan.frame_id)).normal(0, 0.02, (num, 3))
        return Description(se3.apply(T_scan_world[scan.frame_id], places) + noise, unit_rows(num, seed))

    return describe


def named_room_scans() -> tuple[Scan, Scan]:
    return tuple(Scan(scan_room(POSES[k], seed=k), frame_id=str(k)) for k in (1, 0))


def test_its_matches_alone_are_enough(offer):
    config = with_descriptors(offer(landmarks(60)), room_config(hypotheses__levelled_poses=0))
    source, target = (undescribed(scan, config) for scan in named_room_scans())
    without = register(source, target, with_descriptors("", config))
    assert without.reason is Reason.TOO_FEW_CORRESPONDENCES
    result = register(source, target, config)
    assert result.accepted, result.detail
    assert_same_pose(result.T_target_source, T_ROOM, 0.5, 0.05)
    assert (result.counts["correspondences"], result.counts["more_correspondences"]) == (60, 60)
    assert result.time_ms["more_matches"] > 0


def test_too_few_of_its_matches_do_not_count_and_are_told(offer):
    config = with_descriptors(offer(landmarks(9)), room_config(hypotheses__levelled_poses=0))
    source, target = (undescribed(scan, config) for scan in named_room_scans())
    result = register(source, target, config)
    assert result.reason is Reason.TOO_FEW_CORRESPONDENCES
    assert result.detail.startswith("9 correspondences")


@pytest.mark.parametrize("method", ["svc", "svc_paper", "sc2"])
def test_few_right_ones_are_found_among_many_wrong_ones(offer, method):
    config = with_descriptors(offer(landmarks(40)), room_config(method=method, matching__first_points=0))
    pair = [misdescribed(scan, config) for scan in named_room_scans()]
    alone = register(*pair, with_descriptors("", config))
    assert alone.counts["correspondences"] == 800
    assert method == "svc" or se3.pose_error(alone.best_candidate, T_ROOM)[0] > 5.0  # svc looks at many chance poses
    result = register(*pair, config)
    assert result.counts["correspondences"] == 840
    assert_same_pose(result.best_candidate, T_ROOM, 1.0, 0.1)


def test_it_is_not_asked_where_the_first_look_is_accepted(offer):
    seen: list[tuple[PreparedScan, str]] = []
    name, scans = offer(counting(seen)), named_room_scans()
    easy = with_descriptors(name, room_config(), **{"matching.first_points": 2000})
    result = register(*scans, easy)
    assert result.accepted
    assert seen == []
    assert "more_correspondences" not in result.counts
    assert_same_bits(result.T_target_source, register(*scans, with_descriptors("", easy)).T_target_source)


def test_it_is_asked_where_the_first_look_fails(offer):
    seen: list[tuple[PreparedScan, str]] = []
    config = with_descriptors(offer(counting(seen)), preset("lidar_indoor"), **{"matching.first_points": 200})
    rng = np.random.default_rng(3)
    register(*(Scan(rng.uniform(-9, 9, (6000, 3))) for _ in range(2)), config)
    assert len(seen) == 2


def test_given_correspondences_take_the_place_of_all_matching(offer):
    config = with_descriptors(offer(failing), room_config())
    points = np.random.default_rng(0).uniform(-5, 5, (80, 3))
    given = Correspondences.from_points(points, se3.apply(T_ROOM, points))
    result = register(*room_scans(), config, given)
    assert_same_pose(result.best_candidate, T_ROOM, 0.5, 0.05)
    assert result.counts["correspondences"] == 80


def test_sets_of_correspondences_can_be_put_together():
    sets = [Correspondences(np.full((n, 3), n), np.full((n, 3), -n), np.full(n, 0.5 * n)) for n in (2, 0, 3)]
    joined = Correspondences.of_all(sets)
    assert joined.source_points[:, 0].tolist() == [2, 2, 3, 3, 3]
    assert joined.target_points[:, 0].tolist() == [-2, -2, -3, -3, -3]
    assert joined.distance.tolist() == [1, 1, 1.5, 1.5, 1.5]
    assert Correspondences.of_all(sets[:1]) is sets[0]


def test_a_description_is_checked_when_it_is_made():
    with pytest.raises(InputError, match=r"Description\.keypoints"):
        Description(np.zeros(3), np.zeros((1, 4)))
    description = Description([[1, 2, 3]], [[1, 0, 0, 0]])
    assert (description.descriptors.dtype, len(description)) == (np.float32, 1)
    with pytest.raises(ValueError, match="read-only"):
        description.descriptors[0] = 2
