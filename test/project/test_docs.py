"""The pages in docs/ name parameters, topics, reasons, keys and values: each is held against what there is."""

from __future__ import annotations

import ast
import dataclasses
import json
import re

import numpy as np
import pytest
import yaml
from pages import COMMANDS, code, node_defaults, prose
from pages import rows as rows_of
from places import PROJECT_ROOT

from svc_ros.core import errors
from svc_ros.core.config import METHODS, PRESETS, Config, preset, walk
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Description, PreparedScan
from svc_ros.core.sight.evidence import SightLines, SightViewEvidence

DOCS = PROJECT_ROOT / "docs"
PAGES = (
    "reference", "interfaces", "frames", "decisions", "tuning", "integration", "how_it_decides", "calibrate",
    "descriptors", "localization",
)  # fmt: skip
TEXTS = {name: (DOCS / f"{name}.md").read_text("utf-8") for name in PAGES}
CONFIG = {info.name: info.default for info in walk(preset("lidar_outdoor"))}
GROUPS = {name.partition(".")[0] for name in CONFIG if "." in name}
# Names of ROS, of other packages and of formats, that no code of ours spells out.
FOREIGN = {
    "NaN", "base_link", "bond", "use_sim_time", "qos_overrides", "header.frame_id", "child_frame_id", "frame_id",
    "/kiss/odometry", "/initialpose", "/amcl_pose", "/tf", "/source", "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT",
    "odom_lidar", "odom0_differential: true", "base_footprint", "keyframes",
    "pyproject.toml", "svc_ros_spin_images.py", "functools.lru_cache",
    "NUMBA_CACHE_DIR", "make setup", "timebase", "xfer_format",
    "configure", "activate", "deactivate", "cleanup", "message", "p_target = T_target_source p_source",
    "sensor_data", "is_dense", "FRAME/source", "-r source_points:=/your/topic", '""', "1", "1.0",
    "_m", "_deg", "_s", "_ms", "_ns",
}  # fmt: skip
PROGRAMS = ("svc_ros ", "ros2 ", "make ", "python -m ")  # test_pages.py asks for what they are given


def named(page: str) -> list[str]:
    return code(prose(TEXTS[page]))


def rows(section: str) -> list[list[str]]:
    """Of the one page that has this table."""
    return rows_of(section, "".join(TEXTS.values()))


def launch_arguments() -> set[str]:
    texts = [path.read_text("utf-8") for path in (PROJECT_ROOT / "launch").glob("*.py")]
    return {name for text in texts for name in re.findall(r'^    "(\w+)": (?:\(|MODE,)', text, re.MULTILINE)}


def spelled_out() -> set[str]:
    """Every text in the code, which is what messages, keys and choices are made of."""
    trees = [ast.parse(path.read_text("utf-8")) for path in PROJECT_ROOT.glob("svc_ros/**/*.py")]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    calls = [node for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)]
    updated = {word.arg for call in calls if call.func.attr == "update" for word in call.keywords if word.arg}
    return updated | {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}


def data_types() -> set[str]:
    """Names of the errors, and of the types that a descriptor deals with and their fields."""
    types = (Config, Description, PreparedScan)
    values = {f.name for kind in types for f in dataclasses.fields(kind)}
    return values | {kind.__name__ for kind in types} | {name for name in vars(errors) if name.endswith("Error")}


def evidence_keys() -> set[str]:
    nothing = np.zeros(0, np.int64)
    lines = SightLines(0, 0, nothing, nothing)
    return set(SightViewEvidence(lines, lines, 0.0, 0.0, 0.0).numbers())


def programs_and_files() -> set[str]:
    scripts = re.findall(r'f"(\w+) = ', (PROJECT_ROOT / "setup.py").read_text("utf-8"))
    files = [path for folder in ("launch", "config") for path in (PROJECT_ROOT / folder).iterdir()]
    return {"ros2", *scripts, *COMMANDS, *(path.name for path in files), *(f"{p.parent.name}/{p.name}" for p in files)}


