"""Which clouds of a bag are replayed, and what is known of each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_recorder import START, STORAGES, S, record, three_clouds
from replay_cases import MOUNTING, STAMPS, WAY, write_room_bag

from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.io.bags import Bag
from svc_ros.replay.clouds import BagPart, read_clouds


@pytest.fixture(scope="module")
def bag_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_room_bag(tmp_path_factory.mktemp("clouds") / "room")


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        (BagPart("/points"), range(7)),
        (BagPart("/points", start_s=0.2), range(2, 7)),
        (BagPart("/points", start_s=0.15), range(2, 7)),
        (BagPart("/points", duration_s=0.2), range(2)),  # the end does not belong to it, so that parts do not overlap
        (BagPart("/points", duration_s=0.21), range(3)),
        (BagPart("/points", start_s=0.2, duration_s=0.2), range(2, 4)),
        (BagPart("/points", start_s=0.6), [6]),
        (BagPart("/points", stride=3), [0, 3, 6]),
        (BagPart("/points", start_s=0.1, stride=2), [1, 3, 5]),
        (BagPart("/points", duration_s=1e6), range(7)),
    ],
)
def test_parts_of_a_bag(bag_path: Path, part: BagPart, expected: range | list[int]) -> None:
    with Bag(bag_path) as bag:
        clouds = list(read_clouds(bag, part))
    assert [cloud.stamp_ns for cloud in clouds] == [STAMPS[k] for k in expected]
    assert [cloud.index for cloud in clouds] == list(range(len(clouds)))
    assert all(cloud.scan is not None and cloud.read_ms > 0.0 for cloud in clouds)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"stride": 0}, "stride of at least 1, found 0"),
        ({"start_s": -1.0}, "start of at least 0 s"),
        ({"start_s": float("nan")}, "start of at least 0 s"),
        ({"duration_s": 0.0}, "duration above 0 s"),
    ],
)
def test_parts_that_are_none(values: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        BagPart("/points", **values)


def test_a_start_beyond_the_end_is_refused(bag_path: Path) -> None:
    with Bag(bag_path) as bag, pytest.raises(InputError, match=r"the bag has 0\.6 s, and is to start at 0\.7 s"):
        next(read_clouds(bag, BagPart("/points", start_s=0.7)))


@pytest.mark.parametrize("storage", STORAGES)
def test_every_kind_of_bag(tmp_path: Path, storage: str) -> None:
    """ROS 1 and 2, compressed or not."""
    with Bag(record(tmp_path / "bag", storage, three_clouds)) as bag:
        assert bag.span_ns == (START, START + 2 * S)
        clouds = list(read_clouds(bag, BagPart(bag.resolve_cloud_topic(), start_s=1.0, duration_s=1.0)))
    assert [cloud.bag_time_ns for cloud in clouds] == [START + S]


def test_the_sensor_of_clouds_in_another_frame(tmp_path: Path, bag_path: Path) -> None:
    with Bag(bag_path) as bag:
        (cloud, *_) = read_clouds(bag, BagPart("/points", sensor_frame="base_link"))
        assert cloud.scan is not None
        np.testing.assert_allclose(cloud.scan.sensor_origin, np.linalg.inv(MOUNTING)[:3, 3])
        clouds = list(read_clouds(bag, BagPart("/points", sensor_frame="mast")))
    assert len(clouds) == len(WAY)
    assert all(c.scan is None and isinstance(c.error, TransformUnavailableError) for c in clouds)
