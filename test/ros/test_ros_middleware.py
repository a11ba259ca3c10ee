"""Big clouds reach the node, best effort, as drivers send them; and where they do not, it says so."""

from __future__ import annotations

import os
import xml.etree.ElementTree as xml

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import qos_profile_sensor_data
from ros_bench import StreamBench, cloud
from sensor_msgs.msg import PointCloud2
from yardstick import PATIENCE_S

from svc_ros.ros import middleware
from svc_ros.ros.collector import spin_until
from svc_ros.ros.middleware import PROFILE_VARIABLE, SOCKET_BUFFER, cure, profile_path, receiving_transports
from svc_ros.ros.processes import own_domain_id

CHOICES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
# Transports as they are without any profile, asked for by the user.
PLAIN_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="plain" is_default_profile="true"><rtps/></participant>
</profiles>
"""


@pytest.fixture(autouse=True)
def nothing_chosen(monkeypatch, tmp_path):
    for name in CHOICES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.delenv("RMW_IMPLEMENTATION", raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.chdir(tmp_path)


def texts(path, tag: str) -> list[str]:
    return [node.text for node in xml.parse(path).iter() if node.tag.rpartition("}")[2] == tag]


def test_the_shipped_profile_has_room_for_clouds():
    assert [int(text) for text in texts(profile_path(), "segment_size")] == [64 * 1024 * 1024]
    assert {int(text) for text in texts(profile_path(), "receiveBufferSize")} == {SOCKET_BUFFER}
    assert texts(profile_path(), "defaultUnicastLocatorList") == []


@pytest.mark.parametrize(
    ("variable", "value", "is_local"),
    [
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST", True),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET", False),
        ("ROS_LOCALHOST_ONLY", "1", True),
        ("ROS_LOCALHOST_ONLY", "0", False),
    ],
)
def test_a_receiver_is_reached_by_udp_and_not_through_shared_memory(monkeypatch, variable, value, is_local):
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, value)
    with receiving_transports() as is_ours:
        assert is_ours
        path = os.environ[PROFILE_VARIABLE]
        used = [node.text for node in xml.parse(path).findall(".//{*}userTransports/{*}transport_id")]
        assert used == (["udp"] if is_local else ["udp", "tcp"])
        assert "SHM" not in texts(path, "type")
        assert len(texts(path, "udpv4")) == int(is_local)  # ROS adds shared memory there: its address is not told
    assert PROFILE_VARIABLE not in os.environ
    assert not os.path.exists(path)


@pytest.mark.parametrize(
    ("allowed", "wanted"), [(212_992, SOCKET_BUFFER), (10_000_000, 10_000_000), (2**31 - 1, 2**25)]
)
def test_a_receiver_takes_the_buffer_that_the_kernel_allows(monkeypatch, tmp_path, allowed, wanted):
    (tmp_path / "rmem_max").write_text(f"{allowed}\n")
    monkeypatch.setattr(middleware, "_LARGEST_BUFFER", tmp_path / "rmem_max")
    with receiving_transports():
        assert texts(os.environ[PROFILE_VARIABLE], "receiveBufferSize") == [str(wanted)]


@pytest.mark.parametrize("name", CHOICES)
def test_transports_that_the_user_has_chosen_are_left_alone(monkeypatch, name):
    monkeypatch.setenv(name, "/somewhere.xml")
    with receiving_transports() as is_ours:
        assert not is_ours
        assert os.environ[name] == "/somewhere.xml"
    assert middleware.profile_environment() == {}


def test_where_no_file_can_be_written_defaults_have_to_do(monkeypatch):
    monkeypatch.setattr(middleware.tempfile, "tempdir", "/nowhere/at/all")
    with receiving_transports() as is_ours:
        assert not is_ours
        assert PROFILE_VARIABLE not in os.environ


def test_a_profile_in_the_working_directory_is_a_choice_too(monkeypatch, tmp_path):
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text(PLAIN_PROFILE)
    with receiving_transports() as is_ours:
        assert not is_ours
    monkeypatch.setenv("SKIP_DEFAULT_XML_FILE", "1")  # Fast DDS does not read it then
    with receiving_transports() as is_ours:
        assert is_ours


def test_who_sends_gets_the_shipped_profile():
    assert middleware.profile_environment({"A": "b"}) == {PROFILE_VARIABLE: str(profile_path())}


def test_the_cure_is_the_profile_and_bigger_buffers_where_the_kernel_allows_small_ones_only(monkeypatch, tmp_path):
    allowed = tmp_path / "rmem_max"
    monkeypatch.setattr(middleware, "_LARGEST_BUFFER", allowed)
    profile = f"export {PROFILE_VARIABLE}={profile_path()} in the driver's terminal and in this node's"
    assert cure() == profile
    allowed.write_text("4194304\n")
    assert cure() == profile
    allowed.write_text("212992\n")
    assert cure() == f"sudo sysctl -w net.core.rmem_max=4194304 (it is 212992), or {profile}"
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    assert cure() == "sudo sysctl -w net.core.rmem_max=4194304 (it is 212992)"
    allowed.write_text("8388608\n")
    assert cure() == "docs/middleware.md says what rmw_cyclonedds_cpp needs"


class Driver:
    """Sends clouds of so many points to a node, as drivers do."""

    def __init__(self, bench: StreamBench, num_points: int) -> None:
        self._bench = bench
        self._publisher = bench.node.create_publisher(PointCloud2, "/points", qos_profile_sensor_data)
        assert spin_until(bench.executor, self._publisher.get_subscription_count, PATIENCE_S)
        self._points = np.random.default_rng(0).uniform(-20.0, 20.0, (num_points, 3))
        self._num_sent = 0
        bench.settle()  # by then the node knows of this publisher, too

    def send(self) -> None:
        self._num_sent += 1
        self._publisher.publish(cloud(self._points, 0.1 * self._num_sent))
        self._bench.pause(0.1)


@pytest.mark.dds
def test_no_big_cloud_is_lost_with_defaults_on_both_sides(tmp_path):
    largest = middleware.largest_socket_buffer()
    if largest is not None and largest < SOCKET_BUFFER:
        pytest.skip(f"the kernel allows sockets {largest} bytes, expected {SOCKET_BUFFER} (net.core.rmem_max)")
    settings = {
        "mode": "scan_matching",
        "method": "sc2",
        "qos_overrides./points.subscription.reliability": "best_effort",
    }
    with StreamBench(tmp_path, own_domain_id(61), settings) as bench:
        driver = Driver(bench, 130_000)
        for _ in range(30):
            driver.send()
        assert spin_until(bench.executor, lambda: len(bench.answers.decisions) >= 30, PATIENCE_S)
        status = bench.status()
    assert status["received"] == {"points": 30}
    assert status["lost"]["points"] == 0


@pytest.mark.dds
def test_losses_are_said_with_their_cure_in_diagnostics_and_once_in_the_log(tmp_path, monkeypatch):
    (tmp_path / "plain.xml").write_text(PLAIN_PROFILE)
    monkeypatch.setenv(PROFILE_VARIABLE, str(tmp_path / "plain.xml"))
    told: list[str] = []

    def on_diagnostics(message: DiagnosticArray) -> None:
        told.extend(s.message for s in message.status if s.name.endswith(": input") and s.level == s.WARN)

    settings = {"mode": "scan_matching", "qos_overrides./points.subscription.reliability": "best_effort"}
    with StreamBench(tmp_path, own_domain_id(62), settings) as bench:
        bench.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
        driver = Driver(bench, 400_000)
        for _ in range(600):
            driver.send()
            if sum(cure() in text for text in told) > 2:
                break
        log = bench.process.output()
        assert bench.status()["lost"]["points"] > 0
    losses = [text for text in told if cure() in text]
    assert len(losses) > 2, told
    assert losses[0].startswith("points: ")
    assert " lost in 3 s (" in losses[0]
    (line,) = [line for line in log.splitlines() if " lost in 3 s (" in line]
    assert line.endswith(f"before they reached this node; {cure()}")
