"""Plays a bag as pairs: scan k as target, scan k + stride as source, each pair at once; or as the scans of one stream.

Clouds go out as they were recorded, with one exception: the target carries the source's stamp, because a node pairs by
stamp. The publishers are reliable; the node's inputs are not unless its `qos_overrides` say so.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from array import array
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from itertools import islice
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import PointCloud2, PointField

from svc_ros.core.errors import InputError, SvcError
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.ros.collector import DecisionCollector, spin_until
from svc_ros.ros.middleware import profile_environment
from svc_ros.ros.topics.conversions import header

_DECISION_TIMEOUT_S = 60.0


def pairs_from_clouds(clouds: Iterable[Any], stride: int) -> Iterator[tuple[PointCloud2, PointCloud2]]:
    """Yield (source, target): cloud k + stride and cloud k, both with the source's stamp."""
    waiting: deque[PointCloud2] = deque()
    for cloud in map(ros_cloud, clouds):
        waiting.append(cloud)
        if len(waiting) > stride:
            yield cloud, with_stamp_of(waiting.popleft(), cloud)


def ros_cloud(message: Any) -> PointCloud2:
    """A recorded PointCloud2 (any class with its attributes) as rclpy's own, byte for byte."""
    data = array("B")
    data.frombytes(memoryview(message.data).cast("B"))
    return PointCloud2(
        header=header(ns_from_stamp(message.header.stamp), str(message.header.frame_id)),
        height=int(message.height),
        width=int(message.width),
        fields=[
            PointField(name=str(f.name), offset=int(f.offset), datatype=int(f.datatype), count=int(f.count))
            for f in message.fields
        ],
        is_bigendian=bool(message.is_bigendian),
        point_step=int(message.point_step),
        row_step=int(message.row_step),
        data=data,
        is_dense=bool(message.is_dense),
    )


def with_stamp_of(cloud: PointCloud2, other: PointCloud2) -> PointCloud2:
    """The cloud with another one's stamp; the data are shared, the given cloud keeps its own stamp."""
    fields = {name: getattr(cloud, name) for name in cloud.get_fields_and_field_types() if name != "header"}
    return PointCloud2(header=header(ns_from_stamp(other.header.stamp), cloud.header.frame_id), **fields)


class CloudPlayer:
    """Publishes clouds on some topics, reliably."""

    def __init__(self, node: Node, executor: SingleThreadedExecutor, *topics: str) -> None:
        self._node, self._executor = node, executor
        self._publishers = [node.create_publisher(PointCloud2, topic, QoSProfile(depth=10)) for topic in topics]

    def wait_for_subscribers(self, timeout_s: float) -> bool:
        """Wait until somebody listens on all topics."""
        return spin_until(self._executor, lambda: all(p.get_subscription_count() for p in self._publishers), timeout_s)

    def publish(self, *clouds: PointCloud2) -> None:
        """Send one cloud a topic, the last topic's first."""
        for publisher, cloud in reversed(list(zip(self._publishers, clouds, strict=True))):
            publisher.publish(cloud)

    def finish(self, timeout_s: float) -> None:
        """Wait until the subscribers have everything."""
        for publisher in self._publishers:
            publisher.wait_for_all_acked(Duration(seconds=timeout_s))

    def destroy(self) -> None:
        """Give the publishers back."""
        for publisher in self._publishers:
            self._node.destroy_publisher(publisher)