@pytest.fixture(scope="module")
def known() -> set[str]:
    topics = {row[0].strip("`") for row in rows("topics")}
    services = {row[0].strip("`") for row in rows("services")}
    types = {*(row[2].strip("`") for row in rows("topics")), *(row[1].strip("`") for row in rows("services"))}
    codes = {item.value for item in (*Reason, *Verdict)} | {"p50", "p95", "p99"}
    statuses = {f"svc_registration: {row[0].split(': ')[1].strip('`')}" for row in rows("statuses")}
    values = {*CONFIG, *GROUPS, *node_defaults(), "preset", *PRESETS, *METHODS, *launch_arguments()}
    sets = set(json.loads((PROJECT_ROOT / "benchmarks/results/decision.json").read_text("utf-8"))["num_poses"])
    jobs = {f"jobs.{name}" for row in rows("status keys") if row[0] == "`jobs`" for name in code(row[1])}
    told = sets | codes | statuses | jobs | topics | services | types | values
    return told | data_types() | evidence_keys() | spelled_out() | programs_and_files() | FOREIGN


def is_known(word: str, known: set[str]) -> bool:
    if word in known or word.startswith(("--", *PROGRAMS)):
        return True
    if "/" in word and not word.startswith(("~", "/")):
        return (PROJECT_ROOT / word.removeprefix("python ")).is_file()
    if word.startswith("~/"):
        return False
    if ":=" in word:
        return all(is_setting(part, known) for part in word.split(" "))
    return is_setting(word, known) or (" " in word and any(word in text for text in known))


def is_setting(word: str, known: set[str]) -> bool:
    """`name:=value` or `name: value` with a parameter or an argument, and a value that it can have."""
    name, *value = re.split(r":=|: ", word, maxsplit=1)
    is_name = name in {*node_defaults(), *launch_arguments()}
    return is_name and len(value) == 1 and value[0] in {*known, "true", "false"}


@pytest.mark.parametrize("page", PAGES)
def test_every_name_exists(page, known):
    unknown = [word for word in named(page) if not is_known(word, known)]
    assert unknown == []


def test_names_that_do_not_exist_are_found(known):
    wrong = ["~/decisions", "decision.min_overlap", "low_overlaps", "odometry:=topics", "max_skews", "moed:=pair"]
    assert [word for word in wrong if is_known(word, known)] == []


def test_values_are_those_of_the_presets():
    table = rows("values")
    assert len(table) >= 5
    for name, *values in table:
        for preset_name, value in zip(PRESETS, values, strict=True):
            default = {info.name: info.default for info in walk(preset(preset_name))}[name.strip("`")]
            assert yaml.safe_load(value) == default, (name, preset_name)


def test_every_reason_has_advice():
    told = set(named("decisions"))
    assert {reason.value for reason in Reason} - told <= {"ok"}


def test_origins_are_those_of_the_streams():
    stream = (PROJECT_ROOT / "svc_ros/pipeline/stream.py").read_text("utf-8")
    (text,) = re.findall(r"origin: where the judged pose came from \(([^)]+)\)", stream)
    assert [row[0].strip("`") for row in rows("origins")] == " ".join(text.split()).split(", ")


def test_keys_of_decisions_status_and_diagnostics_are_those_of_the_node():
    pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")
    from svc_ros.ros.diagnostics import Statistics, statuses
    from svc_ros.ros.streams.decision import Decision
    from svc_ros.ros.streams.worker import CloudLabel
    from svc_ros.ros.topics.outputs import _values

    result = RegistrationResult(Verdict.REJECTED, Reason.NO_HYPOTHESIS)
    label = CloudLabel(1, "lidar")
    always = {key for row in rows("decision keys") if row[1] == "always" for key in code(row[0])}
    assert always == set(_values(Decision(result, label, label)))
    statistics = Statistics({"points": True})
    worker = {"ready": True, "enabled": True, "queue": 0, "queue_size": 1}
    worker |= {"state": "lost", "map_keyframes": 9, "told": 0, "told_wrong": False, "told_problem": ""}
    flow = {"pairing": {}, "worker": worker, "output": {"reader_stopped": False}}
    told = [status.name for status in statuses(statistics, flow, False)]
    assert told == [row[0].strip("`") for row in rows("statuses")]
    keys = {key: row[1] for row in rows("status keys") for key in code(row[0])}
    numbers = statistics.numbers()
    assert set(numbers) <= set(keys)
    assert code(keys["jobs"]) == list(numbers["jobs"])


def test_judged_decisions_have_these_numbers():
    told = {key for row in rows("decision keys") if row[1] == "judged" for key in code(row[0])}
    assert told - {"probability"} <= evidence_keys()
