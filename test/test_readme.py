"""README.md promises names, values, topics, commands and links: each is held against what there is."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from svc_ros.core.config import METHODS, PRESETS, preset, walk
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.io.datasets import read_dataset
from svc_ros.io.results import result_to_json

PROJECT_ROOT = Path(__file__).resolve().parent.parent
README = (PROJECT_ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = ("register", "verify", "view", "evaluate", "calibrate", "replay", "simulate", "config", "doctor")
MAX_PICTURE_BYTES = 400_000
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PROSE = FENCED.sub("", README)


def rows(section: str) -> list[list[str]]:
    """Cells of the one table between <!-- section --> and <!-- /section -->, without its head."""
    (text,) = re.findall(f"<!-- {section} -->\n(.*?)<!-- /{section} -->", README, re.DOTALL)
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def code(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def names(section: str) -> list[str]:
    return [name for row in rows(section) for name in code(row[0])]


def blocks(language: str) -> list[str]:
    return [text for found, text in FENCED.findall(README) if found == language]


def shell_lines() -> list[str]:
    """Commands of the unnamed blocks, continued lines joined, without prompts."""
    text = "\n".join(blocks("")).replace("\\\n", " ")
    return [line.strip().removeprefix("$ ") for line in text.splitlines()]


def invocations() -> list[list[str]]:
    """Words of every `svc_ros COMMAND ...` in the blocks."""
    lines = [line.partition(";")[0] for line in shell_lines() if line.startswith("svc_ros ")]
    return [shlex.split(line)[1:] for line in lines]


def module_from(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_reasons_are_those_of_the_code_in_its_order():
    assert names("reasons") == [reason.value for reason in Reason]


def test_every_reason_has_a_verdict_a_meaning_and_an_advice():
    verdicts = {verdict.value for verdict in Verdict}
    for reason, verdict, meaning, advice in rows("reasons"):
        assert set(verdict.split(" or ")) <= verdicts, reason
        assert meaning, reason
        assert advice, reason


def test_every_verdict_is_explained():
    for verdict in Verdict:
        assert f"\n| `{verdict.value}` |" in README


def test_presets_and_methods_are_complete():
    assert names("presets") == list(PRESETS)
    assert names("methods") == list(METHODS)


def test_parameters_of_the_registration_exist_with_these_values():
    for name, _, *values, _ in rows("parameters of the registration"):
        for preset_name, value in zip(PRESETS, values, strict=True):
            known = {info.name: info.default for info in walk(preset(preset_name))}
            assert yaml.safe_load(value.strip("`")) == known[name.strip("`")], (name, preset_name)


def node_defaults() -> dict[str, object]:
    """The node's own parameters, read without rclpy."""
    tree = ast.parse((PROJECT_ROOT / "svc_ros/ros/parameters.py").read_text(encoding="utf-8"))
    (settings,) = (n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == "NodeSettings")
    return {n.target.id: ast.literal_eval(n.value) for n in settings.body if isinstance(n, ast.AnnAssign)}


def test_parameters_of_the_node_are_complete_with_their_defaults():
    told = {row[0].strip("`"): row[2].strip("`") for row in rows("parameters of the node")}
    assert told.pop("preset") == "lidar_outdoor"
    assert told == {name: shown(value) for name, value in node_defaults().items()}


def shown(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(str, value))
    return str(value).lower() or "empty"


def test_parameters_named_in_the_text_exist():
    groups = {info.name.partition(".")[0] for info in walk(preset("lidar_outdoor")) if "." in info.name}
    known = {info.name for info in walk(preset("lidar_outdoor"))}
    named = {name for name in re.findall(r"`(\w+\.\w+)`", README) if name.partition(".")[0] in groups}
    assert named
    assert named <= known


