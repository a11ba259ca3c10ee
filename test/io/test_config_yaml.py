"""Configuration files: what is read, what is refused, and how the refusal names file and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from svc_ros.core.config import PRESETS, Config, preset, walk, with_values
from svc_ros.core.errors import ConfigError, InputError
from svc_ros.io.config_yaml import config_to_yaml, read_config, read_config_file, write_preset_files


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_survives_the_way_through_yaml(tmp_path: Path, name: str) -> None:
    assert read_config(written(tmp_path, config_to_yaml(PRESETS[name], name)), Config()) == PRESETS[name]


def test_extreme_values_survive_the_way_through_yaml(tmp_path: Path) -> None:
    extremes = {}
    for info in walk(Config()):
        bound = info.low if info.low is not None else info.high
        if bound is not None and info.name.startswith("hypotheses."):
            extremes[info.name] = type(info.default)(bound)
    config = with_values(Config(), {**extremes, "paper.cone_cosine": 1e-05, "method": "sc2"})
    assert read_config(written(tmp_path, config_to_yaml(config)), preset("rgbd_indoor")) == config


def test_every_value_has_a_comment_with_unit_and_range() -> None:
    lines = config_to_yaml(Config(), "lidar_outdoor").splitlines()
    at = lines.index("      voxel_size_m: 0.3") if "      voxel_size_m: 0.3" in lines else -1
    assert at > 0
    assert lines[at - 1] == "      # edge of the voxel grid that thins a scan (v) [m], 0.005 to 10"
    assert sum(line.lstrip().startswith("#") for line in lines) >= len(list(walk(Config())))
    assert "one of one_way, mutual, ratio" in "\n".join(lines)


@pytest.mark.parametrize(
    "text",
    [
        "preprocess: {voxel_size_m: 0.5}",
        "preprocess.voxel_size_m: 0.5",
        "/**:\n  ros__parameters:\n    preprocess: {voxel_size_m: 0.5}",
        "svc_registration:\n  ros__parameters:\n    preprocess.voxel_size_m: 0.5",
        "/robot/svc_registration:\n  ros__parameters:\n    preprocess.voxel_size_m: 5e-1",
        "/**:\n  ros__parameters: {preprocess: {voxel_size_m: 0.4}}\n"
        "svc_registration:\n  ros__parameters: {preprocess.voxel_size_m: 0.5}",
    ],
)
def test_all_forms_of_a_file_say_the_same(tmp_path: Path, text: str) -> None:
    assert read_config(written(tmp_path, text), Config()) == with_values(Config(), {"preprocess.voxel_size_m": 0.5})


@pytest.mark.parametrize("text", ["", "# nothing\n", "/**:\n  ros__parameters:\n"])
def test_an_empty_file_changes_nothing(tmp_path: Path, text: str) -> None:
    assert read_config(written(tmp_path, text), preset("rgbd_indoor")) == preset("rgbd_indoor")


def test_an_integer_is_a_float_where_a_float_is_expected(tmp_path: Path) -> None:
    value = read_config(written(tmp_path, "preprocess: {max_range_m: 50}"), Config()).preprocess.max_range_m
    assert (value, type(value)) == (50.0, float)


def test_the_file_may_name_its_preset(tmp_path: Path) -> None:
    path = written(tmp_path, "preset: rgbd_indoor\nmatching.max_correspondences: 123")
    assert read_config(path, Config()) == with_values(preset("rgbd_indoor"), {"matching.max_correspondences": 123})
    assert read_config_file(path).preset == "rgbd_indoor"


def test_keys_of_the_node_are_kept_apart(tmp_path: Path) -> None:
    path = written(tmp_path, "mode: pair\nmax_skew: 0.05\nqos_overrides: {/points: {depth: 3}}\nmethod: sc2")
    found = read_config_file(path)
    assert found.node_values == {"mode": "pair", "max_skew": 0.05, "qos_overrides./points.depth": 3}
    assert read_config(path, Config()).method == "sc2"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "preprocess: {voxel_size: 0.5}",
            "unknown key 'preprocess.voxel_size'; did you mean 'preprocess.voxel_size_m'",
        ),
        (
            "preproces: {voxel_size_m: 0.5}",
            "unknown key 'preproces.voxel_size_m'; did you mean 'preprocess.voxel_size_m'",
        ),
        ("voxel_size_m: 0.5", "unknown key 'voxel_size_m'; did you mean 'preprocess.voxel_size_m'"),
        ("methd: sc2", "unknown key 'methd'; did you mean 'method'"),
        ("zzzz: 1", "unknown key 'zzzz'; `svc_ros config`"),
        ("3: 1", "unknown key '3'"),
        ("preprocess: 3", "preprocess: expected a group of values .*voxel_size_m"),
        ("preprocess: {voxel_size_m: big}", "preprocess.voxel_size_m: expected float, found 'big'"),
        ("preprocess: {voxel_size_m: true}", "preprocess.voxel_size_m: expected float, found True"),
        ("preprocess: {voxel_size_m: }", "preprocess.voxel_size_m: expected float, found None"),
        ("preprocess: {min_points: 10.5}", "preprocess.min_points: expected int, found 10.5"),
        ("preprocess: {voxel_size_m: 99.0}", "preprocess.voxel_size_m: expected a value from 0.005 to 10"),
        ("preprocess: {voxel_size_m: .nan}", "preprocess.voxel_size_m: expected a value from"),
        ("matching: {strategy: mutal}", "'mutal'; did you mean 'mutual'"),
        ("preset: rgbd_indor", "did you mean 'rgbd_indoor'"),
        ("preset: 3", "preset: expected a name, found 3"),
        ("method: sc2\nmethod: svc", ":2: .*key 'method' is given twice"),
        ("preprocess.min_points: 9\npreprocess: {min_points: 8}", "'preprocess.min_points' is given twice"),
        ("method: [sc2", ":1: not valid YAML"),
        ("method: !!python/object/apply:os.getcwd []", "not valid YAML"),
        ("- method", "expected names and values"),
        ("other_node:\n  ros__parameters: {method: sc2}", "/\\*\\* or svc_registration, found those of other_node"),
        ("/**:\n  ros__parameters: 3", "ros__parameters: expected names and values, found 3"),
    ],
)
def test_what_is_wrong_is_named_with_the_file(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=rf"mine\.yaml.*{message}") as caught:
        read_config(written(tmp_path, text), Config())
    assert "\n" not in str(caught.value)
    assert str(caught.value).count("mine.yaml") == 1


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.yaml: .*No such file"):
        read_config(tmp_path / "absent.yaml", Config())
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="binary data"):
        read_config(tmp_path / "binary.yaml", Config())
    with pytest.raises(InputError, match="cannot be written"):
        write_preset_files(tmp_path / "nowhere")
