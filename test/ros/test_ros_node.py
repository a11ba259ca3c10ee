"""The node over the real middleware, in a second process: what goes in, what comes out, and how it ends."""

from __future__ import annotations

import json
import signal
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import PoseWithCovarianceStamped  # noqa: E402
from mini_data import POSES, pose_between, scan_room  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from ros_bench import SECOND, Bench, cloud, matrix  # noqa: E402
from sensor_msgs.msg import PointCloud2  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402
from visualization_msgs.msg import Marker, MarkerArray  # noqa: E402
from yardstick import PATIENCE_S, assert_ends_within  # noqa: E402

from svc_ros.core.result import Reason, RegistrationResult, Verdict  # noqa: E402
from svc_ros.core.se3 import apply, pose_error  # noqa: E402
from svc_ros.io.clouds.point_cloud2 import scan_from_cloud  # noqa: E402
from svc_ros.ros import node  # noqa: E402
from svc_ros.ros.collector import DecisionCollector, spin_until  # noqa: E402
from svc_ros.ros.processes import ChildProcess, local_environment, own_domain_id  # noqa: E402
from svc_ros.ros.topics.conversions import pose_message  # noqa: E402
from svc_ros.ros.topics.looks import MAX_LINES  # noqa: E402

pytestmark = pytest.mark.dds

SCANS = [scan_room(T, seed=k) for k, T in enumerate(POSES)]


