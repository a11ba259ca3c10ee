"""What launch files find where nothing is named: by rule, in bags, and in a system that really runs."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from bag_recorder import START, Recorder, S, points_of, record
from launch_stand_ins import Graph, load, said, started
from places import PROJECT_ROOT

from svc_ros.core.errors import InputError
from svc_ros.ros.discovery.choice import choose_base, choose_points, cloud_topics, describe_pair
from svc_ros.ros.discovery.inputs import find_in_bag

REGISTRATION = PROJECT_ROOT / "launch" / "registration.launch.py"
REPLAY = PROJECT_ROOT / "launch" / "replay.launch.py"
CLOUD, IMAGE = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image"


def test_clouds_that_somebody_else_publishes_are_candidates():
    seen = [
        ("/b/points", [CLOUD], 2), ("/a", [IMAGE, CLOUD], 1), ("/image", [IMAGE], 1), ("/gone", [CLOUD], 0),
        ("/svc_registration/aligned", [CLOUD], 1), ("/robot/svc_registration/blocked_points", [CLOUD], 1),
    ]  # fmt: skip
    assert cloud_topics(seen) == ["/a", "/b/points"]


@pytest.mark.parametrize(
    ("clouds", "name", "words"),
    [
        (["/lidar"], "/lidar", "the only clouds"),
        (["/lidar", "/points"], "/points", "the usual name"),
        ([], "/points", "no clouds on the graph yet"),
    ],
)
def test_the_usual_name_wins_then_the_only_one(clouds, name, words):
    choice = choose_points(clouds, "/points", "on the graph", "points")
    assert choice.name == name
    assert choice.why.startswith(f"points:={name} (")
    assert words in choice.why


def test_livox_own_message_is_a_cloud_too():
    assert cloud_topics([("/livox/lidar", ["livox_ros_driver2/msg/CustomMsg"], 1)]) == ["/livox/lidar"]


def test_of_several_none_is_guessed_and_the_lines_to_write_are_told():
    with pytest.raises(InputError) as error:
        choose_points(["/front", "/rear"], "/points", "on the graph", "points")
    assert str(error.value).splitlines()[1:] == ["  points:=/front", "  points:=/rear"]


def test_a_pair_is_not_guessed_but_told():
    names = {"source": "/source_points", "target": "/target_points"}
    plain = "source:=/source_points target:=/target_points"
    assert describe_pair([], names) == describe_pair([*names.values(), "/other"], names) == plain
    assert describe_pair(["/front", "/rear"], names).endswith("others, of which there are /front, /rear)")


@pytest.mark.parametrize(
    ("frame", "parents", "is_found"),
    [
        ("lidar", {"lidar": "mast", "mast": "base_link"}, True),
        ("lidar", {"lidar": "base_footprint", "base_link": "base_footprint"}, True),
        ("lidar", {"lidar": "mast"}, False),
        ("lidar", {"lidar": "mast", "mast": "lidar"}, False),
        ("base_link", {"lidar": "base_link"}, False),  # it is what the clouds are in
        ("lidar", {}, False),
    ],
)
def test_the_base_is_taken_where_the_clouds_frame_is_fixed_to_it(frame, parents, is_found):
    assert (choose_base(frame, parents) is not None) == is_found


def graph_with(*topics: str, **parents: str) -> type[Graph]:
    return type("Seen", (Graph,), {"topics": topics, "parents": parents})


def remapped(module, **given: str) -> dict[str, str]:
    (node,) = started(module, **given)
    return dict(node.options["remappings"])


@pytest.mark.parametrize("mode", ["scan_matching", "loop_closure"])
def test_a_stream_takes_the_only_clouds_and_what_is_given_wins(monkeypatch, mode):
    module = load(REGISTRATION, monkeypatch, graph_with("/ouster/points"))
    assert remapped(module, mode=mode)["points"] == "/ouster/points"
    assert said(module, mode=mode) == ["found: points:=/ouster/points (the only clouds on the graph)"]
    assert remapped(module, mode=mode, points="/mine")["points"] == "/mine"
    assert said(module, mode=mode, points="/mine") == []


def test_found_topics_are_asked_for_reliably_and_shown(monkeypatch):
    module = load(REGISTRATION, monkeypatch, graph_with("/ouster/points"))
    node, rviz = started(module, mode="scan_matching", reliable="true", rviz="true")
    assert node.options["parameters"][0]["qos_overrides./ouster/points.subscription.reliability"] == "reliable"
    assert dict(rviz.options["remappings"])["/points"] == "/ouster/points"


def test_a_namespace_has_its_own_usual_name(monkeypatch):
    module = load(REGISTRATION, monkeypatch, graph_with("/other", "/robot/points"))
    assert remapped(module, mode="scan_matching", namespace="robot")["points"] == "points"
    assert "points:=/robot/points" in said(module, mode="scan_matching", namespace="robot")[0]


def test_topics_of_pairs_are_no_stream(monkeypatch):
    module = load(REGISTRATION, monkeypatch, graph_with("/source_points", "/target_points"))
    assert remapped(module, mode="loop_closure")["points"] == "points"
    assert "there are no clouds on the graph yet" in said(module, mode="loop_closure")[0]


def test_where_no_cloud_tells_its_frame_the_base_is_left_alone_and_that_is_said(monkeypatch):
    module = load(REGISTRATION, monkeypatch, graph_with())
    (node,) = started(module, mode="scan_matching", publish_tf="true")
    assert "base_frame" not in node.options["parameters"][0]
    told = said(module, mode="scan_matching", publish_tf="true")[1]
    assert told == "found: base_frame stays the clouds' own: no cloud came on /points to tell which that is"


def test_several_streams_stop_the_launch(monkeypatch):
    module = load(REGISTRATION, monkeypatch, graph_with("/front", "/rear"))
    with pytest.raises(InputError, match="name one of them"):
        started(module, mode="scan_matching")
    assert remapped(module, mode="pair")["source_points"] == "source_points"
    assert "/front, /rear" in said(module, mode="pair")[0]


def test_with_publish_tf_the_base_is_found_so_that_no_frame_has_two_parents(monkeypatch):
    module = load(REGISTRATION, monkeypatch, graph_with("/lidar/points", lidar="base_link"))
    (node,) = started(module, mode="scan_matching", publish_tf="true")
    assert node.options["parameters"][0]["base_frame"] == "base_link"
    assert "base_frame:=base_link" in said(module, mode="scan_matching", publish_tf="true")[1]
    for given in ({}, {"publish_tf": "true", "base_frame": "lidar"}):
        (node,) = started(module, mode="scan_matching", **given)
        assert node.options["parameters"][0].get("base_frame", "") == given.get("base_frame", "")


def drive(*topics: str):
    """Fills a bag with a cloud a topic, and the mount of the sensor."""

    def fill(recorder: Recorder) -> None:
        recorder.transform("/tf_static", START, ("base_link", "lidar"), (0, 0, 1.5, 0, 0, 0, 1))
        for k, topic in enumerate(topics):
            recorder.cloud(topic, START + k * S, points_of(k))

    return fill


def wanted(bag, **given: str) -> dict[str, str]:
    return {"bag": str(bag), "mode": "scan_matching", "topic": "", "publish_tf": "", "base_frame": "", **given}


def test_a_bag_tells_its_only_clouds_and_the_base(tmp_path):
    bag = record(tmp_path / "drive", "mcap", drive("/os/points"))
    values, lines = find_in_bag(wanted(bag, publish_tf="true"))
    assert values == {"points": "/os/points", "base_frame": "base_link"}
    assert lines[0] == f"topic:=/os/points (the only clouds in {bag})"
    assert find_in_bag(wanted(bag, publish_tf="True"))[0] == values
    assert find_in_bag(wanted(bag))[0] == {"points": "/os/points"}
    assert find_in_bag(wanted(bag, publish_tf="true", base_frame="lidar"))[0] == {"points": "/os/points"}
    assert find_in_bag(wanted(bag, topic="/given", publish_tf="true"))[0] == {"points": "/given"}
    assert find_in_bag(wanted(bag, mode="pair"))[0] == {}


def test_a_bag_with_several_clouds_asks_for_one_and_one_that_cannot_be_read_is_left_to_its_player(tmp_path):
    bag = record(tmp_path / "drive", "mcap", drive("/front", "/rear"))
    with pytest.raises(InputError, match="topic:=/front"):
        find_in_bag(wanted(bag))
    values, lines = find_in_bag(wanted(tmp_path / "none", publish_tf="true"))
    assert values == {"points": "/points"}
    assert "the usual name" in lines[0]


def test_a_replay_by_ros2_gives_the_node_what_the_bag_has(tmp_path, monkeypatch):
    module = load(REPLAY, monkeypatch)
    bag = str(record(tmp_path / "drive", "mcap", drive("/os/points")))
    include, _ = started(module, bag=bag, mode="scan_matching", player="ros2", publish_tf="true")
    given = dict(include.options["launch_arguments"])
    assert (given["points"], given["base_frame"]) == ("/os/points", "base_link")
    assert len(said(module, bag=bag, mode="scan_matching", player="ros2", publish_tf="true")) == 2


@pytest.mark.dds
def test_a_running_system_is_seen_as_it_is(monkeypatch):
    rclpy = pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data
    from ros_bench import cloud
    from sensor_msgs.msg import Image, PointCloud2
    from yardstick import PATIENCE_S

    from svc_ros.ros.discovery.graph import Onlooker
    from svc_ros.ros.processes import own_domain_id

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain_id, context, is_over = own_domain_id(98), Context(), threading.Event()
    rclpy.init(context=context, domain_id=domain_id)
    driver = Node("driver", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(driver)
    driver.create_publisher(Image, "/image", 1)
    driver.create_publisher(PointCloud2, "/quiet", 1)
    points = driver.create_publisher(PointCloud2, "/lidar/points", qos_profile_sensor_data)
    driver.create_timer(0.05, lambda: points.publish(cloud(np.ones((5, 3)), 1.0, "os_sensor")))

    def drive() -> None:
        while not is_over.is_set():
            executor.spin_once(timeout_sec=0.1)

    driving = threading.Thread(target=drive)
    driving.start()
    try:
        with Onlooker(PATIENCE_S, domain_id) as onlooker:
            assert onlooker.clouds(lambda seen: len(seen) == 2) == ["/lidar/points", "/quiet"]
            assert onlooker.frame_of("/lidar/points") == "os_sensor"
        with Onlooker(0.3, domain_id) as onlooker:
            assert set(onlooker.clouds(lambda _seen: False)) <= {"/lidar/points", "/quiet"}
            assert onlooker.frame_of("/quiet") == ""
            assert onlooker.static_parents(lambda _known: False) == {}
    finally:
        is_over.set()
        driving.join()
        executor.shutdown(timeout_sec=1.0)
        driver.destroy_node()
        context.try_shutdown()
