"""The YAML files in config/ and the dataclass tree are one and the same: keys and values, in both directions."""

from __future__ import annotations

from pathlib import Path

import pytest
from places import PROJECT_ROOT

from svc_ros.core.config import PRESETS, Config, walk
from svc_ros.io.config_yaml import read_config, read_config_file, write_preset_files

FOLDER = PROJECT_ROOT / "config"
REGENERATE = "regenerate: python -c \"from svc_ros.io.config_yaml import write_preset_files as w; w('config')\""


def test_there_is_one_file_a_preset_and_no_other() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.yaml")) == sorted(PRESETS)


@pytest.mark.parametrize("name", PRESETS)
def test_the_file_holds_every_key_of_the_tree_with_its_value(name: str) -> None:
    found = read_config_file(FOLDER / f"{name}.yaml")
    expected = {info.name: info.default for info in walk(PRESETS[name])}
    assert found.values == expected, REGENERATE
    assert {key: type(value) for key, value in found.values.items()} == {k: type(v) for k, v in expected.items()}
    assert found.node_values == {"preset": name}


@pytest.mark.parametrize("name", PRESETS)
def test_the_file_builds_the_preset_whatever_the_base(name: str) -> None:
    for base in (Config(), *PRESETS.values()):
        assert read_config(FOLDER / f"{name}.yaml", base) == PRESETS[name], REGENERATE


def test_the_files_are_as_they_are_written_today(tmp_path: Path) -> None:
    for path in write_preset_files(tmp_path):
        assert (FOLDER / path.name).read_text() == path.read_text(), REGENERATE
