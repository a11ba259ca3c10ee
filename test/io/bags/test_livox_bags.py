"""Livox' own message in bags of both generations of ROS and of its driver, with and without its definition."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_recorder import START, Recorder, S, record
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.bags import Bag, TopicInfo
from svc_ros.io.clouds.livox import LIVOX_DEFINITIONS

POINTS = np.array([[1.0, 2.0, 3.0], [-4.0, 5.5, 6.25], [7.0, -8.0, 9.0]], np.float32)
TIMES_NS = [0, 250_000, 99_000_000]
DRIVERS = ("livox_ros_driver", "livox_ros_driver2")
OWN_POINT = "float64 x\nfloat64 y\nfloat64 z\nuint32 offset_time\nuint8 ring\nuint8[2] rest\n"


def livox_bag(path: Path, storage: str, driver: str, point: str = "", leave_out: str = "") -> Path:
    """Two messages on /livox/lidar; point: another definition of a point than the driver's."""

    def fill(recorder: Recorder) -> None:
        definitions = {name: text for name, text in LIVOX_DEFINITIONS.items() if name.startswith(f"{driver}/")}
        if point:
            definitions[f"{driver}/msg/CustomPoint"] = point.replace(f"float64 {leave_out}\n", "")
            recorder.store = get_typestore(Stores.ROS1_NOETIC if recorder.ros1 else Stores.ROS2_JAZZY)
        for name, text in definitions.items():
            recorder.store.register(get_types_from_msg(text, name))
        for k in range(2):
            values = [
                {"offset_time": t, "x": float(x), "y": float(y), "z": float(z)}
                for t, (x, y, z) in zip(TIMES_NS, POINTS + k, strict=True)
            ]
            rest: dict[str, Any] = {"ring": 1, "rest": np.zeros(2, np.uint8)} if point else dict.fromkeys(
                ("reflectivity", "tag", "line"), 3)  # fmt: skip
            values = [{name: value for name, value in row.items() if name != leave_out} for row in values]
            points = [recorder.make(f"{driver}/msg/CustomPoint", **value, **rest) for value in values]
            message = recorder.make(
                f"{driver}/msg/CustomMsg", header=recorder.header(START + k * S, "livox"), timebase=START + k * S,
                point_num=len(points), lidar_id=1, rsvd=np.zeros(3, np.uint8), points=points,
            )  # fmt: skip
            recorder.write("/livox/lidar", f"{driver}/msg/CustomMsg", START + k * S, message)

    return record(path, storage, fill)


def assert_reads(path: Path, driver: str) -> None:
    with Bag(path) as bag:
        assert bag.cloud_topics == [TopicInfo("/livox/lidar", f"{driver}/msg/CustomMsg", 2)]
        assert bag.resolve_cloud_topic() == bag.resolve_cloud_topic("livox/lidar") == "/livox/lidar"
        readings = list(bag.scans())
        assert bag.damage == []
    for k, reading in enumerate(readings):
        np.testing.assert_array_equal(reading.scan.points, POINTS + k)
        assert reading.scan.point_times_s is not None
        np.testing.assert_allclose(reading.scan.point_times_s, np.array(TIMES_NS) * 1e-9, rtol=0, atol=1e-15)
        assert (reading.scan.stamp_ns, reading.scan.frame_id) == (START + k * S, "livox")
    assert len(readings) == 2


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize("storage", ["mcap", "db3", "mcap_message_zstd", "ros1", "ros1_lz4"])
def test_points_and_their_times(tmp_path: Path, storage: str, driver: str) -> None:
    assert_reads(livox_bag(tmp_path / "drive", storage, driver), driver)


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_bag_without_definitions(tmp_path: Path, driver: str) -> None:
    path = livox_bag(tmp_path / "drive", "db3", driver)
    with sqlite3.connect(path / "drive.db3") as database:
        database.execute("DROP TABLE message_definitions")
        database.execute("DROP TABLE schema")
    assert_reads(path, driver)


@pytest.mark.parametrize("storage", ["mcap", "ros1"])
def test_the_definition_in_the_bag_wins(tmp_path: Path, storage: str) -> None:
    assert_reads(livox_bag(tmp_path / "drive", storage, DRIVERS[1], OWN_POINT), DRIVERS[1])


def test_a_definition_without_coordinates_is_refused_cloud_by_cloud(tmp_path: Path) -> None:
    path = livox_bag(tmp_path / "drive", "mcap", DRIVERS[1], OWN_POINT, leave_out="z")
    with Bag(path) as bag, pytest.raises(UnsupportedCloudError, match=r"drive: /livox/lidar, cloud 0: .*'z'"):
        list(bag.scans())
