"""What the launch files start and what the layouts show; starting without what ROS brings."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from launch_stand_ins import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription, load, load_real, started
from pages import absolute, node_defaults, rows
from places import PROJECT_ROOT
from yardstick import PATIENCE_S

from svc_ros.core.config import AUTO, METHODS, PRESETS, preset, walk
from svc_ros.core.errors import ConfigError
from svc_ros.ros.middleware import PROFILE_VARIABLE

REGISTRATION = PROJECT_ROOT / "launch" / "registration.launch.py"
REPLAY = PROJECT_ROOT / "launch" / "replay.launch.py"
LOCALIZATION = PROJECT_ROOT / "launch" / "localization.launch.py"
FILES = (REGISTRATION, REPLAY, LOCALIZATION)
RVIZ = PROJECT_ROOT / "config" / "svc_ros.rviz"
FOXGLOVE = PROJECT_ROOT / "config" / "foxglove_layout.json"
SHOWN_TYPES = {
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "PoseWithCovariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "Path": "nav_msgs/msg/Path",
    "Odometry": "nav_msgs/msg/Odometry",
}
LOOKED_AT = {f"/svc_registration/{name}" for name in ("aligned", "blocked_points", "sight_lines")} | {"/target_points"}


@pytest.fixture
def registration(monkeypatch):
    return load(REGISTRATION, monkeypatch)


@pytest.fixture
def replay(monkeypatch):
    return load(REPLAY, monkeypatch)


def topics() -> dict[str, tuple[str, str]]:
    """Type and QoS of every topic of the node, by its full name."""
    return {absolute(row[0]): (row[2].strip("`"), row[3]) for row in rows("topics")}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_argument_is_described_and_its_default_is_a_choice(path, monkeypatch):
    module = load(path, monkeypatch)
    (description,) = module.generate_launch_description().given
    declared = [entity.options for entity in description if isinstance(entity, DeclareLaunchArgument)]
    assert len(declared) == len(module.ARGUMENTS)
    for options in declared:
        assert options["description"]
        assert options["choices"] is None or options["default_value"] in options["choices"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_choices_are_those_of_the_node_and_are_described(path, monkeypatch):
    module = load(path, monkeypatch)
    parameters = (PROJECT_ROOT / "svc_ros/ros/parameters.py").read_text("utf-8")
    known = {"preset": (*PRESETS, AUTO), "method": tuple(METHODS)}
    for name, constant in (("mode", "MODES"), ("odometry", "ODOMETRY"), ("told_by", "TOLD_BY")):
        (text,) = re.findall(rf"^{constant} = \((.*)\)$", parameters, re.MULTILINE)
        known[name] = tuple(re.findall(r'"(\w+)"', text))
    for name, choices in module.CHOICES.items():
        assert tuple(choices) == known.get(name, tuple(choices)), name
        assert all(c in module.ARGUMENTS[name][1] for c in choices), name


def test_node_starts_with_its_defaults(registration):
    (node,) = started(registration)
    told = node.options
    assert (told["package"], told["executable"], told["name"]) == ("svc_ros", "registration_node", "svc_registration")
    (values,) = told["parameters"]
    defaults = {"preset": "lidar_outdoor", "method": "svc", "use_sim_time": False, **node_defaults()}
    assert values == {name: defaults[name] for name in values}
    assert dict(told["remappings"]) == {name: name for name, _ in told["remappings"]}
    inputs = {name for row in rows("topics") if row[1] == "in" for name in [row[0].strip("`")]}
    assert {name for name, _ in told["remappings"]} == inputs


def test_every_parameter_exists(registration):
    values = registration.parameters(dict.fromkeys(registration.ARGUMENTS, "true"))
    known = {info.name for info in walk(preset("lidar_outdoor"))} | set(node_defaults()) | {"preset", "use_sim_time"}
    assert {name for name in values if not name.startswith("qos_overrides.")} <= known


def test_given_arguments_reach_the_node(registration):
    (node,) = started(
        registration, mode="loop_closure", points="/lidar", odometry="tf", graph_file="a.g2o", params_file="b.yaml"
    )
    values, file = node.options["parameters"]
    assert file == "b.yaml"
    assert (values["mode"], values["odometry"], values["graph_file"]) == ("loop_closure", "tf", "a.g2o")
    assert ("points", "/lidar") in node.options["remappings"]


@pytest.mark.parametrize(("namespace", "topic"), [("", "/source_points"), ("/robot", "/robot/source_points")])
def test_reliable_clouds_are_asked_for_by_full_names(registration, namespace, topic):
    (node,) = started(registration, reliable="true", namespace=namespace, target="/map")
    (values,) = node.options["parameters"]
    for name in (topic, "/map"):
        assert values[f"qos_overrides.{name}.subscription.reliability"] == "reliable"


@pytest.mark.parametrize(("value", "is_on"), [("True", True), ("TRUE", True), ("true", True), ("False", False)])
def test_switches_may_be_written_as_in_python(registration, value, is_on):
    names = ("publish_tf", "process_every", "reliable", "use_sim_time", "rviz")
    node, *others = started(registration, **dict.fromkeys(names, value))
    (values,) = node.options["parameters"]
    assert [values[name] for name in ("publish_tf", "process_every", "use_sim_time")] == [is_on] * 3
    assert any(name.startswith("qos_overrides.") for name in values) == is_on
    assert len(others) == is_on  # RViz
    assert not set(names) & set(registration.CHOICES)  # launch would refuse every other spelling
    assert all(registration.ARGUMENTS[name][1].startswith("true or false: ") for name in names)


def test_a_switch_that_is_neither_is_refused_by_name(registration):
    with pytest.raises(ConfigError, match="launch argument rviz: expected true or false, found 'yes'"):
        started(registration, rviz="yes")


def test_rviz_shows_the_topics_of_this_node(registration):
    _, rviz = started(registration, rviz="true", target="/map", namespace="robot", odom_frame="world")
    words = rviz.options["arguments"]
    assert Path(words[words.index("-d") + 1]).resolve() == RVIZ
    assert words[words.index("-f") + 1] == "world"
    remapped = dict(rviz.options["remappings"])
    assert remapped["/target_points"] == "/map"
    named = {display["Topic"]["Value"] for display in displays()}
    assert named == set(remapped)
    assert all(absolute(new) == old for old, new in remapped.items() if old.startswith("/svc_registration/"))


@pytest.mark.parametrize("mode", ["pair", "scan_matching", "loop_closure"])
def test_replay_plays_to_the_topics_of_the_node(replay, registration, mode):
    pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")
    from svc_ros.ros.bag_player import _parser

    include, player = started(replay, bag="drive", mode=mode, rate="0", namespace="robot")
    given = dict(include.options["launch_arguments"])
    assert set(given) <= set(registration.ARGUMENTS)
    assert (given["mode"], given["process_every"], given["reliable"]) == (mode, "true", "true")
    assert player.options["executable"] == "bag_player"
    options = _parser().parse_args(player.options["arguments"])
    assert (options.bag, options.rate, options.scans) == ("drive", 0.0, mode != "pair")
    assert (options.source_topic, options.target_topic) == (given["source"], given["target"])
    assert options.points_topic == given["points"]
    # A scan without candidates for a loop has no decision to wait for.
    assert options.wait_decisions == (mode != "loop_closure")
    assert options.node_name == "/svc_registration" or options.node_name == "/robot/svc_registration"
    assert (options.node_name == "/robot/svc_registration") == options.wait_decisions


def test_replay_by_ros2_goes_by_the_clock_of_the_bag(replay, registration):
    include, player = started(replay, bag="drive", mode="scan_matching", player="ros2", topic="/lidar", rate="2.0")
    assert isinstance(include, IncludeLaunchDescription)
    assert isinstance(player, ExecuteProcess)
    given = dict(include.options["launch_arguments"])
    assert set(given) <= set(registration.ARGUMENTS)
    assert (given["use_sim_time"], given["points"]) == ("true", "/lidar")
    assert "reliable" not in given
    assert player.options["cmd"] == ["ros2", "bag", "play", "drive", "--clock", "--rate", "2.0"]


def test_who_sends_or_shows_clouds_has_the_shipped_profile_unless_another_is_set(replay, registration, monkeypatch):
    for name in (PROFILE_VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS"):
        monkeypatch.delenv(name, raising=False)
    shipped = {PROFILE_VARIABLE: str(PROJECT_ROOT / "config" / "fastdds_large_clouds.xml")}
    for wanted in (shipped, {}):
        _, player = started(replay, bag="drive", player="ros2")
        _, rviz = started(registration, rviz="true")
        assert player.options["additional_env"] == rviz.options["additional_env"] == wanted
        monkeypatch.setenv(PROFILE_VARIABLE, "/mine.xml")


def test_rviz_shows_a_place_in_the_map_in_the_maps_frame(registration):
    for given, frame in (({}, "map"), ({"map_frame": "site"}, "site"), ({"fixed_frame": "odom"}, "odom")):
        _, rviz = started(registration, rviz="true", mode="localization", **given)
        words = rviz.options["arguments"]
        assert words[words.index("-f") + 1] == frame


def test_localization_is_the_registration_in_a_map_with_its_own_preset(registration, monkeypatch):
    module = load(LOCALIZATION, monkeypatch)
    (include,) = started(module, map_folder="site", publish_tf="True")
    assert Path(include.given[0].given[0]).resolve() == REGISTRATION
    given = dict(include.options["launch_arguments"])
    assert given == {
        "mode": "localization", "preset": "auto", "map_folder": "site", "odometry": "tf", "publish_tf": "true",
        "base_frame": "base_link",
    }  # fmt: skip
    (node,) = started(registration, **given, initialpose="/amcl_pose")
    (values,) = node.options["parameters"]
    assert given.items() - {("publish_tf", "true")} <= values.items()
    assert (values["publish_tf"], values["told_by"], values["publish_initialpose"]) == (True, "topic", False)
    assert ("initialpose", "/amcl_pose") in node.options["remappings"]


def test_replay_includes_the_file_beside_it(replay):
    include, _ = started(replay, bag="drive")
    (source,) = include.given
    assert Path(source.given[0]).resolve() == REGISTRATION


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_files_describe_a_launch_where_launch_is_installed(path):
    pytest.importorskip("launch_ros", reason="needs launch_ros (apt install ros-jazzy-launch-ros)")
    from launch import LaunchContext

    module = load_real(path)
    description = module.generate_launch_description()
    assert len(description.entities) == len(module.ARGUMENTS) + 1
    context = LaunchContext()
    context.launch_configurations.update({name: d or "drive" for name, (d, _) in module.ARGUMENTS.items()})
    actions = [action for action in module.start(context) if type(action).__name__ != "LogInfo"]
    assert len(actions) == (2 if path == REPLAY else 1)


def displays() -> list[dict]:
    """Displays of the RViz configuration that show a topic."""
    shown = yaml.safe_load(RVIZ.read_text("utf-8"))["Visualization Manager"]["Displays"]
    return [display for display in shown if "Topic" in display]


def test_rviz_displays_fit_the_topics():
    for display in displays():
        kind, qos = topics()[display["Topic"]["Value"]]
        assert kind == SHOWN_TYPES[display["Class"].removeprefix("rviz_default_plugins/")], display["Name"]
        assert display["Topic"]["Durability Policy"].lower() in qos, display["Name"]
        assert display["Topic"]["Reliability Policy"].lower() in qos, display["Name"]
        assert display["Enabled"] == display["Value"], display["Name"]


def test_rviz_shows_target_source_and_sight_lines():
    assert {display["Topic"]["Value"] for display in displays() if display["Enabled"]} >= LOOKED_AT


def test_foxglove_shows_topics_of_the_node():
    text = FOXGLOVE.read_text("utf-8")
    panels = json.loads(text)["configById"]
    assert set(panels["3D!svc"]["topics"]) >= LOOKED_AT
    named = {*panels["3D!svc"]["topics"], *re.findall(r'"(/\w[\w/]*)[."]', text)}
    assert {"/svc_registration/decision", "/diagnostics"} <= named <= set(topics())


def test_foxglove_names_keys_and_statuses_that_are_sent():
    pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")
    from svc_ros.core.result import Reason, RegistrationResult, Verdict
    from svc_ros.io.results import decision_values
    from svc_ros.ros.topics.conversions import decision_message

    panels = json.loads(FOXGLOVE.read_text("utf-8"))["configById"]
    result = RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP)
    values = decision_values(result, 1, 2)
    (status,) = decision_message(result, values, 1, "lidar").status
    assert panels["DiagnosticStatusPanel!decision"]["selectedName"] == status.name
    assert panels["DiagnosticStatusPanel!decision"]["selectedHardwareId"] == status.hardware_id
    assert set(re.findall(r'key==\\"(\w+)\\"', FOXGLOVE.read_text("utf-8"))) <= set(values)
    assert [rule["rawValue"] for rule in panels["Indicator!verdict"]["rules"]] == [v.value for v in Verdict]


def test_foxglove_places_every_panel_once():
    layout = json.loads(FOXGLOVE.read_text("utf-8"))
    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])


def leaves(node) -> list[str]:
    return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])


def test_missing_rclpy_is_one_line_and_exit_code_2():
    code = "import sys; sys.modules['rclpy'] = None; from svc_ros.ros.node import main; sys.exit(main([]))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S)
    assert run.returncode == 2
    (line,) = run.stderr.splitlines()
    assert "svc_ros[ros]" in line
    assert "ros-jazzy-rclpy" in line
