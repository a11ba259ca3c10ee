"""What `svc_ros doctor --live` says of clouds that were heard; no ROS here, lists of arrivals stand for it."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from cloud_messages import xyz_cloud
from command_line import assert_refused, run

from svc_ros.cli.doctor import live
from svc_ros.cli.doctor.arrivals import missing_by_number, missing_by_stamp
from svc_ros.cli.doctor.finding import Finding
from svc_ros.cli.doctor.live import check_heard
from svc_ros.core.errors import InputError
from svc_ros.io.clouds.livox import LIVOX_TYPE
from svc_ros.io.clouds.point_cloud2 import CLOUD_TYPE
from svc_ros.io.heard import Arrival, Endpoint, Heard

START, MS, S = 1_700_000_000_000_000_000, 1_000_000, 1_000_000_000
BEST_EFFORT = Endpoint("/driver", CLOUD_TYPE, "best effort", "volatile")
RELIABLE = replace(BEST_EFFORT, reliability="reliable")
BALL = np.random.default_rng(1).normal(size=(2000, 3)) * 8.0


def arrivals(count: int = 100, skipped: tuple[int, ...] = ()) -> tuple[Arrival, ...]:
    """At 10 Hz, 20 ms after their stamps, without the skipped ones."""
    return tuple(
        Arrival(START + k * 100 * MS + 20 * MS, START + k * 100 * MS, "lidar", 2000, 24_100, k + 1)
        for k in range(count)
        if k not in skipped
    )


def changed(**values) -> tuple[Arrival, ...]:
    """Arrivals with other values: of all, or by the number of each."""
    return tuple(
        replace(a, **{name: v(k) if callable(v) else v for name, v in values.items()}) for k, a in enumerate(arrivals())
    )


def serialised(points, k: int) -> bytes:
    from rosbags.typesys import Stores, get_typestore

    message = xyz_cloud(points, START + k * 100 * MS).message()
    return bytes(get_typestore(Stores.ROS2_JAZZY).serialize_cdr(message, CLOUD_TYPE))


def heard(**values) -> Heard:
    kept = {k: serialised(BALL + 0.01 * k, k) for k in (0, 1, 50, 51)}
    basis = Heard("/points", 10.0, CLOUD_TYPE, (BEST_EFFORT,), (), arrivals(), cure="SET THIS", where="here", kept=kept)
    return replace(basis, **values)


def finding(name: str, **values) -> Finding:
    (found,) = [f for f in check_heard(heard(**values)) if f.name == f"/points {name}"]
    return found


def test_good_clouds_give_good_lines_on_arrival_and_content() -> None:
    findings = check_heard(heard())
    assert {f.level for f in findings} == {"ok"}
    told = {f.name.removeprefix("/points "): f.found for f in findings}
    assert told["rate"].startswith("10.0 Hz, 100 clouds in 10 s; steps of 100 ms, 95 % within 0 ms")
    assert told["size"] == "2000 points, 0.02 MB a cloud, 1.9 Mbit/s"
    assert told["loss"].startswith("0.0%, 0 of 100")
    assert told["age"] == "0.020 s when they come (spread 0.000 s) by this machine's clock"
    assert told["stamps"].endswith("10.0 Hz")
    assert (told["frame"], told["points"]) == ("lidar", "2000 a cloud (2000 to 2000), 0 clouds empty")
    assert told["preset"].startswith("lidar_indoor")


def test_content_is_judged_as_that_of_a_bag() -> None:
    points = BALL.copy()
    points[:1500] = np.nan
    assert finding("NaN share", kept={0: serialised(points, 0)}).level == "warn"
    assert finding("scale", kept={0: serialised(1000 * BALL, 0)}).level == "error"
    assert finding("repeated clouds", kept={k: serialised(BALL, k) for k in (0, 1)}).level == "warn"


def test_neighbours_are_registered_where_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def try_pairs(pairs, preset_name):
        tried.extend((first.scan.stamp_ns, second.scan.stamp_ns) for first, second in pairs)
        return [Finding(f"registration, {preset_name}", "ok", "")]

    monkeypatch.setattr(live, "try_pairs", try_pairs)
    assert [f.name for f in check_heard(heard(), trial=True)][-1] == "/points registration, lidar_indoor"
    assert tried == [(START, START + 100 * MS), (START + 5 * S, START + 5 * S + 100 * MS)]


def test_loss_on_the_way_comes_with_the_cure() -> None:
    lost = finding("loss", arrivals=arrivals(skipped=(7, 8, 30, 60, 61, 62)))
    assert lost.level == "warn"
    assert lost.found == ("6.0%, 6 of 100: sequence numbers leave out 6, the middleware reports 0, stamps leave out 6")
    assert lost.advice == "SET THIS"


def test_what_a_reliable_publisher_could_send_again_is_told_with_the_override() -> None:
    lost = finding("loss", arrivals=arrivals(skipped=(7,)), publishers=(RELIABLE,))
    assert lost.advice.startswith("SET THIS; or let lost clouds be sent again: reliable:=true")
    assert lost.advice.endswith("-p qos_overrides./points.subscription.reliability:=reliable")


def test_the_middleware_knows_what_was_lost_at_both_ends() -> None:
    lost = finding("loss", arrivals=arrivals(5), num_lost=95, kept={0: serialised(BALL, 0)})
    assert (lost.level, lost.found.startswith("95.0%, 95 of 100")) == ("warn", True)


def test_scans_that_were_never_sent_are_no_loss_on_the_way() -> None:
    fewer = tuple(replace(a, sequence=k + 1) for k, a in enumerate(arrivals(skipped=(10, 20, 21))))
    left_out = finding("loss", arrivals=fewer)
    assert (left_out.level, left_out.found.startswith("0.0%, 0 of 97")) == ("warn", True)
    assert left_out.advice == "nothing is lost on the way: the sensor or its driver leaves scans out"


@pytest.mark.parametrize("values", [{"publishers": (RELIABLE, RELIABLE)}, {"arrivals": changed(sequence=None)}])
def test_numbers_that_tell_nothing_are_not_believed(values) -> None:
    told = finding("loss", **values)
    assert (told.level, "sequence numbers tell nothing" in told.found) == ("ok", True)


def test_without_numbers_the_stamps_are_all_there_is() -> None:
    gaps = tuple(replace(a, sequence=None) for a in arrivals(skipped=(10, 20)))
    told = finding("loss", arrivals=gaps)
    assert (told.level, "stamps leave out 2" in told.found, "SET THIS" in told.advice) == ("warn", True, True)


@pytest.mark.parametrize(
    ("sequence", "missing"),
    [([], 0), ([5], 0), ([5, 6, 7], 0), ([5, 8, 9], 2), ([7, 9, 1, 2, 4], 2), ([1, None], None)],
)
def test_numbers_that_are_left_out(sequence: list[int | None], missing: int | None) -> None:
    assert missing_by_number(sequence) == missing


@pytest.mark.parametrize(
    ("stamps", "missing"),
    [([], 0), ([5], 0), ([0, 0, 0], 0), ([0, 10, 20, 30], 0), ([0, 11, 19, 50, 60], 2), ([0, 10, 20, 5, 15, 35], 1)],
)
def test_stamps_that_are_left_out(stamps: list[int], missing: int) -> None:
    assert missing_by_stamp(stamps) == missing


def test_bursts_and_a_single_cloud_are_no_good_rate() -> None:
    bursts = changed(received_ns=lambda k: START + k // 4 * 400 * MS + k % 4 * MS)
    assert (finding("rate", arrivals=bursts).level, finding("rate").level) == ("warn", "ok")
    one = finding("rate", arrivals=arrivals(1), kept={0: serialised(BALL, 0)})
    assert (one.level, one.found) == ("warn", "1 cloud in 10 s")
    lost = finding("loss", arrivals=arrivals(1), kept={0: serialised(BALL, 0)}, num_lost=99)
    assert (lost.level, lost.found.split(":")[0]) == ("warn", "99.0%, 99 of 100")


def test_nothing_that_comes_is_an_error() -> None:
    nothing = finding("clouds", arrivals=(), kept={})
    assert (nothing.level, nothing.found) == ("error", "none in 10 s, though they are published")
    assert "SET THIS" in nothing.advice


@pytest.mark.parametrize(
    ("shift_ns", "level", "words"),
    [
        (0, "ok", ""),
        (3600 * S, "warn", "ros2 bag play --clock"),
        (-5 * S, "warn", "clocks that differ"),
        (START - 90 * S, "warn", "counted from its start"),
    ],
)
def test_the_clock_of_the_stamps(shift_ns: int, level: str, words: str) -> None:
    age = finding("age", arrivals=changed(stamp_ns=lambda k: START + k * 100 * MS - shift_ns))
    assert (age.level, words in age.advice) == (level, True)


def test_simulated_time_is_now_where_it_fits() -> None:
    bag = {"stamp_ns": lambda k: 90 * S + k * 100 * MS}
    fits = finding("age", arrivals=changed(**bag, clock_ns=lambda k: 90 * S + k * 100 * MS + 5 * MS))
    assert (fits.level, fits.advice) == ("ok", "start the node with use_sim_time:=true")
    assert fits.found == "0.005 s when they come (spread 0.000 s) by simulated time (/clock)"
    other = finding("age", arrivals=changed(**bag, clock_ns=lambda k: 500 * S + k * 100 * MS))
    assert (other.level, "of this machine's clock neither" in other.advice) == ("warn", True)
    beside = finding("age", arrivals=changed(clock_ns=500 * S))
    assert (beside.level, "use_sim_time:=false" in beside.advice) == ("ok", True)


def test_stamps_in_disorder_are_told_as_in_a_bag() -> None:
    assert finding("stamp order", arrivals=changed(stamp_ns=lambda k: START + (k % 50) * S)).found == "1 backwards"
    zero = check_heard(heard(arrivals=changed(stamp_ns=0)))
    assert [f.name for f in zero if f.level == "error"] == ["/points stamps"]
    assert not [f for f in zero if f.name == "/points age"]


def test_frames_that_change_and_frames_of_the_world() -> None:
    frames = finding("frame", arrivals=changed(frame_id=lambda k: "lidar" if k < 60 else "camera"))
    assert (frames.level, frames.found) == ("warn", "lidar, camera")
    assert finding("frame", arrivals=changed(frame_id="map")).level == "warn"


@pytest.mark.parametrize(
    ("publisher", "words"),
    [
        (BEST_EFFORT, "reliable ones would get nothing"),
        (
            RELIABLE,
            "for every cloud reliable:=true (launch), or -p qos_overrides./points.subscription.reliability:=rel",
        ),
    ],
)
def test_what_the_node_may_ask_of_a_publisher(publisher: Endpoint, words: str) -> None:
    offered = finding("publisher /driver", publishers=(publisher,))
    assert (offered.level, words in offered.advice) == ("ok", True)
    assert offered.found == f"{publisher.reliability}, volatile, depth not told"


def test_several_publishers_and_another_type_are_warned_of() -> None:
    assert finding("publishers", publishers=(RELIABLE, RELIABLE)).found == "2 on one topic"
    other = finding("publisher /livox", publishers=(RELIABLE, Endpoint("/livox", LIVOX_TYPE, "reliable", "volatile")))
    assert (other.level, other.found) == ("warn", LIVOX_TYPE)


@pytest.mark.parametrize(
    ("reliability", "durability", "override"),
    [
        ("best effort", "volatile", ""),
        ("reliable", "volatile", "-p qos_overrides./points.subscription.reliability:=best_effort"),
        ("best effort", "transient local", "-p qos_overrides./points.subscription.durability:=volatile"),
    ],
)
def test_a_subscription_that_asks_for_too_much_comes_with_its_override(
    reliability: str, durability: str, override: str
) -> None:
    listener = Endpoint("/svc_registration", CLOUD_TYPE, reliability, durability, 5)
    told = finding("subscription /svc_registration", subscriptions=(listener,))
    assert (told.level, told.advice.endswith(override)) == ("warn" if override else "ok", True)
    assert ("gets nothing from /driver" in told.found) == bool(override)
    assert told.found.startswith(f"{reliability}, {durability}, depth 5")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"publishers": ()}, "no ROS node is seen at all: start the driver, or set what is set in its terminal (here"),
        ({"publishers": (), "num_nodes": 2}, "nobody publishes it; topics with clouds: none"),
        ({"publishers": (), "cloud_topics": ("/a", "/b")}, "nobody publishes it; topics with clouds: /a, /b"),
        (
            {"publishers": (Endpoint("/sick", "sensor_msgs/msg/LaserScan", "reliable", "volatile"),)},
            "expected sensor_msgs/msg/PointCloud2, found sensor_msgs/msg/LaserScan of /sick: a plane of points",
        ),
        (
            {
                "publishers": (Endpoint("/talker", "std_msgs/msg/String", "reliable", "volatile"),),
                "cloud_topics": ("/a",),
            },
            "found std_msgs/msg/String of /talker: topics with clouds: /a",
        ),
        (
            {"publishers": (Endpoint("/livox", LIVOX_TYPE, "reliable", "volatile"),)},
            "source the driver's workspace in this terminal",
        ),
    ],
)
def test_a_topic_without_clouds_is_refused_with_what_there_is(values, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        check_heard(heard(type="", arrivals=(), kept={}, **values))
    assert str(refusal.value).startswith("/points: ")
    assert words in str(refusal.value)


class TestCommand:
    def test_findings_as_a_table_and_as_json(self, monkeypatch: pytest.MonkeyPatch) -> None:
        asked = []

        def listen(topic: str, seconds: float) -> Heard:
            asked.append((topic, seconds))
            return heard(arrivals=changed(stamp_ns=0))

        monkeypatch.setattr(live, "listen", listen)
        result = run("doctor", "--live", "points", "--no-trial", "--json", "-")
        assert (result.exit_code, asked) == (2, [("points", 10.0)])
        told = json.loads(result.stdout)
        assert told["num_errors"] == 1
        assert {"name", "level", "found", "advice"} == set(told["findings"][0])
        assert "checks failed: /points stamps" in result.stderr
        run("doctor", "--live", "points", "--seconds", "3", "--no-trial")
        assert asked[-1] == ("points", 3.0)

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--seconds", "5"), "--seconds belongs to --live"),
            (("bag", "--live", "points"), "give one of them"),
            (("--live", "points", "--topic", "other"), "--topic belongs to a BAG"),
            (("--live", "points", "--seconds", "0"), "--seconds"),
        ],
    )
    def test_options_that_do_not_go_together(self, options: tuple[str, ...], words: str) -> None:
        assert_refused(run("doctor", *options), words)

    def test_without_rclpy_it_says_how_to_get_it(self, monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
        (tmp_path / "rclpy.py").write_text("raise ImportError('no rclpy here')")
        monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{':'.join(sys.path)}")
        assert_refused(run("doctor", "--live", "points"), "cannot listen to points", "pip install 'svc_ros[ros]'")
