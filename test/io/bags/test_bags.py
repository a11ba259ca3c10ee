"""Reading bags: real recordings, bags written here in every storage, and broken files."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_recorder import CLOUD, START, STORAGES, TF, Recorder, S, points_of, record, three_clouds

from svc_ros.core.errors import InputError, TransformUnavailableError, UnsupportedCloudError
from svc_ros.core.se3 import pose_error
from svc_ros.io.bags import Bag, TopicInfo, UnreadableCloud
from svc_ros.io.trajectories import read_tum


@pytest.mark.parametrize("storage", STORAGES)
def test_every_storage_gives_the_same_scans_and_transforms(tmp_path: Path, storage: str) -> None:
    with Bag(record(tmp_path / "drive", storage, three_clouds)) as bag:
        assert bag.topics == [TopicInfo("/points", CLOUD, 3), TopicInfo("/tf", TF, 3), TopicInfo("/tf_static", TF, 1)]
        assert (bag.resolve_cloud_topic(), bag.num_scans()) == ("/points", 3)
        readings = list(bag.scans())
        T = bag.transforms().lookup("map", "lidar", START + S // 2)
    assert [reading.scan.stamp_ns for reading in readings] == [START + k * S for k in range(3)]
    assert {reading.scan.frame_id for reading in readings} == {"lidar"}
    for k, reading in enumerate(readings):
        np.testing.assert_array_equal(reading.scan.points, points_of(k))
    np.testing.assert_allclose(T[:3, 3], [0.5, 0.0, 1.5], atol=1e-12)


@pytest.mark.parametrize("suffix", ["mcap", "db3"])
def test_a_storage_file_opens_without_its_folder(tmp_path: Path, suffix: str) -> None:
    folder = record(tmp_path / "drive", suffix, three_clouds)
    file = tmp_path / f"alone.{suffix}"
    shutil.copy(folder / f"drive.{suffix}", file)
    with Bag(str(file)) as bag:
        assert len(list(bag.scans("/points"))) == 3


def test_split_ros1_bags_read_as_one(tmp_path: Path) -> None:
    def one_cloud(k: int) -> Callable[[Recorder], None]:
        return lambda recorder: recorder.cloud("/points", START + k * S, points_of(k))

    parts = [record(tmp_path / name, "ros1", one_cloud(k)) for k, name in enumerate("ab")]
    with Bag(parts) as bag:
        assert bag.num_scans() == 2
        assert [reading.scan.stamp_ns for reading in bag.scans()] == [START, START + S]


def test_raw_clouds_carry_the_time_of_recording(tmp_path: Path) -> None:
    with Bag(record(tmp_path / "drive", "mcap", three_clouds)) as bag:
        raw = list(bag.raw_clouds("points"))  # the leading slash may be left out
    assert [stamp for stamp, _ in raw] == [START + k * S for k in range(3)]
    assert raw[1][1].width == 51


def test_a_topic_that_is_not_there_lists_those_that_are(tmp_path: Path) -> None:
    with Bag(record(tmp_path / "drive", "mcap", three_clouds)) as bag:
        with pytest.raises(InputError, match=r"drive: no topic '/lidar' \(topics: /points \[sensor_msgs.*/tf_static"):
            bag.resolve_cloud_topic("/lidar")
        with pytest.raises(InputError, match=r"topic '/tf': expected .*PointCloud2, found tf2_msgs.*clouds: /points"):
            next(bag.raw_clouds("/tf"))


def test_the_only_cloud_topic_is_found_and_others_are_asked_for(tmp_path: Path) -> None:
    def two_topics(recorder: Recorder) -> None:
        for topic in ("/front", "/rear"):
            recorder.cloud(topic, START, points_of(0))

    with (
        Bag(record(tmp_path / "two", "mcap", two_topics)) as bag,
        pytest.raises(InputError, match=r"\(/front, /rear\)"),
    ):
        bag.resolve_cloud_topic()
    only_tf = record(tmp_path / "tf", "mcap", lambda r: r.transform("/tf", START, ("a", "b"), (0, 0, 0, 0, 0, 0, 1)))
    with Bag(only_tf) as bag:
        assert bag.cloud_topics == []
        with pytest.raises(InputError, match=r"found none among /tf \[tf2_msgs"):
            bag.resolve_cloud_topic()


def test_an_unreadable_cloud_is_an_error_or_a_value_but_never_silence(tmp_path: Path) -> None:
    def one_is_broken(recorder: Recorder) -> None:
        recorder.cloud("/points", START, points_of(0))
        recorder.cloud("/points", START + S, points_of(1), names="xyq")
        recorder.cloud("/points", START + 2 * S, points_of(2))

    with Bag(record(tmp_path / "drive", "mcap", one_is_broken)) as bag:
        with pytest.raises(UnsupportedCloudError, match=r"drive: /points, cloud 1: .*'z'"):
            list(bag.scans())
        unreadable: list[UnreadableCloud] = []
        readings = list(bag.scans("/points", on_error=unreadable.append))
    assert [reading.scan.stamp_ns for reading in readings] == [START, START + 2 * S]
    assert [(u.index, u.stamp_ns, u.frame_id, type(u.error)) for u in unreadable] == [
        (1, START + S, "lidar", UnsupportedCloudError)
    ]


@pytest.mark.parametrize(
    ("numbers", "child"),
    [((0, 0, 0, 0, 0, 0, 0), "lidar"), ((np.nan, 0, 0, 0, 0, 0, 1), "lidar"), ((0, 0, 0, 0, 0, 0, 1), "base")],
)
def test_an_impossible_transform_spoils_only_its_own_frame(
    tmp_path: Path, numbers: tuple[float, ...], child: str
) -> None:
    def fill(recorder: Recorder) -> None:
        recorder.transform("/tf_static", START, ("base", child), numbers)
        recorder.transform("/tf_static", START, ("hand", "camera"), (1, 0, 0, 0, 0, 0, 1))

    with Bag(record(tmp_path / "drive", "mcap", fill)) as bag:
        tree = bag.transforms()
    assert tree.lookup("hand", "camera", START)[0, 3] == 1.0
    with pytest.raises(TransformUnavailableError, match=rf"drive: /tf_static: base -> {child}: "):
        tree.lookup(child, "hand", START)


def test_a_bag_without_transforms_has_an_empty_tree(tmp_path: Path) -> None:
    with Bag(record(tmp_path / "drive", "db3", lambda r: r.cloud("/points", START, points_of(0)))) as bag:
        assert bag.transforms().frames == []


def test_reading_needs_an_open_bag(tmp_path: Path) -> None:
    bag = Bag(record(tmp_path / "drive", "mcap", three_clouds))
    with pytest.raises(InputError, match="not open"):
        list(bag.scans("/points"))


# What is no bag at all; for damaged bags see test_damaged_bags.py


def no_bag(tmp_path: Path, kind: str) -> Path:
    name, _, how = kind.partition(" ")
    if how == "missing":
        return tmp_path / "absent"
    if how == "text":
        path = tmp_path / f"drive{name}"
        path.write_text("this is a letter, not a recording\n" * 40)
        return path
    if how == "of nothing":
        (tmp_path / "drive").mkdir()
        return tmp_path / "drive"
    storage = {".bag": "ros1", ".mcap": "mcap", ".db3": "db3", "folder": "mcap"}[name]
    path = record(tmp_path / "drive", storage, three_clouds)
    file = path if name == ".bag" else path / f"drive.{storage}"
    if how == "without storage":
        file.unlink()
    else:
        file.write_bytes(file.read_bytes()[: {"empty": 0, "stump": 60}[how]])
    return path if name == "folder" else file


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("any missing", "absent: bag not found"),
        (".bag text", r"drive\.bag: cannot be read as a bag: it is no bag: expected a \.bag, \.mcap or \.db3 file"),
        (".mcap text", r"drive\.mcap: cannot be read as a bag: it is no bag: .* begins with b'this is"),
        (".db3 text", r"drive\.db3: cannot be read as a bag: it is no bag"),
        (".txt text", r"drive\.txt: cannot be read as a bag: it is no bag: expected a \.bag, \.mcap or \.db3"),
        (".bag empty", r"drive\.bag: cannot be read as a bag: it is empty"),
        (".mcap empty", r"drive\.mcap: cannot be read as a bag: it is empty"),
        (".db3 empty", r"drive\.db3: cannot be read as a bag: it is empty"),
        (".bag stump", r"drive\.bag: the file ends after 60 bytes in the middle of a record; .* no message"),
        (".mcap stump", r"drive\.mcap: the file ends after 60 bytes in the middle of a chunk; .* no message"),
        (".db3 stump", r"drive\.db3: cannot be read as a bag: .*: the file ends after 60 bytes"),
        ("folder empty", r"drive\.mcap: cannot be read as a bag: it is empty"),
        ("folder of nothing", r"drive: expected a ROS 2 bag folder with metadata\.yaml, \.mcap or \.db3 files"),
        ("folder without storage", r"metadata\.yaml: expected the files that it names, found none.*: drive\.mcap"),
    ],
)
def test_what_is_no_bag_is_refused_in_one_line(tmp_path: Path, kind: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught, Bag(no_bag(tmp_path, kind)) as bag:
        list(bag.scans())
    assert "\n" not in str(caught.value)


# Real recordings


def test_both_recordings_of_the_walk_hold_the_same_scans(shared_data: Path) -> None:
    folder = shared_data / "bags" / "os0_64_walk"
    with Bag(folder / "ros2_mcap") as second, Bag(folder / "ros1_first22.bag") as first:
        assert (second.num_scans("/points"), first.num_scans("/points")) == (89, 22)
        pairs = list(zip(first.scans("/points"), second.scans("/points"), strict=False))
    assert len(pairs) == 22
    for a, b in pairs:
        assert (a.scan.stamp_ns, a.scan.frame_id, len(a.scan)) == (b.scan.stamp_ns, b.scan.frame_id, len(b.scan))
        np.testing.assert_array_equal(a.scan.points, b.scan.points)


@pytest.mark.parametrize("name", ["ros2_mcap", "ros1_first22.bag"])
def test_recorded_transforms_are_the_odometry_and_near_the_reference(shared_data: Path, name: str) -> None:
    folder = shared_data / "bags" / "os0_64_walk"
    odometry, reference = read_tum(folder / "odometry_tum.txt"), read_tum(folder / "reference_tum.txt")
    with Bag(folder / name) as bag:
        tree = bag.transforms()
        stamps = [reading.scan.stamp_ns for reading in bag.scans("/points")]
    for stamp in stamps:
        T = tree.lookup("map", "lidar", stamp)
        rotation_deg, translation_m = pose_error(T, odometry.at(stamp))
        assert rotation_deg < 1e-4  # the file's stamps are rounded by some 100 ns
        assert translation_m < 1e-5
        rotation_deg, translation_m = pose_error(T, reference.at(stamp))
        assert rotation_deg < 0.5  # the odometry drifts this far and no farther
        assert translation_m < 0.25


@pytest.mark.parametrize(
    ("path", "topic", "num_scans"),
    [
        ("hdl64_kitti_a_10hz", "/velodyne_points", 22),
        ("readers/vlp16_pointcloud2", "/velodyne_points", 4),
        ("readers/vlp32_pointcloud2", None, None),
        ("readers/os1_128_pointcloud2_mcap", None, None),
        ("readers/os0_8_10scans_pointcloud2", None, 10),
        ("readers/depth_ros1_padded_nan/perception_tutorial.bag", "/camera/depth_registered/points", 1),
    ],
)
def test_every_real_bag_reads(shared_data: Path, path: str, topic: str | None, num_scans: int | None) -> None:
    with Bag(shared_data / "bags" / path) as bag:
        count = bag.num_scans(topic)
        reading = next(bag.scans(topic))
    assert count == num_scans or num_scans is None
    assert len(reading.scan) > 1000
    assert reading.scan.frame_id
