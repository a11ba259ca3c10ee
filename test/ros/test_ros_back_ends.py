"""Loops for rtabmap and pose_graph_tools, whose packages stand in as plain classes: what is sent, and when."""

from __future__ import annotations

import dataclasses
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from svc_ros.core.errors import MissingDependencyError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.se3 import make_pose
from svc_ros.ros.streams.decision import Decision
from svc_ros.ros.streams.worker import CloudLabel
from svc_ros.ros.topics.back_ends import edge_output
from svc_ros.ros.topics.conversions import header

pytestmark = pytest.mark.dds

SECOND = 1_000_000_000
T = make_pose(np.eye(3), (1.0, 2.0, 3.0))


class StandInNode:
    """Keeps what is sent; `is_ready`: rtabmap's service is there."""

    def __init__(self) -> None:
        self.sent, self.warnings, self.on_info, self.is_ready = [], [], None, True

    def create_publisher(self, _kind, topic, _qos):
        return SimpleNamespace(publish=lambda message: self.sent.append((topic, message)))

    def create_subscription(self, _kind, topic, callback, _qos):
        assert topic == "rtabmap/info"
        self.on_info = callback

    def create_client(self, _kind, name):
        return SimpleNamespace(
            call_async=lambda request: self.sent.append((name, request.link)), service_is_ready=lambda: self.is_ready
        )

    def get_logger(self):
        return SimpleNamespace(warning=self.warnings.append)


class Message(SimpleNamespace):
    """A message of a package that is not installed."""


@pytest.fixture
def packages(monkeypatch):
    def module(name, **content):
        stand_in = ModuleType(name)
        vars(stand_in).update(content)
        monkeypatch.setitem(sys.modules, name, stand_in)

    module("pose_graph_tools_msgs")
    module("pose_graph_tools_msgs.msg", PoseGraphEdge=Message)
    module("rtabmap_msgs")
    module("rtabmap_msgs.msg", Info=Message, Link=Message)
    module("rtabmap_msgs.srv", AddLink=SimpleNamespace(Request=Message))


def loop(verdict=Verdict.ACCEPTED, vertices=(7, 3)):
    is_accepted = verdict is Verdict.ACCEPTED
    result = RegistrationResult(
        verdict, Reason.OK if is_accepted else Reason.LOW_OVERLAP, "svc", T if is_accepted else None, T,
        0.04 * np.eye(6) if is_accepted else None,
    )  # fmt: skip
    labels = CloudLabel(70 * SECOND, "lidar"), CloudLabel(30 * SECOND, "lidar")
    return Decision(result, *labels, vertices=vertices)


@pytest.mark.parametrize("name", ["rtabmap", "pose_graph_tools"])
def test_a_back_end_without_its_package_says_what_to_install(name, monkeypatch):
    monkeypatch.setitem(sys.modules, "rtabmap_msgs.msg", None)
    monkeypatch.setitem(sys.modules, "pose_graph_tools_msgs.msg", None)
    with pytest.raises(MissingDependencyError, match=f"edges:={name} needs .*_msgs"):
        edge_output(StandInNode(), name)


def test_no_back_end_is_no_output():
    assert edge_output(StandInNode(), "none") is None


@pytest.mark.usefixtures("packages")
@pytest.mark.parametrize(("verdict", "kind"), [(Verdict.ACCEPTED, 1), (Verdict.REJECTED, 3), (Verdict.UNDECIDED, 3)])
def test_every_judged_loop_is_an_edge_from_target_to_source(verdict, kind):
    node = StandInNode()
    edge_output(node, "pose_graph_tools").publish(loop(verdict))
    ((topic, edge),) = node.sent
    assert topic == "~/edges"
    assert (edge.key_from, edge.key_to, edge.type) == (3, 7, kind)
    assert (edge.pose.position.x, edge.pose.position.y, edge.pose.position.z) == (1.0, 2.0, 3.0)
    assert edge.covariance.shape == (36,)
    assert edge.header == header(70 * SECOND, "lidar")


@pytest.mark.usefixtures("packages")
def test_a_pair_that_is_not_in_the_graph_is_no_edge():
    node = StandInNode()
    edge_output(node, "pose_graph_tools").publish(loop(vertices=None))
    assert node.sent == []


@pytest.mark.usefixtures("packages")
def test_an_accepted_loop_is_a_link_between_the_nodes_that_rtabmap_made_of_both_scans():
    node = StandInNode()
    output = edge_output(node, "rtabmap")
    for number, stamp_ns in ((11, 30 * SECOND + 200), (12, 50 * SECOND), (13, 70 * SECOND)):
        node.on_info(Message(header=header(stamp_ns, "lidar"), ref_id=number))
    output.publish(loop(Verdict.REJECTED))
    output.publish(loop())
    ((name, link),) = node.sent
    assert name == "rtabmap/add_link"
    assert (link.from_id, link.to_id) == (11, 13)
    assert link.transform.translation.y == 2.0
    np.testing.assert_allclose(link.information.reshape(6, 6), 25.0 * np.eye(6))


@pytest.mark.usefixtures("packages")
def test_a_pair_with_one_stamp_is_no_link():
    node = StandInNode()
    output = edge_output(node, "rtabmap")
    node.on_info(Message(header=header(30 * SECOND, "lidar"), ref_id=11))
    label = CloudLabel(30 * SECOND, "lidar")
    output.publish(dataclasses.replace(loop(), source=label, target=label))
    assert node.sent == []
    assert len(node.warnings) == 1


@pytest.mark.usefixtures("packages")
@pytest.mark.parametrize("is_ready", [True, False])
def test_a_loop_that_rtabmap_cannot_take_is_said_and_left_out(is_ready):
    node = StandInNode()
    output = edge_output(node, "rtabmap")
    node.is_ready = is_ready
    node.on_info(Message(header=header((30 if is_ready else 70) * SECOND, "lidar"), ref_id=1))
    output.publish(loop())
    assert node.sent == []
    assert "30.000000000 s and 70.000000000 s" in node.warnings[0]
