"""README.md is short, and shows the commands, a Python example that runs, pictures, every page, and the results."""

from __future__ import annotations

import json
import re

import pytest
from pages import README, blocks, code, module_from, prose, rows, shell_lines
from places import PROJECT_ROOT

from svc_ros.simulation import DriveConfig, simulate_drive

MAX_LINES = 200
MAX_PICTURE_BYTES = 400_000


def test_it_is_short():
    assert len(README.splitlines()) <= MAX_LINES


def test_it_has_both_commands_and_a_bag_of_ones_own():
    lines = shell_lines(README)
    assert {"make demo", "make test"} <= set(lines)
    assert {line.split()[1] for line in lines if line.startswith("svc_ros ") and " BAG" in line} == {"doctor", "replay"}


def test_the_launch_line_of_each_mode_names_its_topics():
    inputs = {row[0].strip("`") for row in rows("topics") if row[1] == "in"} - {"initial_guess"}
    told = set(re.findall(r"\b(\w+):=/", " ".join(code(prose(README)))))
    assert {name.removesuffix("_points") for name in inputs} == told


def test_the_python_example_runs_on_what_the_demo_leaves(tmp_path, monkeypatch, capsys):
    (example,) = blocks(README, "python")
    assert "from svc_ros import" in example
    simulate_drive(tmp_path / "out" / "demo" / "drive", DriveConfig(num_scans=2))
    monkeypatch.chdir(tmp_path)
    found = {}
    exec(compile(example, "README.md", "exec"), found)
    assert capsys.readouterr().out.startswith("accepted ok ")
    assert found["in_target_frame"].shape == found["source"].points.shape


def test_pictures_are_small_pngs():
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", README)
    assert pictures
    for picture in pictures:
        data = (PROJECT_ROOT / picture).read_bytes()
        assert data.startswith(b"\x89PNG\r\n"), picture
        assert len(data) < MAX_PICTURE_BYTES, picture


def test_every_page_is_linked():
    pages = [path.name for path in (PROJECT_ROOT / "docs").glob("*.md")]
    assert [name for name in pages if f"](docs/{name})" not in README] == []


REPORT = {
    "dataset": "os1_64_seosan", "method": "svc", "preset": "lidar_outdoor", "time_ms": {"register_p50": 812.4},
    "registration": {
        "num_pairs": 72, "num_false_accepted": 1, "success_rate": 0.9861, "candidate_success_rate": 1.0,
    },
    "decision": {"f1": 0.99, "precision": None}, "negatives": {"num_pairs": 3, "num_false_accepted": 2},
}  # fmt: skip


@pytest.fixture
def table_writer():
    return module_from(PROJECT_ROOT / "benchmarks" / "readme_table.py")


def test_results_are_written_between_their_marks(tmp_path, table_writer):
    (tmp_path / "a.json").write_text(json.dumps(REPORT))
    (tmp_path / "b.json").write_text(json.dumps({**REPORT, "method": "sc2", "decision": None, "negatives": None}))
    (tmp_path / "other.json").write_text("[1]")
    readme = tmp_path / "README.md"
    readme.write_text(README)
    assert table_writer.main([str(tmp_path), "--readme", str(readme)]) == 0
    written = readme.read_text()
    lines = re.findall(r"^\| os1_64_seosan \|.*$", written, re.MULTILINE)
    assert lines == [
        "| os1_64_seosan | `svc` | 72 + 3 negatives | 0.986 | 1.000 | 3 | 0.990 |  | 812 |",
        "| os1_64_seosan | `sc2` | 72 | 0.986 | 1.000 | 1 |  |  | 812 |",
    ]
    assert written.partition("<!-- results -->")[0] == README.partition("<!-- results -->")[0]
    assert written.partition("<!-- /results -->")[2] == README.partition("<!-- /results -->")[2]
    assert table_writer.main([str(tmp_path), "--readme", str(readme)]) == 0
    assert readme.read_text() == written


def test_a_folder_without_reports_is_refused(tmp_path, table_writer, capsys):
    assert table_writer.main([str(tmp_path), "--readme", str(tmp_path / "README.md")]) == 2
    assert str(tmp_path) in capsys.readouterr().err


def test_a_readme_without_marks_is_refused(tmp_path, table_writer, capsys):
    (tmp_path / "a.json").write_text(json.dumps(REPORT))
    (tmp_path / "README.md").write_text("nothing")
    assert table_writer.main([str(tmp_path), "--readme", str(tmp_path / "README.md")]) == 2
    assert "<!-- results -->" in capsys.readouterr().err


def test_the_results_name_all_data_sets(table_writer):
    results = README.partition("<!-- results -->")[2].partition("<!-- /results -->")[0]
    for name in table_writer.SETS:
        assert re.search(rf"\b{name}\b", results), name
