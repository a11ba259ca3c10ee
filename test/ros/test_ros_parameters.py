"""The node's parameters: the config's fields, found by walking it."""

from __future__ import annotations

import numpy as np
import pytest
from descriptor_packages import write_package
from mini_data import POSES, scan_room

rclpy = pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from rclpy.context import Context  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from ros_bench import Bench, cloud  # noqa: E402

from svc_ros.core.auto_preset import Choice, Outlook  # noqa: E402
from svc_ros.core.config import Config, preset, walk, with_values  # noqa: E402
from svc_ros.core.errors import ConfigError, MissingDependencyError  # noqa: E402
from svc_ros.core.result import Reason  # noqa: E402
from svc_ros.ros.parameters import OWN, NodeParameters, NodeSettings  # noqa: E402
from svc_ros.ros.processes import own_domain_id  # noqa: E402
from svc_ros.ros.streams.first_choice import FirstChoice  # noqa: E402
from svc_ros.ros.streams.worker import Cloud, DropJob, PairJob  # noqa: E402

pytestmark = pytest.mark.dds

LOCALIZATION = {"mode": "localization", "map_folder": "hall"}


@pytest.fixture
def make_node(monkeypatch):
    """make_node(name=value, ...) -> a node that was given these parameters from outside."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = Context()
    rclpy.init(context=context, domain_id=own_domain_id(5))
    nodes = []

    def make(overrides=None):
        given = [Parameter(name, value=value) for name, value in (overrides or {}).items()]
        nodes.append(Node("parameters", context=context, parameter_overrides=given))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    context.try_shutdown()


def test_every_field_of_the_config_is_a_described_parameter(make_node):
    node = make_node()
    NodeParameters(node)
    for info in walk(preset("lidar_outdoor")):
        assert node.get_parameter(info.name).value == info.default
        descriptor = node.describe_parameter(info.name)
        assert descriptor.description.startswith(info.description)
        assert info.unit in descriptor.description
        assert all(choice in descriptor.additional_constraints for choice in info.choices)


def test_ranges_have_a_step_of_zero(make_node):
    node = make_node()
    NodeParameters(node)
    (voxel,) = node.describe_parameter("preprocess.voxel_size_m").floating_point_range
    assert (voxel.from_value, voxel.to_value, voxel.step) == (0.005, 10.0, 0.0)
    (seeds,) = node.describe_parameter("hypotheses.max_seeds").integer_range
    assert (seeds.from_value, seeds.to_value, seeds.step) == (1, 100_000, 0)


@pytest.mark.parametrize("name", ["lidar_outdoor", "lidar_indoor", "rgbd_indoor"])
def test_preset_sets_the_defaults_of_all_others(make_node, name):
    parameters = NodeParameters(make_node({"preset": name}))
    assert parameters.config == preset(name)
    assert parameters.settings == NodeSettings()


def test_given_value_wins_over_the_preset(make_node):
    parameters = NodeParameters(make_node({"preset": "lidar_indoor", "preprocess.voxel_size_m": 0.4, "max_skew": 0.2}))
    assert parameters.config == with_values(preset("lidar_indoor"), {"preprocess.voxel_size_m": 0.4})
    assert parameters.settings.max_skew_ns == 200_000_000


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        ({"preset": "lidar_outdor"}, "did you mean 'lidar_outdoor'"),
        ({"odometry": "topics"}, "odometry: unknown name 'topics'; did you mean 'topic'"),
        ({"edges": "gtsam"}, "edges: unknown name 'gtsam'"),
        ({"mode": "loop_closure", "publish_tf": True}, "publish_tf: mode loop_closure"),
        ({"mode": "localization"}, "map_folder: mode localization needs the folder of a map"),
        ({"map_folder": "hall"}, "map_folder belongs to mode localization, found mode pair"),
        ({"publish_initialpose": True}, "publish_initialpose belongs to mode localization, found mode pair"),
        ({**LOCALIZATION, "told_by": "tfs"}, "told_by: unknown name 'tfs'"),
        ({**LOCALIZATION, "publish_tf": True}, "publish_tf: .* set odometry to topic or tf"),
        ({**LOCALIZATION, "publish_tf": True, "odometry": "tf", "told_by": "tf"}, "publish_tf and told_by:=tf exclude"),
        ({**LOCALIZATION, "publish_initialpose": True}, "publish_initialpose and told_by:=topic exclude"),
        ({**LOCALIZATION, "odom_frame": "map"}, "map_frame and odom_frame have to differ, found 'map' for both"),
        ({"graph_file": "loops.g2o"}, "graph_file and edges belong to mode loop_closure, found mode pair"),
        ({"mode": "pairs"}, "did you mean 'pair'"),
        ({"method": "scv"}, "did you mean 'svc'"),
        ({"preprocess.voxel_size_m": 1}, "preprocess.voxel_size_m: expected a float.*write 1.0"),
        ({"preprocess.voxel_size_m": 99.0}, "preprocess.voxel_size_m"),
        ({"preprocess.min_range_m": 500.0}, r"min_range_m \(500.0\) must be below max_range_m"),
        ({"process_every": "yes"}, "process_every: expected a bool"),
        ({"sensor_origin": [1.0]}, "sensor_origin: expected 3 numbers"),
        ({"matching.more_descriptors": "fpfh_wid"}, "matching.more_descriptors: .*did you mean 'fpfh_wide'"),
        ({"sensor_frame": "lidar", "sensor_origin": [0.0, 0.0, 1.0]}, "exclude each other"),
    ],
)
def test_refused_values_are_named(make_node, overrides, text):
    with pytest.raises(ConfigError, match=text):
        NodeParameters(make_node(overrides))


def test_change_is_checked_as_a_whole_and_then_taken(make_node):
    node = make_node()
    parameters = NodeParameters(node)
    together = [Parameter("preprocess.min_range_m", value=90.0), Parameter("preprocess.max_range_m", value=100.0)]
    refused = node.set_parameters_atomically(together[:1])
    assert not refused.successful
    assert "must be below max_range_m" in refused.reason
    assert parameters.config == Config()
    assert node.set_parameters_atomically(together).successful
    assert (parameters.config.preprocess.min_range_m, parameters.config.preprocess.max_range_m) == (90.0, 100.0)


def test_a_descriptor_that_cannot_be_used_is_refused_at_once(make_node, tmp_path, monkeypatch):
    write_package(tmp_path, "incomplete", "import not_installed_anywhere", incomplete="describe")
    monkeypatch.syspath_prepend(str(tmp_path))
    node = make_node()
    parameters = NodeParameters(node)
    for names, text in (("fpfh_wide, none", "unknown name 'none'"), ("incomplete", "not_installed_anywhere")):
        (result,) = node.set_parameters([Parameter("matching.more_descriptors", value=names)])
        assert not result.successful
        assert text in result.reason
    (result,) = node.set_parameters([Parameter("matching.more_descriptors", value="fpfh_wide")])
    assert result.successful
    assert parameters.config.matching.more_descriptors == "fpfh_wide"
    with pytest.raises(MissingDependencyError, match="not_installed_anywhere"):
        NodeParameters(make_node({"matching.more_descriptors": "incomplete"}))


def test_frozen_parameters_cannot_be_changed(make_node):
    node = make_node()
    NodeParameters(node)
    for name, value in (("preset", "lidar_indoor"), ("mode", "pair"), ("publish_tf", True)):
        (result,) = node.set_parameters([Parameter(name, value=value)])
        assert not result.successful
        assert name in result.reason


def test_misspelt_parameter_is_reported_with_the_nearest_name(make_node):
    given = {"preprocess.voxel_size": 0.4, "use_sim_time": False, "qos_overrides./x.subscription.depth": 3}
    parameters = NodeParameters(make_node(given))
    assert parameters.unknown_overrides() == [
        "parameter preprocess.voxel_size does not exist; did you mean preprocess.voxel_size_m?"
    ]


def test_own_parameters_and_settings_are_the_same_names():
    assert {info.name for info in OWN} == set(NodeSettings.__dataclass_fields__)
    assert not {info.name for info in OWN} & {info.name for info in walk(Config())}


class TestAuto:
    ROOM = Choice("lidar_indoor", preset("lidar_indoor"), "near walls", Outlook(12.0, 0.0))

    def test_what_nobody_has_set_follows_the_choice(self, make_node):
        node = make_node({"preset": "auto", "preprocess.voxel_size_m": 0.4, "method": "sc2"})
        parameters = NodeParameters(node)
        assert parameters.awaits_choice
        assert parameters.config == with_values(Config(), {"preprocess.voxel_size_m": 0.4, "method": "sc2"})
        node.set_parameters([Parameter("sight_view.tolerance_m", value=0.55)])
        parameters.take(self.ROOM)
        given = {"preprocess.voxel_size_m": 0.4, "method": "sc2", "sight_view.tolerance_m": 0.55}
        assert parameters.config == with_values(preset("lidar_indoor"), given)
        assert node.get_parameter("preprocess.max_range_m").value == 60.0  # as others see it
        assert (parameters.preset_name, parameters.choice, parameters.awaits_choice) == ("auto", self.ROOM, False)

    def test_a_choice_that_does_not_go_with_what_was_set_changes_nothing(self, make_node):
        parameters = NodeParameters(make_node({"preset": "auto", "preprocess.min_range_m": 70.0}))
        before = parameters.config
        with pytest.raises(ConfigError, match=r"preset auto chose lidar_indoor: .*min_range_m"):
            parameters.take(self.ROOM)
        assert (parameters.config, parameters.awaits_choice) == (before, True)

    def test_a_named_preset_waits_for_nothing(self, make_node):
        assert not NodeParameters(make_node({"preset": "lidar_outdoor"})).awaits_choice


class Waiting:
    """Parameters of preset auto that note what was chosen."""

    def __init__(self):
        self.taken = []

    @property
    def awaits_choice(self):
        return not self.taken

    def take(self, choice):
        self.taken.append(choice)


def job_of(source, target):
    """A pair of clouds as it waits for the worker."""
    return PairJob(Cloud(source, 1, 0.0), Cloud(target, 1, 0.0))


def test_the_first_clouds_that_can_be_read_choose_once_and_are_told_once():
    parameters, said = Waiting(), []
    first = FirstChoice(parameters, lambda _frame, _stamp: np.zeros(3), said.append)
    room, broken, none = cloud(scan_room(POSES[0]), 1.0), cloud(np.ones((5, 3)), 1.0), cloud(np.zeros((0, 3)), 1.0)
    broken.point_step = 7
    first.settle(DropJob(None, None, Reason.STALE, ""))
    first.settle(job_of(broken, none))
    assert (parameters.taken, said) == ([], [])
    first.settle(job_of(broken, room))
    first.settle(job_of(room, room))
    assert [choice.preset for choice in parameters.taken] == ["lidar_indoor"]
    assert len(said) == 1
    assert said[0].startswith("preset auto: lidar_indoor, 98 % of the points")


def test_the_node_chooses_by_its_first_pair_and_says_so_once(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    scans = [scan_room(T, seed=k) for k, T in enumerate(POSES)]
    with Bench(tmp_path, own_domain_id(98), {"preset": "auto", "process_every": "true"}) as bench:
        decisions = [bench.decide(cloud(scans[1], k), cloud(scans[0], k)) for k in (1.0, 2.0)]
        status = bench.status()
        told = bench.process.output()
    assert [decision["verdict"] for decision in decisions] == ["accepted", "accepted"]
    assert (status["preset"], status["chosen"]["preset"]) == ("auto", "lidar_indoor")
    assert told.count("preset auto: lidar_indoor, 98 % of the points") == 1


def test_a_map_takes_the_place_of_the_preset_but_for_what_was_set(make_node):
    made_with = with_values(preset("lidar_indoor"), {"preprocess.voxel_size_m": 0.2, "localization.max_similar": 7})
    parameters = NodeParameters(make_node({"localization.max_neighbours": 2}))
    parameters.take_map(made_with)
    assert parameters.config == with_values(made_with, {"localization.max_neighbours": 2})
    assert parameters.preset_name == "map"
    other = with_values(made_with, {"preprocess.voxel_size_m": 0.4})
    parameters.take_map(other)  # made anew before the node is configured again
    assert parameters.config == with_values(other, {"localization.max_neighbours": 2})
    NodeParameters(make_node({"preset": "lidar_indoor"})).take_map(preset("lidar_indoor"))
    NodeParameters(make_node({"preset": "auto"})).take_map(made_with)
    NodeParameters(make_node({"preprocess.voxel_size_m": 0.2})).take_map(made_with)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"preset": "lidar_outdoor"}, "preprocess.min_range_m: expected 0.5, .* found 1.0 by preset lidar_outdoor$"),
        ({"features.max_neighbours": 99}, "features.max_neighbours: expected 400, .* found 99$"),
    ],
)
def test_a_value_that_the_map_was_not_made_with_is_refused_by_name(make_node, given, text):
    parameters = NodeParameters(make_node(given))
    with pytest.raises(ConfigError, match=text):
        parameters.take_map(preset("lidar_indoor"))