@pytest.fixture(autouse=True)
def _local_discovery(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        folder = tmp_path_factory.mktemp("node")
        parameters = {"preset": "lidar_indoor", "process_every": "true"}
        with Bench(folder, own_domain_id(1), parameters) as bench:
            yield bench


def call(bench, service_type, name, request):
    client = bench.node.create_client(service_type, f"/svc_registration/{name}")
    assert client.wait_for_service(timeout_sec=PATIENCE_S)
    future = client.call_async(request)
    assert spin_until(bench.executor, future.done, PATIENCE_S)
    return future.result()


def set_parameter(bench, name, value):
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    (result,) = call(bench, SetParameters, "set_parameters", request).results
    assert result.successful, result.reason


def status(bench):
    return json.loads(call(bench, Trigger, "status", Trigger.Request()).message)


def test_pair_of_one_room_is_accepted_with_transform_and_pose(bench):
    num_transforms = len(bench.answers.transforms)
    decision = bench.decide(cloud(SCANS[1], 1.0, "scan_1"), cloud(SCANS[0], 1.0, "scan_0"))
    assert (decision["verdict"], decision["reason"]) == ("accepted", "ok")
    assert decision["source_stamp"] == decision["target_stamp"] == "1.000000000"
    bench.settle()
    (transform,) = bench.answers.transforms[num_transforms:]
    assert (transform.header.frame_id, transform.child_frame_id, transform.header.stamp.sec) == ("scan_0", "scan_1", 1)
    rotation_deg, translation_m = pose_error(matrix(transform), pose_between(1, 0))
    assert rotation_deg < 1.0
    assert translation_m < 0.1
    pose = bench.answers.poses[-1]
    assert pose.header.frame_id == "scan_0"
    assert pose.pose.pose.position.x == transform.transform.translation.x
    assert (np.diag(pose.pose.covariance.reshape(6, 6)) > 0).all()
    assert bench.answers.rejected[-1] is False


@pytest.mark.parametrize(
    ("stamp", "points", "reason"),
    [
        (10.0, np.full((500, 3), np.nan), "too_few_points"),
        (11.0, np.empty((0, 3)), "too_few_points"),
        (12.0, np.ones((50, 3)), "too_few_points"),
    ],
)
def test_cloud_without_usable_points_is_rejected_and_the_side_is_named(bench, stamp, points, reason):
    decision = bench.decide(cloud(points, stamp), cloud(SCANS[0], stamp))
    assert (decision["verdict"], decision["reason"]) == ("rejected", reason)
    assert decision["detail"].startswith("source: ")


def test_cloud_with_wrong_fields_is_rejected_by_name(bench):
    broken = cloud(SCANS[0], 20.0)
    broken.fields[1].name = "height"
    decision = bench.decide(cloud(SCANS[1], 20.0), broken)
    assert (decision["verdict"], decision["reason"]) == ("rejected", "unsupported_cloud")
    assert decision["detail"].startswith("target: ")
    assert "'y'" in decision["detail"]


def test_good_pair_after_bad_ones_is_registered(bench):
    bench.decide(cloud(np.empty((0, 3)), 30.0), cloud(np.empty((0, 3)), 30.0))
    assert bench.decide(cloud(SCANS[1], 31.0), cloud(SCANS[0], 31.0))["verdict"] == "accepted"


@pytest.fixture
def impatient(bench):
    """The node gives clouds without a partner up after a second."""
    set_parameter(bench, "pair_timeout", 1.0)
    yield
    set_parameter(bench, "pair_timeout", 10.0)


@pytest.mark.usefixtures("impatient")
def test_clouds_without_a_partner_are_dropped_with_a_decision_each(bench):
    before = len(bench.answers.decisions)
    bench.player.publish(cloud(SCANS[1], 40.0), cloud(SCANS[0], 40.2))
    assert bench.collector.wait_for_decisions(before + 2, PATIENCE_S)
    bench.settle()
    dropped = bench.answers.decisions[before:]
    assert {(d["verdict"], d["reason"], d["source_stamp"], d["target_stamp"]) for d in dropped} == {
        ("dropped", "time_skew", "40.000000000", ""),
        ("dropped", "time_skew", "", "40.200000000"),
    }
    assert len(dropped) == 2


@pytest.mark.usefixtures("impatient")
def test_pair_within_the_skew_is_matched_when_the_streams_fall_silent(bench):
    decision = bench.decide(cloud(SCANS[1], 50.0), cloud(SCANS[0], 50.03))
    assert decision["target_stamp"] == "50.030000000"


def test_bag_that_starts_again_is_registered_again(bench):
    assert bench.decide(cloud(SCANS[1], 60.0), cloud(SCANS[0], 60.0))["verdict"] == "accepted"
    before = len(bench.answers.decisions)
    bench.player.publish(cloud(SCANS[1], 1.0), cloud(SCANS[0], 1.0))
    assert bench.collector.wait_for_decisions(before + 1, PATIENCE_S)
    assert bench.answers.decisions[-1]["verdict"] == "accepted"


def test_cloud_that_comes_again_is_not_described_again(bench):
    bench.decide(cloud(SCANS[1], 70.0), cloud(SCANS[0], 70.0))
    before = status(bench)["worker"]["features_reused"]
    bench.decide(cloud(SCANS[2], 71.0), cloud(SCANS[1], 71.0))
    assert status(bench)["worker"]["features_reused"] == before + 1


def test_parameter_outside_its_range_or_combination_is_refused_by_name(bench):
    def refused(name, value):
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        (result,) = call(bench, SetParameters, "set_parameters", request).results
        assert not result.successful
        return result.reason

    assert "preprocess.voxel_size_m" in refused("preprocess.voxel_size_m", -1.0)
    assert "min_range_m" in refused("preprocess.min_range_m", 900.0)
    assert "did you mean 'svc_paper'" in refused("method", "svc_papr")
    assert "preset" in refused("preset", "lidar_outdoor")


def test_parameter_change_applies_to_the_next_pair(bench):
    set_parameter(bench, "method", "sc2")
    decision = bench.decide(cloud(SCANS[1], 80.0), cloud(SCANS[0], 80.0))
    set_parameter(bench, "method", "svc")
    assert decision["method"] == "sc2"


def test_live_node_skips_to_the_newest_pair_and_answers_the_skipped_ones(bench):
    set_parameter(bench, "process_every", False)
    before, stamps = len(bench.answers.decisions), [f"{s}.000000000" for s in range(82, 87)]
    for stamp in range(82, 87):  # no more at once than the inputs hold
        bench.player.publish(cloud(SCANS[1], stamp), cloud(SCANS[0], stamp))
    assert bench.collector.wait_for_decisions(before + 5, PATIENCE_S)
    set_parameter(bench, "process_every", True)
    decisions = bench.answers.decisions[before:]
    assert [d["source_stamp"] for d in decisions] == stamps
    assert decisions[-1]["verdict"] == "accepted"
    between = {(d["verdict"], d["reason"]) for d in decisions[1:-1]}  # a fast machine serves some of them in time
    assert ("dropped", "superseded") in between
    assert between <= {("dropped", "superseded"), ("accepted", "ok")}


def test_aligned_and_blocked_clouds_are_in_the_target_frame_while_somebody_looks(bench):
    clouds = {"aligned": [], "blocked_points": []}
    subscriptions = [
        bench.node.create_subscription(PointCloud2, f"/svc_registration/{name}", received.append, 10)
        for name, received in clouds.items()
    ]
    bench.settle()
    bench.decide(cloud(SCANS[1], 88.0, "moved"), cloud(SCANS[0], 88.0, "fixed"))
    assert spin_until(bench.executor, lambda: all(clouds.values()), PATIENCE_S)
    for subscription in subscriptions:
        bench.node.destroy_subscription(subscription)
    (aligned,), (blocked,) = clouds.values()
    assert aligned.header.frame_id == blocked.header.frame_id == "fixed"
    points = scan_from_cloud(aligned).scan.points
    assert np.abs(points - apply(pose_between(1, 0), SCANS[1])).max() < 0.2
    assert [f.name for f in blocked.fields] == ["x", "y", "z", "from_source"]


def test_sight_lines_are_drawn_while_somebody_looks(bench):
    arrays = []
    subscription = bench.node.create_subscription(MarkerArray, "/svc_registration/sight_lines", arrays.append, 10)
    bench.settle()
    bench.decide(cloud(SCANS[1], 88.5, "moved"), cloud(SCANS[0], 88.5, "fixed"))
    assert spin_until(bench.executor, lambda: arrays, PATIENCE_S)
    bench.node.destroy_subscription(subscription)
    first, *markers, verdict = arrays[0].markers
    assert first.action == Marker.DELETEALL
    assert (verdict.ns, verdict.text, verdict.header.frame_id) == ("verdict", "accepted: ok", "fixed")
    assert verdict.color.g > verdict.color.r
    assert {m.ns for m in markers} >= {"target_clear", "source_clear"}
    for marker in markers:
        assert marker.header.frame_id == "fixed"
        assert 0 < len(marker.points) <= 2 * MAX_LINES
        assert (marker.color.g > marker.color.r) == marker.ns.endswith("clear")
    clear = next(m for m in markers if m.ns == "source_clear")
    sensor = np.array([clear.points[0].x, clear.points[0].y, clear.points[0].z])
    assert np.linalg.norm(sensor - pose_between(1, 0)[:3, 3]) < 0.1


def test_good_guess_is_verified_and_spares_the_search(bench):
    guesses = bench.node.create_publisher(PoseWithCovarianceStamped, "/initial_guess", 10)
    assert spin_until(bench.executor, guesses.get_subscription_count, PATIENCE_S)
    right = RegistrationResult(Verdict.ACCEPTED, Reason.OK, T_target_source=pose_between(1, 0))
    guesses.publish(pose_message(right, 89 * SECOND, "lidar"))
    bench.settle()
    decision = bench.decide(cloud(SCANS[1], 89.0), cloud(SCANS[0], 89.0))
    assert decision["verdict"] == "accepted"
    assert "counts.hypotheses" not in decision


def test_late_subscriber_gets_the_last_decision_only(bench):
    last = bench.answers.decisions[-1]
    late = DecisionCollector(bench.node, bench.executor)
    assert late.wait_for_decisions(1, PATIENCE_S)
    bench.settle()
    assert late.answers.decisions == [last]


def test_diagnostics_tell_rates_queue_latency_and_verdicts(bench):
    arrays = []
    subscription = bench.node.create_subscription(DiagnosticArray, "/diagnostics", arrays.append, 10)
    assert spin_until(bench.executor, lambda: len(arrays) >= 2, PATIENCE_S)
    bench.node.destroy_subscription(subscription)
    statuses = {s.name: {kv.key: kv.value for kv in s.values} for s in arrays[-1].status}
    assert {name.removeprefix("svc_registration: ") for name in statuses} == {
        "input", "pairing", "worker", "decisions"
    }  # fmt: skip
    assert float(statuses["svc_registration: worker"]["latency_ms_p95"]) > 0
    accepted = sum(d["verdict"] == "accepted" for d in bench.answers.decisions)
    assert int(statuses["svc_registration: decisions"]["accepted"]) == accepted
    assert int(statuses["svc_registration: input"]["source_received"]) > 5


def test_disabled_node_drops_as_inactive(bench):
    assert call(bench, SetBool, "enable", SetBool.Request(data=False)).success
    decision = bench.decide(cloud(SCANS[1], 90.0), cloud(SCANS[0], 90.0))
    assert (decision["verdict"], decision["reason"]) == ("dropped", "inactive")
    assert call(bench, SetBool, "enable", SetBool.Request(data=True)).success
    assert bench.decide(cloud(SCANS[1], 91.0), cloud(SCANS[0], 91.0))["verdict"] == "accepted"


def test_reset_gives_up_what_waits(bench):
    before = len(bench.answers.decisions)
    bench.player.publish(cloud(SCANS[1], 100.0), cloud(SCANS[0], 101.0))
    bench.settle()
    assert call(bench, Trigger, "reset", Trigger.Request()).success
    assert bench.collector.wait_for_decisions(before + 2, PATIENCE_S)
    assert {d["verdict"] for d in bench.answers.decisions[before:]} == {"dropped"}


def test_every_pair_has_one_decision_and_only_accepted_ones_a_transform(bench):
    bench.settle()
    counts, decisions = status(bench), bench.answers.decisions
    verdicts = [d["verdict"] for d in decisions]
    assert counts["pairing"]["matched"] + counts["pairing"]["unmatched"] == len(decisions)
    assert len(bench.answers.rejected) == len(decisions)
    assert counts["decisions"] == {v: verdicts.count(v) for v in ("accepted", "rejected", "undecided", "dropped")}
    assert len(bench.answers.transforms) == len(bench.answers.poses) == verdicts.count("accepted")
    assert bench.answers.rejected.count(False) == verdicts.count("accepted")


@pytest.mark.parametrize(
    ("moment", "signum"),
    [
        ("warming up", signal.SIGTERM),
        ("ready:", signal.SIGINT),
        pytest.param("warming up", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("ready:", signal.SIGTERM, marks=pytest.mark.slow),
    ],
)
def test_node_ends_with_exit_code_0_within_two_seconds(tmp_path, signum, moment):
    environment = local_environment(own_domain_id(2))
    with ChildProcess("svc_ros.ros.node", [], environment, tmp_path / "log") as process:
        end = time.monotonic() + PATIENCE_S
        while moment not in process.output() and time.monotonic() < end:
            time.sleep(0.05)
        assert_ends_within(2.0, process, signum)
        assert "Traceback" not in process.output()


@pytest.mark.parametrize(
    ("parameter", "text"),
    [
        ("preset:=lidar_outdor", "did you mean 'lidar_outdoor'"),
        ("mode:=scan_match", "did you mean 'scan_matching'"),
        ("edges:=rtabmap", "belong to mode loop_closure"),
        ("preprocess.voxel_size_m:=1", "write 1.0"),
        ("queue_size:=0", "queue_size"),
        ("sensor_origin:=[0.0, 1.0]", "sensor_origin: expected 3 numbers"),
        ("method:=5", "method: expected a str"),
        ("mode:=loop_closure -p graph_file:=/gone/a.g2o", "graph_file /gone/a.g2o: expected a folder /gone"),
        ("mode:=localization -p map_folder:=/gone", "/gone: expected the folder of a map, found none"),
        ("qos_overrides./source_points.subscription.reliability:=reliabel", "qos_overrides./source_points: "),
    ],
)
def test_refused_parameter_at_start_is_one_line_and_exit_code_2(monkeypatch, capfd, parameter, text):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain_id(3)))
    monkeypatch.setattr(node, "_on_signals", lambda _handle: None)  # they are pytest's
    monkeypatch.setattr(node, "_spin", lambda *_: pytest.fail("the node started"))
    assert node.main(["--ros-args", *(word for each in parameter.split(" -p ") for word in ("-p", each))]) == 2
    assert_told(capfd.readouterr().err, text)


def test_a_process_that_is_refused_at_start_ends_with_exit_code_2(tmp_path):
    environment = local_environment(own_domain_id(3))
    words = ["--ros-args", "-p", "preset:=lidar_outdor"]
    with ChildProcess("svc_ros.ros.node", words, environment, tmp_path / "log") as process:
        assert process.wait(PATIENCE_S) == 2
        assert_told(process.output(), "did you mean 'lidar_outdoor'")


def assert_told(output: str, text: str) -> None:
    lines = [line for line in output.splitlines() if text in line]
    assert len(lines) == 1, output
    assert lines[0].startswith("registration_node: ")
    assert "Traceback" not in output
