"""A sensor in a map: found without a guess, followed, said to be lost; poses that others tell are right or wrong."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from map_in_memory import MapInMemory
from mini_data import scan_room, sensor_pose
from scipy.spatial.transform import Rotation
from simulated_scans import Place, scan_at

from svc_ros.core import se3
from svc_ros.core.config import Config, preset, with_values
from svc_ros.core.errors import ConfigError
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.scan import Array, Scan
from svc_ros.evaluation.bag_reference import MAX_ROTATION_DEG, MAX_TRANSLATION_M
from svc_ros.io.bags import Bag
from svc_ros.io.trajectories import Trajectory, read_tum
from svc_ros.pipeline.localisation import LocalisationState, Localiser
from svc_ros.pipeline.stream import StreamDecision

S = 1_000_000_000
CONFIG = preset("lidar_indoor")
KNOWN = [sensor_pose(x, 0.1 * x, 12.0 * k) for k, x in enumerate((-3, -2, -1, 0, 1, 2, 3))]
WAY = [sensor_pose(x, -0.5, 200.0 + 9.0 * k) for k, x in enumerate((-2.6, -1.5, -0.4, 0.7, 1.8, 2.9))]
T_ODOM_MAP = sensor_pose(5.0, -3.0, 70.0)
FAR_AWAY = se3.make_pose(np.eye(3), (100.0, 0.0, 0.0))


def known_scans(config: Config = CONFIG, poses: Sequence[Array] = KNOWN) -> MapInMemory:
    return MapInMemory([Scan(scan_room(T, seed=k), k * S, "lidar") for k, T in enumerate(KNOWN)], poses, config)


@pytest.fixture(scope="module")
def room() -> MapInMemory:
    return known_scans()


def scan(k: int, T: Array | None = None) -> Scan:
    return Scan(scan_room(WAY[k] if T is None else T, seed=50 + k), (100 + k) * S, "lidar")


def odometry(k: int) -> Array:
    return np.asarray(T_ODOM_MAP @ WAY[k])


def elsewhere(k: int) -> Scan:
    """What a sensor sees that stands in another building."""
    return Scan(scan_at(Place("indoor", "VLP-16", 3, 20.0))[0].points, (100 + k) * S, "lidar")


def assert_right(decision: StreamDecision, T_map_scan: Array) -> None:
    assert decision.result.accepted, decision.result.detail
    assert decision.T_odom_source is not None
    angle, distance = se3.pose_error(decision.T_odom_source, T_map_scan)
    assert angle < 1.0
    assert distance < 0.1


@pytest.mark.parametrize("with_odometry", [True, False])
def test_a_sensor_is_found_without_a_guess_and_followed(room: MapInMemory, with_odometry: bool) -> None:
    localiser = Localiser(room, CONFIG)
    assert (localiser.state, localiser.T_map_odom) == (LocalisationState.SEARCHING, None)
    origins = []
    for k, T in enumerate(WAY):
        (decision,) = localiser.add(scan(k), odometry(k) if with_odometry else None)
        assert_right(decision, T)
        assert decision.target_stamp_ns in room.stamps_ns
        assert decision.T_odom_target is not None
        origins.append(decision.origin)
    assert origins == ["place", *["motion"] * (len(WAY) - 1)]
    assert localiser.state is LocalisationState.LOCALISED
    if with_odometry:
        assert localiser.T_map_odom is not None
        assert se3.pose_error(localiser.T_map_odom, se3.invert(T_ODOM_MAP))[1] < 0.1


def test_what_one_scan_is_not_sure_of_waits_for_others_some_way_on(room: MapInMemory) -> None:
    localiser = Localiser(room, with_values(CONFIG, {"localization.sure_probability": 1.0}))
    (first,), (second,), (third,) = (localiser.add(scan(k), odometry(k)) for k in range(3))
    assert [d.result.reason for d in (first, second)] == [Reason.AMBIGUOUS] * 2
    assert "1 of 3 scans" in first.result.detail
    assert "2 of 3 scans" in second.result.detail
    assert_right(third, WAY[2])
    assert third.origin == "run"


def test_a_standing_sensor_agrees_with_itself_only(room: MapInMemory) -> None:
    localiser = Localiser(room, with_values(CONFIG, {"localization.sure_probability": 1.0}))
    for k in range(4):
        (decision,) = localiser.add(scan(k, WAY[0]), odometry(0))
        assert decision.result.verdict is Verdict.UNDECIDED
    assert localiser.state is LocalisationState.SEARCHING


def test_of_two_rooms_that_are_alike_none_is_chosen() -> None:
    """Each scan alone is sure of the one that it is registered to: the other is as good."""
    twice = known_scans()
    twice.keyframes += twice.keyframes
    twice.poses = np.concatenate([twice.poses, FAR_AWAY @ twice.poses])
    localiser = Localiser(twice, CONFIG)
    for k in range(4):
        (decision,) = localiser.add(scan(k), odometry(k))
        assert (decision.result.verdict, decision.result.reason) == (Verdict.UNDECIDED, Reason.AMBIGUOUS)
        assert decision.T_odom_source is None
        assert "2 places" in decision.result.detail


def test_one_scan_of_the_rooms_mirror_image_is_no_place(room: MapInMemory) -> None:
    """Walls, floor and ceiling are the same: only furniture tells, and the probability is 0.99."""
    points = scan_room(sensor_pose(-0.49, 1.39, -96.4), seed=751) * (1.0, -1.0, 1.0)
    localiser = Localiser(room, with_values(CONFIG, {"localization.max_similar": 1}))
    (decision,) = localiser.add(Scan(points, 100 * S, "lidar"), odometry(0))
    assert decision.result.probability is not None
    assert decision.result.probability > 0.98
    assert (decision.result.verdict, decision.result.reason) == (Verdict.UNDECIDED, Reason.AMBIGUOUS)
    assert localiser.state is LocalisationState.SEARCHING


@pytest.mark.parametrize("with_odometry", [True, False])
def test_a_kidnapped_sensor_is_found_again(room: MapInMemory, with_odometry: bool) -> None:
    """Odometry feels nothing of the way; or there is none."""
    localiser = Localiser(room, CONFIG)
    localiser.add(scan(0), odometry(0) if with_odometry else None)
    moved = sensor_pose(3.0, 1.5, -60.0)
    (decision,) = localiser.add(scan(1, moved), odometry(0) if with_odometry else None)
    assert_right(decision, moved)


def test_in_another_building_it_is_lost_and_tells_no_pose(room: MapInMemory) -> None:
    localiser = Localiser(room, with_values(CONFIG, {"localization.max_similar": 1}))
    localiser.add(scan(0), odometry(0))
    (decision,) = localiser.add(elsewhere(1), odometry(1))
    assert not decision.result.accepted
    assert decision.T_odom_source is None
    assert (localiser.state, localiser.T_map_odom) == (LocalisationState.LOST, None)
    (decision,) = localiser.add(scan(2), odometry(2))
    assert_right(decision, WAY[2])


def test_what_nothing_confirms_is_lost_after_a_while() -> None:
    """Of a way out of the map no scan says that it is wrong."""
    localiser = Localiser(known_scans(), with_values(CONFIG, {"localization.lost_after_s": 1.5}))
    localiser.add(scan(0), odometry(0))
    gone = [Scan(scan_room(WAY[k]), (100 + k) * S, "lidar") for k in (1, 2)]
    states = []
    for k, later in enumerate(gone, 1):
        (decision,) = localiser.add(later, T_ODOM_MAP @ FAR_AWAY @ WAY[k])
        states.append(localiser.state)
        assert not decision.result.accepted
    assert states == [LocalisationState.LOCALISED, LocalisationState.LOST]


def test_who_sees_nothing_any_more_is_lost_as_well(room: MapInMemory) -> None:
    """A covered sensor: no scan can be used, and none says that its place is wrong."""
    localiser = Localiser(room, with_values(CONFIG, {"localization.lost_after_s": 1.5}))
    localiser.add(scan(0), odometry(0))
    blind = np.ones((5, 3))
    for second, state in ((101, LocalisationState.LOCALISED), (102, LocalisationState.LOST)):
        (decision,) = localiser.add(Scan(blind, second * S, "lidar"), odometry(0))
        assert decision.result.reason is Reason.TOO_FEW_POINTS
        assert localiser.state is state
    assert localiser.T_map_odom is None
    localiser = Localiser(room, with_values(CONFIG, {"localization.lost_after_s": 1.5}))
    localiser.add(scan(0), odometry(0))
    localiser.pass_over(101 * S)
    assert localiser.state is LocalisationState.LOCALISED
    localiser.pass_over(102 * S)
    assert localiser.state is LocalisationState.LOST


TURN = se3.make_pose(Rotation.from_euler("z", 20.0, degrees=True).as_matrix(), np.zeros(3))
ERRORS = [se3.make_pose(np.eye(3), shift) for shift in ((2.0, 0, 0), (0, -2.0, 0), (5.0, 0, 0), (0, 10.0, 0))]


def test_told_poses_that_are_wrong_are_called_so_at_once_and_true_ones_never(room: MapInMemory) -> None:
    localiser = Localiser(room, CONFIG)
    localiser.add(scan(0), odometry(0))
    for number, wrong in enumerate([*(error @ WAY[1] for error in ERRORS), WAY[1] @ TURN]):
        for T, is_wrong in ((wrong, True), (WAY[1], False)):
            about_told, own = localiser.add(scan(2 + 2 * number + (not is_wrong), WAY[1]), odometry(1), T)
            assert about_told.origin == "told"
            assert (about_told.result.verdict is Verdict.REJECTED) == is_wrong == localiser.is_told_wrong
            assert about_told.result.accepted != is_wrong
            assert_right(own, WAY[1])


def test_a_told_pose_that_sight_lines_deny_is_wrong_also_where_nobody_knows_better(room: MapInMemory) -> None:
    localiser = Localiser(room, with_values(CONFIG, {"localization.max_similar": 1}))
    wider = Scan(scan_room(WAY[0]) * (1.5, 1.5, 1.0), 100 * S, "lidar")
    told, own = localiser.add(wider, odometry(0), WAY[0])
    assert not own.result.accepted
    assert told.result.verdict is Verdict.REJECTED
    assert localiser.is_told_wrong


def test_a_told_pose_alone_is_no_place_where_places_may_look_alike(room: MapInMemory) -> None:
    """What others tell makes sight lines no surer."""
    localiser = Localiser(room, with_values(CONFIG, {"localization.sure_probability": 1.0}))
    for decision in localiser.add(scan(0), odometry(0), WAY[0]):
        assert decision.result.verdict is Verdict.UNDECIDED
        assert decision.T_odom_source is None
    assert not localiser.is_told_wrong


def test_who_sees_one_wall_only_is_not_lost_for_that_nor_is_a_true_pose_wrong() -> None:
    """Along the wall refinement slides half a metre, and turns."""
    config = with_values(CONFIG, {"localization.max_similar": 0, "preprocess.min_points": 30})
    localiser, T = Localiser(known_scans(config), config), sensor_pose(5.0, -1.0, 0.0)
    localiser.add(scan(0, T), T, T)
    points = scan_room(T, seed=77)
    sideways, up = points[:, 1] / points[:, 0], points[:, 2] / np.hypot(points[:, 0], points[:, 1])
    narrow = points[(points[:, 0] > 0.0) & (np.abs(sideways) < 0.84) & (np.abs(up) < 0.27)]
    told, own = localiser.add(Scan(narrow, 101 * S, "lidar"), T, T)
    assert own.result.verdict is Verdict.REJECTED
    assert (told.result.verdict, told.result.reason) == (Verdict.UNDECIDED, Reason.INSUFFICIENT_EVIDENCE)
    assert localiser.state is LocalisationState.LOCALISED


def test_a_told_pose_that_leads_out_of_the_map_is_not_wrong_for_that(room: MapInMemory) -> None:
    localiser = Localiser(room, with_values(CONFIG, {"localization.max_similar": 0}))
    told, own = localiser.add(elsewhere(0), odometry(0), se3.make_pose(np.eye(3), (30.0, 10.0, 0.0)) @ WAY[0])
    assert not own.result.accepted
    assert (told.result.verdict, told.result.reason) == (Verdict.UNDECIDED, Reason.INSUFFICIENT_EVIDENCE)
    assert not localiser.is_told_wrong


def test_a_told_pose_is_a_place_to_look_at(room: MapInMemory) -> None:
    none = with_values(CONFIG, {"localization.max_similar": 0})
    (decision,) = Localiser(room, none).add(scan(0), odometry(0))
    assert decision.result.verdict is Verdict.UNDECIDED
    assert "no keyframe" in decision.result.detail
    told, own = Localiser(room, none).add(scan(0), odometry(0), ERRORS[1] @ WAY[0])
    assert told.result.verdict is Verdict.REJECTED
    assert_right(own, WAY[0])


def test_scans_that_cannot_be_used_and_jumps_in_time(room: MapInMemory) -> None:
    localiser = Localiser(room, CONFIG)
    localiser.add(scan(1), odometry(1))
    (few,) = localiser.add(Scan(np.ones((5, 3)), 102 * S, "lidar"))
    (no_pose,) = localiser.add(scan(3), odometry(3), np.full((4, 4), np.nan))
    (late,) = localiser.add(scan(3), odometry(3))
    assert few.result.reason is Reason.TOO_FEW_POINTS
    assert "T_map_told" in no_pose.result.detail
    assert late.result.reason is Reason.STALE
    assert localiser.state is LocalisationState.LOCALISED
    (again,) = localiser.add(scan(0), odometry(0))
    assert again.origin == "place"


def test_scans_prepared_in_another_way_than_the_map_are_refused(room: MapInMemory) -> None:
    for values in ({"preprocess.voxel_size_m": 0.25}, {"features.radius_voxels": 5.0}):
        with pytest.raises(ConfigError, match=next(iter(values)).split(".")[0]):
            Localiser(room, with_values(CONFIG, values))


WALK_SCANS = 89


@pytest.fixture(scope="module")
def walk(shared_data: Path) -> tuple[list[Scan], Trajectory, Trajectory]:
    """Scans, drifting odometry, and where they were."""
    folder = shared_data / "bags" / "os0_64_walk"
    with Bag(folder / "ros2_mcap") as bag:
        scans = [reading.scan for reading in bag.scans()]
    assert len(scans) == WALK_SCANS
    return scans, read_tum(folder / "odometry_tum.txt"), read_tum(folder / "reference_tum.txt")


def localise_walk(
    walk: tuple[list[Scan], Trajectory, Trajectory], known: Sequence[int], wanted: Sequence[int], gap: int = 0
) -> tuple[int, int, int]:
    """Numbers of right, wrong and other places of the wanted scans in a map of every other known one.

    gap: so many scans before the middle of the wanted ones are left out, and odometry feels nothing of them.
    """
    scans, odom, reference = walk
    poses = [odom.at(scans[k].stamp_ns) for k in known[::2]]
    localiser = Localiser(MapInMemory([scans[k] for k in known[::2]], poses, CONFIG), CONFIG)
    numbers = [0, 0, 0]
    middle = len(wanted) // 2
    T_jump = np.eye(4)
    if gap:
        before, after = (odom.at(scans[wanted[k]].stamp_ns) for k in (middle - gap, middle))
        T_jump = before @ se3.invert(after)
    for number, k in enumerate(wanted):
        if middle - gap <= number < middle:
            continue
        pose = odom.at(scans[k].stamp_ns)
        (decision,) = localiser.add(scans[k], T_jump @ pose if number >= middle else pose)
        if not decision.result.accepted:
            numbers[2] += 1
            continue
        target = reference.at(decision.target_stamp_ns)
        T = se3.invert(target) @ reference.at(scans[k].stamp_ns)
        angle, distance = se3.pose_error(decision.result.T_target_source, T)
        numbers[angle > MAX_ROTATION_DEG or distance > MAX_TRANSLATION_M] += 1
    return numbers[0], numbers[1], numbers[2]


@pytest.mark.slow
@pytest.mark.parametrize("is_reversed", [False, True])
def test_one_half_of_a_walk_is_found_in_a_map_of_the_other(
    walk: tuple[list[Scan], Trajectory, Trajectory], is_reversed: bool
) -> None:
    """All of these scans overlap the map by 0.3 or more."""
    halves = list(range(44)), list(range(44, WALK_SCANS))
    known, wanted = reversed(halves) if is_reversed else halves
    right, wrong, _ = localise_walk(walk, known, wanted)
    assert wrong == 0
    assert right >= 0.9 * len(wanted)


@pytest.mark.slow
def test_after_a_kidnapping_it_is_right_again_or_undecided(walk: tuple[list[Scan], Trajectory, Trajectory]) -> None:
    for first, last in ((44, 64), (54, 74), (60, 80), (64, 84), (69, 89)):
        right, wrong, _ = localise_walk(walk, list(range(44)), list(range(first, last)), gap=5)
        assert wrong == 0
        assert right >= 10
