"""Publishers and subscriptions of the node are destroyed at the worst moments of an executor that waits for them."""

from __future__ import annotations

import contextlib
import signal

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from rclpy.event_handler import PublisherEventCallbacks  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from rclpy.waitable import NumberOfEntities, Waitable  # noqa: E402
from ros_bench import Host  # noqa: E402
from std_msgs.msg import Bool  # noqa: E402
from yardstick import PATIENCE_S  # noqa: E402

from svc_ros.ros.collector import spin_until  # noqa: E402
from svc_ros.ros.node import _spin, _Stop  # noqa: E402
from svc_ros.ros.processes import own_domain_id  # noqa: E402
from svc_ros.ros.registration_node import RegistrationNode  # noqa: E402

pytestmark = pytest.mark.dds

BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def host(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with contextlib.closing(Host(own_domain_id(63))) as host:
        yield host


class OtherThread(Waitable):
    """Acts as another thread may: after the executor has gathered what it waits for, while it enters one by one."""

    def __init__(self, node: Node, act) -> None:
        super().__init__(node.default_callback_group)
        self.act = act

    def __enter__(self) -> None:
        self.act()

    def __exit__(self, *_exception: object) -> None:
        pass

    def get_num_entities(self) -> NumberOfEntities:
        return NumberOfEntities()

    def add_to_wait_set(self, wait_set) -> None:
        pass

    def is_ready(self, wait_set) -> bool:
        return False


@pytest.mark.parametrize("order", ["before it is entered", "after it is entered"])
@pytest.mark.parametrize("kind", ["publisher", "subscription"])
def test_what_is_destroyed_while_the_executor_prepares_to_wait_does_not_end_it(host, kind, order):
    node, given_back = host.start(autostart=False), []
    other = OtherThread(node, lambda: given_back.append(destroy(thing)) if not given_back else None)
    if order == "before it is entered":
        node.add_waitable(other)
    if kind == "publisher":
        thing, destroy = node.create_publisher(Bool, "thing", 1), node.destroy_publisher
    else:
        thing, destroy = node.create_subscription(Bool, "thing", lambda _message: None, 1), node.destroy_subscription
    assert len(thing.event_handlers) > 0
    if order == "after it is entered":
        node.add_waitable(other)
    assert spin_until(host.executor, lambda: given_back, PATIENCE_S)
    assert given_back == [True]
    assert host.state() == "unconfigured"  # it is spun, and answers


@pytest.mark.parametrize("is_destroyed", [False, True], ids=["stays", "destroyed"])
def test_an_event_is_told_unless_its_publisher_is_destroyed_between_event_and_callback(host, is_destroyed):
    node, told = host.start(autostart=False), []
    callbacks = PublisherEventCallbacks(incompatible_qos=told.append)
    publisher = node.create_publisher(Bool, "/thing", BEST_EFFORT, event_callbacks=callbacks)
    host.node.create_subscription(Bool, "/thing", lambda _message: None, QoSProfile(depth=1))
    while True:  # everything else is executed as it comes
        handler, entity, _node = host.executor.wait_for_ready_callbacks(timeout_sec=30.0)
        if entity in publisher.event_handlers:
            break
        handler()
    if is_destroyed:
        node.destroy_publisher(publisher)
    handler()
    assert handler.exception() is None
    assert len(told) == (0 if is_destroyed else 1)


def test_a_shutdown_while_the_executor_prepares_to_wait_ends_the_program_in_good_order(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init(domain_id=own_domain_id(62))
    try:
        node = RegistrationNode(parameter_overrides=[Parameter("autostart", value=False)])
        node.add_waitable(OtherThread(node, rclpy.try_shutdown))
        assert _spin(node, _Stop()) == 0
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        rclpy.try_shutdown()


def test_configuration_and_cleanup_leave_the_timers_alone(host):
    node = host.start(autostart=False)
    timers = list(node.timers)
    assert timers
    node.trigger_configure()
    assert list(node.timers) == timers
    node.trigger_cleanup()
    assert list(node.timers) == timers
