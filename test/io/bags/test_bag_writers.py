"""The bags that we write: decisions as one MCAP file, simulated drives as ROS 2 folders."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from bag_recorder import START, S, messages_of, points_of
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.se3 import make_pose
from svc_ros.io.bags import Bag, CloudBagWriter, ResultWriter
from svc_ros.io.bags.result_writer import UNFINISHED


def result(accepted: bool = True, covariance: bool = True) -> RegistrationResult:
    if not accepted:
        return RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP, "svc", detail="too little in common")
    T = make_pose(Rotation.from_euler("xyz", [5, -10, 40], degrees=True).as_matrix(), [1.0, 2.0, 3.0])
    matrix = np.arange(36.0).reshape(6, 6) if covariance else None
    return RegistrationResult(Verdict.ACCEPTED, Reason.OK, "svc", T, T, matrix, time_ms={"total": 12.5})


def test_results_carry_transforms_for_accepted_pairs_only(tmp_path: Path) -> None:
    path = tmp_path / "out" / "results.mcap"
    with ResultWriter(path) as writer:
        writer.write(result(), START + S, START, "sensor", "map")
        writer.write(result(accepted=False), START + 2 * S, START + S, "sensor", "map")
        assert [p.is_dir() for p in path.parent.glob(UNFINISHED)] == [True]
    found = messages_of(path)
    counts = {topic.rpartition("/")[2]: len(messages) for topic, messages in found.items()}
    assert counts == {"transform": 1, "pose": 1, "rejected": 2, "decision": 2}
    assert [message.data for _, message in found["/svc_registration/rejected"]] == [False, True]
    ((stamp, transform),) = found["/svc_registration/transform"]
    assert stamp == START + S
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "sensor")
    assert (transform.header.stamp.sec, transform.header.stamp.nanosec) == divmod(START + S, S)
    T = result().T_target_source
    assert T is not None
    q, t = transform.transform.rotation, transform.transform.translation
    np.testing.assert_allclose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), T[:3, :3], atol=1e-12)
    assert (t.x, t.y, t.z) == (1.0, 2.0, 3.0)
    ((_, pose),) = found["/svc_registration/pose"]
    np.testing.assert_array_equal(pose.pose.covariance, np.arange(36.0))
    assert sorted(p.name for p in path.parent.iterdir()) == ["results.mcap"]


def test_every_decision_says_verdict_reason_and_stamps(tmp_path: Path) -> None:
    with ResultWriter(tmp_path / "results.mcap") as writer:
        writer.write(result(), START + S, START)
        writer.write(result(accepted=False), START + 2 * S, START + S)
    decisions = [m for _, m in messages_of(tmp_path / "results.mcap")["/svc_registration/decision"]]
    levels = [decision.status[0].level for decision in decisions]
    values = [{pair.key: pair.value for pair in decision.status[0].values} for decision in decisions]
    assert levels == [0, 1]
    assert [(v["verdict"], v["reason"]) for v in values] == [("accepted", "ok"), ("rejected", "low_overlap")]
    assert (values[0]["source_stamp"], values[0]["target_stamp"]) == ("1700000001.123456789", "1700000000.123456789")
    assert decisions[1].header.stamp.sec == 1_700_000_002


@pytest.mark.parametrize(
    ("source", "target", "expected"),
    [
        ("lidar", "lidar", ("lidar", "lidar/source")),
        ("/lidar", "lidar", ("lidar", "lidar/source")),
        ("", "", ("target", "source")),
        ("rear", "front", ("front", "rear")),
    ],
)
def test_a_transform_never_joins_a_frame_to_itself(
    tmp_path: Path, source: str, target: str, expected: tuple[str, str]
) -> None:
    with ResultWriter(tmp_path / "results.mcap") as writer:
        writer.write(result(), START + S, START, source, target)
    with Bag(tmp_path / "results.mcap") as bag:
        assert len(bag.topics) == 4
    ((_, transform),) = messages_of(tmp_path / "results.mcap")["/svc_registration/transform"]
    assert (transform.header.frame_id, transform.child_frame_id) == expected


def test_a_pose_without_covariance_is_never_taken_for_certain(tmp_path: Path) -> None:
    with ResultWriter(tmp_path / "results.mcap") as writer:
        writer.write(result(covariance=False), START + S, START)
    ((_, pose),) = messages_of(tmp_path / "results.mcap")["/svc_registration/pose"]
    sigma = np.sqrt(pose.pose.covariance.reshape(6, 6).diagonal())
    np.testing.assert_allclose(sigma, [1.0, 1.0, 1.0, *np.radians([10.0, 10.0, 10.0])])


def test_results_open_in_other_programs(tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    with ResultWriter(tmp_path / "results.mcap") as writer:
        for k in range(300):
            writer.write(result(accepted=k % 2 == 0), START + k * S, START)
    with (tmp_path / "results.mcap").open("rb") as file:
        mcap = reader.make_reader(file, validate_crcs=True)
        summary = mcap.get_summary()
        stamps = [message.log_time for _, _, message in mcap.iter_messages(topics=["/svc_registration/decision"])]
    assert stamps == [START + k * S for k in range(300)]
    assert summary.statistics.message_count == 900
    schemas = {schema.name: schema for schema in summary.schemas.values()}
    assert schemas["geometry_msgs/msg/TransformStamped"].encoding == "ros2msg"
    assert b"MSG: geometry_msgs/Transform" in schemas["geometry_msgs/msg/TransformStamped"].data
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}


def test_results_survive_an_error_and_replace_older_ones(tmp_path: Path) -> None:
    path = tmp_path / "results.mcap"
    path.write_text("old")
    writer = ResultWriter(path)
    with contextlib.suppress(RuntimeError), writer:
        writer.write(result(), START + S, START)
        raise RuntimeError
    writer.close()
    assert len(messages_of(path)["/svc_registration/decision"]) == 1
    with ResultWriter(path):
        pass
    with Bag(path) as bag:
        assert [topic.count for topic in bag.topics] == [0, 0, 0, 0]


def test_places_and_stamps_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected the name of an \.mcap file"):
        ResultWriter(tmp_path / "results.bag")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        ResultWriter(tmp_path / "file" / "results.mcap")
    with (
        ResultWriter(tmp_path / "results.mcap") as writer,
        pytest.raises(InputError, match="stamp: expected nanoseconds"),
    ):
        writer.write(result(), -1, 0)


def test_a_simulated_drive_reads_back(tmp_path: Path) -> None:
    points = np.column_stack([points_of(4), np.linspace(0, 255, 54)])
    with CloudBagWriter(tmp_path / "drive") as writer:
        for k in range(3):
            writer.write_transform(START + k * S, "map", "base", make_pose(np.eye(3), [k, 0, 0]))
            writer.write_points(START + k * S, "lidar", points[:, :3] if k else points)
        writer.write_transform(START, "base", "lidar", make_pose(np.eye(3), [0, 0, 2.0]), static=True)
        writer.write_transform(START, "base", "camera", make_pose(np.eye(3), [1.0, 0, 0]), static=True)
    with Bag(tmp_path / "drive") as bag:
        readings = list(bag.scans())
        raw = [message for _, message in bag.raw_clouds()]
        tree = bag.transforms()
    assert (tmp_path / "drive" / "metadata.yaml").is_file()
    assert [reading.scan.stamp_ns for reading in readings] == [START, START + S, START + 2 * S]
    np.testing.assert_array_equal(readings[0].scan.points, points_of(4))
    assert [(field.name, field.datatype) for field in raw[0].fields] == [
        (name, 7) for name in ("x", "y", "z", "intensity")
    ]
    intensity = raw[0].data.view("<f4").reshape(-1, 4)[:, 3]
    np.testing.assert_allclose(intensity, points[:, 3], rtol=1e-6)
    np.testing.assert_allclose(tree.lookup("map", "lidar", START + S // 2)[:3, 3], [0.5, 0, 2.0], atol=1e-12)
    statics = messages_of(tmp_path / "drive")["/tf_static"]
    assert [t.child_frame_id for t in statics[-1][1].transforms] == ["lidar", "camera"]


def test_a_drive_never_overwrites_another(tmp_path: Path) -> None:
    with CloudBagWriter(tmp_path / "drive"):
        pass
    with pytest.raises(InputError, match="drive: exists already"):
        CloudBagWriter(tmp_path / "drive")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        CloudBagWriter(tmp_path / "file" / "drive")


def test_a_drive_refuses_what_is_no_cloud_or_pose(tmp_path: Path) -> None:
    with CloudBagWriter(tmp_path / "drive") as writer:
        with pytest.raises(InputError, match="expected shape N x 3 or N x 4"):
            writer.write_points(START, "lidar", np.zeros((5, 2)))
        with pytest.raises(InputError, match=r"map -> base: .*NaN"):
            writer.write_transform(START, "map", "base", np.full((4, 4), np.nan))
        with pytest.raises(InputError, match="stamp"):
            writer.write_points(2**31 * S, "lidar", np.zeros((5, 3)))
