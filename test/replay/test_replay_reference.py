"""How wrong single poses and whole trajectories are, against numbers that are known."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from replay_cases import MOUNTING, STAMPS, WAY, write_reference, write_room_bag
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.errors import InputError, MissingDependencyError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.evaluation.bag_reference import Reference, check_evo, trajectory_errors
from svc_ros.io.bags import Bag
from svc_ros.io.trajectories import Trajectory, write_tum
from svc_ros.pipeline.stream import StreamDecision

SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def bag_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_room_bag(tmp_path_factory.mktemp("reference") / "room")


def turn(*degrees: float) -> np.ndarray:
    return se3.make_pose(Rotation.from_euler("xyz", degrees, degrees=True).as_matrix(), np.zeros(3))


def shift(*metres: float) -> np.ndarray:
    return se3.make_pose(np.eye(3), metres)


def decision(T: np.ndarray | None, source: int = 3, target: int = 1) -> StreamDecision:
    result = RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP, best_candidate=T)
    return StreamDecision(result, STAMPS[source], STAMPS[target], "lidar", "lidar")


def test_errors_of_a_candidate(bag_path: Path, tmp_path: Path) -> None:
    with Bag(bag_path) as bag:
        reference = Reference.read(write_reference(tmp_path / "r.txt"), bag, None)
    truth = se3.invert(WAY[1]) @ WAY[3]
    np.testing.assert_allclose(reference.errors(decision(truth)), (0.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(reference.errors(decision(shift(0.3, 0.4, 0.0) @ truth)), (0.0, 0.5), atol=1e-6)
    assert reference.errors(decision(truth @ turn(0, 0, 7)))[0] == pytest.approx(7.0, abs=1e-6)
    assert reference.errors(decision(None)) is None


def test_a_reference_of_another_frame(bag_path: Path, tmp_path: Path) -> None:
    """Poses of base_link become those of the clouds by the bag's transforms."""
    base = np.array([T @ se3.invert(MOUNTING) for T in WAY])
    write_tum(tmp_path / "base.txt", Trajectory(np.array(STAMPS), base))
    with Bag(bag_path) as bag:
        reference = Reference.read(tmp_path / "base.txt", bag, "/base_link")
        with pytest.raises(InputError, match=r"mast: not among the frames of the bag .*base_link"):
            Reference.read(tmp_path / "base.txt", bag, "mast")
    np.testing.assert_allclose(reference.pose(STAMPS[2], "lidar"), WAY[2], atol=1e-9)
    np.testing.assert_allclose(reference.of_clouds("lidar").poses, WAY, atol=1e-9)
    assert reference.pose(STAMPS[2], "camera") is None


def test_outside_the_reference_there_is_no_error(bag_path: Path, tmp_path: Path) -> None:
    write_tum(tmp_path / "short.txt", Trajectory(np.array(STAMPS[:3]), np.array(WAY[:3])))
    with Bag(bag_path) as bag:
        reference = Reference.read(tmp_path / "short.txt", bag, None)
    assert reference.errors(decision(np.eye(4), 3, 1)) is None
    assert reference.errors(decision(np.eye(4), 1, 3)) is None
    assert reference.errors(decision(np.eye(4), 2, 1)) is not None


def loop_of_poses(num: int = 40) -> np.ndarray:
    """Once around an ellipse, uphill, looking ahead."""
    angle = np.linspace(0.0, 2.0 * np.pi, num)
    turns = Rotation.from_euler("zy", np.column_stack([angle, 0.1 * np.sin(angle)])).as_matrix()
    places = np.column_stack([8.0 * np.cos(angle), 5.0 * np.sin(angle), 0.3 * angle])
    return np.array([se3.make_pose(R, t) for R, t in zip(turns, places, strict=True)])


def errors_of(estimated: np.ndarray, reference: np.ndarray) -> dict:
    return trajectory_errors(np.arange(len(estimated)) * SECOND, estimated, reference)


def test_where_a_trajectory_begins_does_not_matter() -> None:
    truth = loop_of_poses()
    moved = shift(100.0, -40.0, 3.0) @ turn(10, 20, 130) @ truth
    found = errors_of(moved, truth)
    assert found["num_poses_compared"] == 40
    for kind in ("ape", "rpe"):
        for name in ("translation_m", "rotation_deg"):
            assert found[kind][name]["max"] < 1e-5, (kind, name)


def test_errors_that_are_known() -> None:
    """Every second pose 0.2 m too high and turned by 4 deg: half of that from the mean, all of it from pose to pose."""
    truth = loop_of_poses()
    wrong = truth.copy()
    wrong[1::2] = shift(0.0, 0.0, 0.2) @ wrong[1::2] @ turn(0, 0, 4)
    wrong[1::2, :3, 3] = truth[1::2, :3, 3] + [0.0, 0.0, 0.2]
    found = errors_of(wrong, truth)
    assert found["ape"]["translation_m"]["rmse"] == pytest.approx(0.1, rel=0.02)
    assert found["ape"]["rotation_deg"]["mean"] == pytest.approx(2.0, rel=0.02)
    assert found["rpe"]["rotation_deg"]["mean"] == pytest.approx(4.0, rel=0.02)
    assert found["rpe"]["translation_m"]["rmse"] > 0.15
    statistics = found["ape"]["translation_m"]
    assert statistics["min"] <= statistics["median"] <= statistics["max"]


def test_a_straight_way_tells_its_turns_too() -> None:
    """Positions on a line leave a turn about it open; the poses do not."""
    truth = np.array([shift(x, 0.0, 0.0) for x in range(10)], float)
    found = errors_of(turn(50, 0, 0) @ truth, truth)
    assert found["ape"]["rotation_deg"]["max"] < 1e-5
    assert found["ape"]["translation_m"]["max"] < 1e-9
    standing = np.array([np.eye(4)] * 5)
    assert errors_of(standing, standing)["ape"]["translation_m"]["max"] == 0.0


def test_a_scale_is_an_error() -> None:
    truth = loop_of_poses()
    longer = truth.copy()
    longer[:, :3, 3] *= 1.1
    assert errors_of(longer, truth)["ape"]["translation_m"]["rmse"] > 0.3


def test_two_poses_are_not_compared() -> None:
    assert errors_of(loop_of_poses()[:2], loop_of_poses()[:2]) == {"num_poses_compared": 2, "ape": None, "rpe": None}


def test_without_evo_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "evo.core.metrics", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'evo"):
        check_evo()


def test_targets_of_a_map_have_a_reference_of_their_own(bag_path: Path, tmp_path: Path) -> None:
    """Their stamps are of another day, and their poses in the same world."""
    earlier = STAMPS[1] - 86_400 * SECOND
    write_tum(tmp_path / "map.txt", Trajectory(np.array([earlier]), np.array([WAY[2]])))
    found = StreamDecision(decision(se3.invert(WAY[2]) @ WAY[3]).result, STAMPS[3], earlier, "lidar", "lidar")
    with Bag(bag_path) as bag:
        alone = Reference.read(write_reference(tmp_path / "r.txt"), bag, None)
        both = Reference.read(tmp_path / "r.txt", bag, None, tmp_path / "map.txt")
    assert alone.errors(found) is None
    np.testing.assert_allclose(both.errors(found), (0.0, 0.0), atol=1e-6)
