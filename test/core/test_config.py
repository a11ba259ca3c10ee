"""The configuration tree: every leaf has its words, its range and its one way to be set."""

from __future__ import annotations

import dataclasses

import pytest

from svc_ros.core.config import METHODS, PRESETS, Config, FieldInfo, preset, unknown_name, walk, with_values
from svc_ros.core.errors import ConfigError

LEAVES = {info.name: info for info in walk(Config())}
BOUNDED = [info for info in LEAVES.values() if info.low is not None]


def value_at(config: Config, name: str) -> object:
    for part in name.split("."):
        config = getattr(config, part)
    return config


def test_the_walk_reaches_every_field_of_every_group():
    expected = ["method"]
    for group in dataclasses.fields(Config)[1:]:
        expected += [f"{group.name}.{leaf.name}" for leaf in dataclasses.fields(getattr(Config(), group.name))]
    assert list(LEAVES) == expected


@pytest.mark.parametrize("info", LEAVES.values(), ids=list(LEAVES))
def test_every_leaf_is_described(info: FieldInfo):
    assert info.description
    assert info.default == value_at(Config(), info.name)
    if isinstance(info.default, str):
        assert info.default in (info.choices or ("",))  # one of a list, or a text that is empty unless it is given
    elif not isinstance(info.default, bool):
        assert info.low <= info.default <= info.high
    for suffix, unit in (("_m", "m"), ("_deg", "deg"), ("_voxels", "voxels")):
        assert not info.name.endswith(suffix) or info.unit == unit


@pytest.mark.parametrize("info", BOUNDED, ids=[info.name for info in BOUNDED])
def test_values_outside_their_range_are_refused(info: FieldInfo):
    step = 1 if isinstance(info.default, int) else 1e-6
    for wrong in (info.low - step, info.high + step):
        with pytest.raises(ConfigError, match=f"{info.name}: expected a value from"):
            with_values(Config(), {info.name: wrong})


@pytest.mark.parametrize("info", LEAVES.values(), ids=list(LEAVES))
def test_values_of_another_type_are_refused(info: FieldInfo):
    others = {str: [1, True], bool: [1, 0.0, "true"]}.get(type(info.default), [True, "1"])
    for wrong in [None, [1], float("nan"), *others]:
        with pytest.raises(ConfigError, match=info.name):
            with_values(Config(), {info.name: wrong})


def test_whole_numbers_serve_as_lengths_but_not_the_reverse():
    changed = with_values(Config(), {"preprocess.voxel_size_m": 1})
    assert isinstance(changed.preprocess.voxel_size_m, float)
    with pytest.raises(ConfigError, match="expected int"):
        with_values(Config(), {"matching.max_correspondences": 100.0})


def test_several_values_change_at_once_and_the_original_does_not():
    base = Config()
    changed = with_values(base, {"method": "sc2", "preprocess.min_range_m": 90, "preprocess.max_range_m": 100})
    assert (changed.method, changed.preprocess.min_range_m, changed.preprocess.max_range_m) == ("sc2", 90, 100)
    assert base == Config()
    assert with_values(base, {}) == base


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"preprocess.voxel_size": 1.0}, "did you mean 'preprocess.voxel_size_m'"),
        ({"voxel_size_m": 1.0}, "did you mean 'preprocess.voxel_size_m'"),
        ({"preprocess": 1.0}, "unknown name 'preprocess'"),
        ({"method": "svc_papr"}, "did you mean 'svc_paper'"),
        ({"matching.strategy": "mutal"}, "matching.strategy: unknown name 'mutal'; did you mean 'mutual'"),
        ({"preprocess.min_range_m": 80.0}, "min_range_m .80.0. must be below max_range_m"),
        ({"hypotheses.second_consensus": 31}, "second_consensus must not exceed first_consensus"),
    ],
)
def test_wrong_names_and_combinations_say_what_would_be_right(values, words):
    with pytest.raises(ConfigError, match=words):
        with_values(Config(), values)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_found_by_name(name):
    assert preset(name) is PRESETS[name]
    assert PRESETS[name].method == "svc"


def test_unknown_preset_names_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'lidar_outdoor'"):
        preset("lidar_outdor")


def test_a_name_like_no_other_gets_no_guess():
    text = unknown_name("method", "zzz", METHODS)
    assert "did you mean" not in text
    assert all(name in text for name in METHODS)


def test_lengths_follow_the_voxel():
    config = with_values(Config(), {"preprocess.voxel_size_m": 0.1})
    assert config.preprocess.normal_radius_m == pytest.approx(0.1 * config.preprocess.normal_radius_voxels)
    assert config.feature_radius_m == pytest.approx(0.1 * config.features.radius_voxels)