def main(args: list[str] | None = None) -> int:
    """Play a bag. Exit code 0 when all was played, 1 without subscribers or decisions, 2 on bad input."""
    options = _parser().parse_args(remove_ros_args(args)[1:] if args is None else remove_ros_args(args))
    os.environ.update(profile_environment())
    rclpy.init(args=args)
    try:
        return _play(options)
    except SvcError as error:
        print(f"bag_player: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    finally:
        rclpy.try_shutdown()


def _play(options: argparse.Namespace) -> int:
    node, executor = rclpy.create_node("svc_bag_player"), SingleThreadedExecutor()
    executor.add_node(node)
    collector = DecisionCollector(node, executor, options.node_name) if options.wait_decisions else None
    topics = [options.points_topic] if options.scans else [options.source_topic, options.target_topic]
    player = CloudPlayer(node, executor, *topics)
    with contextlib.closing(_recorded(options)) as items:
        first = next(items, None)  # a bag that cannot be played is refused before anyone waits
        if first is None:
            raise InputError(f"{options.bag}: expected more than {options.stride} clouds for stride {options.stride}")
        if not player.wait_for_subscribers(options.wait_for_subscribers):
            return _fail(f"nobody subscribed to {' and '.join(topics)} in {options.wait_for_subscribers:g} s")
        num_played = 0
        for num_played, clouds in enumerate(_paced(first, items, options.rate), 1):
            player.publish(*clouds)
            stamp_ns = ns_from_stamp(clouds[0].header.stamp)
            if collector and not collector.wait_for_decision_on(stamp_ns, _DECISION_TIMEOUT_S):
                return _fail(f"no decision on number {num_played} in {_DECISION_TIMEOUT_S:g} s")
        player.finish(5.0)
    print(f"bag_player: {num_played} {'scans' if options.scans else 'pairs'} played")
    return 0


def _recorded(options: argparse.Namespace) -> Generator[tuple[PointCloud2, ...], None, None]:
    """What is published at once, in the order of the topics."""
    from svc_ros.io.bags import Bag

    with Bag(options.bag, options.strict) as bag:
        topic = bag.resolve_cloud_topic(options.topic)
        clouds = (message for _, message in bag.raw_clouds(topic))
        if options.scans:
            yield from islice(((ros_cloud(message),) for message in clouds), options.limit)
        else:
            yield from islice(pairs_from_clouds(clouds, options.stride), options.limit)
        for damage in bag.damage:
            print(f"bag_player: warning: {damage}", file=sys.stderr)


def _paced(first: Any, rest: Iterator[Any], rate_hz: float) -> Iterator[Any]:
    """Yield at most `rate_hz` items a second; 0: as fast as they are taken."""
    start, period = time.monotonic(), 1.0 / rate_hz if rate_hz else 0.0
    yield first
    for number, item in enumerate(rest, 1):
        time.sleep(max(0.0, start + number * period - time.monotonic()))
        yield item


def _fail(text: str) -> int:
    print(f"bag_player: {text}", file=sys.stderr)
    return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("bag_player", description="Play a bag's clouds to the registration node.")
    parser.add_argument("bag", help="ROS 1 or ROS 2 bag")
    parser.add_argument("--topic", help="PointCloud2 topic; may be left out if the bag has only one")
    parser.add_argument("--strict", action="store_true", help="refuse a damaged bag; else its intact part is played")
    parser.add_argument("--scans", action="store_true", help="play single scans, for scan_matching and loop_closure")
    parser.add_argument("--stride", type=_positive, default=1, help="scan k + stride is registered to scan k")
    parser.add_argument("--rate", type=_not_negative, default=1.0, help="pairs or scans a second; 0: no pause")
    parser.add_argument("--limit", type=_positive, help="play so many of them at most")
    parser.add_argument("--source-topic", default="/source_points")
    parser.add_argument("--target-topic", default="/target_points")
    parser.add_argument("--points-topic", default="/points", help="of --scans")
    parser.add_argument("--wait-for-subscribers", type=_not_negative, default=10.0, metavar="S")
    parser.add_argument(
        "--wait-decisions", action="store_true", help="send the next when the last one has its decision"
    )
    parser.add_argument("--node-name", default="/svc_registration", help="the node whose decisions are waited for")
    return parser


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1, found {text}")
    return value


def _not_negative(text: str) -> float:
    value = float(text)
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected a number from 0, found {text}")
    return value


if __name__ == "__main__":
    sys.exit(main())