def test_json_keys_are_those_of_a_result():
    keys = result_to_json(RegistrationResult(Verdict.REJECTED, Reason.NO_HYPOTHESIS)).keys()
    assert sorted(names("json keys")) == sorted(keys)


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_parse(command):
    done = subprocess.run([sys.executable, "-m", "svc_ros", command, "--help"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    options = {word for words in invocations() if words[0] == command for word in words if word.startswith("--")}
    missing = {option for option in options if option not in done.stdout}
    assert not missing


def test_every_command_of_the_program_is_shown():
    assert {words[0] for words in invocations()} == set(COMMANDS)


def test_make_targets_exist():
    makefile = (PROJECT_ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^(\w+):", makefile, re.MULTILINE))
    named = set(re.findall(r"\bmake (?:-C \S+ )?(\w+)", "\n".join([*shell_lines(), *code(PROSE)])))
    assert {"demo", "test", "setup"} <= named <= targets


def test_launch_arguments_exist():
    launch = (PROJECT_ROOT / "launch/registration.launch.py").read_text(encoding="utf-8")
    named = {name for line in code(PROSE) if line.startswith("ros2 launch") for name in re.findall(r"(\w+):=", line)}
    declared = {*re.findall(r'^    "(\w+)": \("', launch, re.MULTILINE), "bag"}
    assert {"preset", "source", "target", "bag", "mode", "rviz"} <= named <= declared


def test_python_and_the_data_set_are_sound(tmp_path):
    assert len(blocks("python")) >= 2
    for text in blocks("python"):
        compile(text, "README.md", "exec")
    (dataset,) = re.findall(r"dataset.json <<'END'\n(.*?)^END$", README, re.MULTILINE | re.DOTALL)
    folder = tmp_path / "try"
    folder.mkdir()
    (folder / "dataset.json").write_text(dataset)
    read = read_dataset(folder)
    assert (len(read.pairs), len(read.negatives)) == (1, 1)


def test_modules_that_are_named_exist():
    for name in re.findall(r"python -m (svc_ros[\w.]*)", README):
        path = PROJECT_ROOT / name.replace(".", "/")
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), name
    for name in re.findall(r"python ((?:tools|benchmarks)/\S+?\.py)", README):
        assert (PROJECT_ROOT / name).is_file(), name


def test_links_lead_somewhere():
    headings = re.findall(r"^#+ (.+)$", PROSE, re.MULTILINE)
    anchors = {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}
    targets = re.findall(r"\]\(([^)]+)\)", README)
    assert len(targets) > 10
    for target in targets:
        if target.startswith("#"):
            assert target[1:] in anchors, target
        else:
            name, _, anchor = target.partition("#")
            path = PROJECT_ROOT / name
            assert path.is_file(), target
            assert not anchor or f"\n## {anchor.replace('-', ' ')}\n" in path.read_text("utf-8").lower(), target


def test_pictures_are_small_pngs():
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", README)
    assert "docs/images/overview.png" in pictures
    for picture in pictures:
        data = (PROJECT_ROOT / picture).read_bytes()
        assert data.startswith(b"\x89PNG\r\n"), picture
        assert len(data) < MAX_PICTURE_BYTES, picture


@pytest.mark.dds
def test_topics_and_services_are_those_of_the_node(monkeypatch):
    rclpy = pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")
    from rclpy.context import Context
    from rclpy.parameter import Parameter
    from ros_bench import without_warm_up

    from svc_ros.ros.processes import own_domain_id
    from svc_ros.ros.registration_node import RegistrationNode

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = Context()
    rclpy.init(context=context, domain_id=own_domain_id(7))
    inputs, outputs, services = set(), set(), {}
    try:
        for mode in ("pair", "scan_matching", "loop_closure"):
            given = [Parameter("mode", value=mode), Parameter("odometry", value="topic")]
            with without_warm_up():
                node = RegistrationNode(
                    context=context, parameter_overrides=given, enable_rosout=False, start_parameter_services=False
                )
            inputs |= {described(s, "in") for s in node.subscriptions}
            outputs |= {described(p, "out") for p in node.publishers if p.topic_name != "/parameter_events"}
            services |= {
                absolute(s.srv_name): full_type(s.srv_type)
                for s in node.services
                if "std_srvs" in s.srv_type.__module__
            }
            node.stop(60.0)
            node.destroy_node()
    finally:
        context.try_shutdown()
    told = [(absolute(row[0]), row[1], row[2].strip("`"), row[3]) for row in rows("topics")]
    assert sorted(told) == sorted(inputs | outputs)
    assert {absolute(row[0]): row[1].strip("`") for row in rows("services")} == services


def absolute(cell: str) -> str:
    name = cell.strip("`")
    return name.replace("~", "/svc_registration") if name.startswith("~") else "/" + name.lstrip("/")


def full_type(kind: type) -> str:
    package, group = kind.__module__.split(".")[:2]
    return f"{package}/{group}/{kind.__name__}"


def described(end, direction: str) -> tuple[str, str, str, str]:
    qos = end.qos_profile
    words = [policy.name.lower().replace("_", " ") for policy in (qos.reliability, qos.durability)]
    return end.topic_name, direction, full_type(end.msg_type), f"{words[0]}, {words[1]}, depth {qos.depth}"


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
