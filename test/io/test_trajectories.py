"""Trajectory files: round trips, exact stamps, malformed lines; and poses between the recorded ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.se3 import make_pose, pose_error
from svc_ros.io.stamps import ns_from_text, text_from_ns
from svc_ros.io.trajectories import Trajectory, read_kitti, read_tum, write_kitti, write_tum

S = 1_000_000_000
GOOD_TUM = "1630577758.569489956 1 2 3 0 0 0 1"
GOOD_KITTI = "1 0 0 4 0 1 0 5 0 0 1 6"


@pytest.fixture
def trajectory() -> Trajectory:
    rng = np.random.default_rng(7)
    poses = make_pose(Rotation.from_rotvec(rng.normal(size=(20, 3))).as_matrix(), rng.normal(size=(20, 3)) * 100)
    return Trajectory(1_630_577_758_569_489_956 + np.arange(20) * 499_457_121, poses)


def line_file(folder: Path, *lines: str) -> Path:
    path = folder / "poses.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_tum_round_trip_keeps_every_nanosecond(tmp_path: Path, trajectory: Trajectory) -> None:
    write_tum(tmp_path / "a.txt", trajectory)
    back = read_tum(tmp_path / "a.txt")
    np.testing.assert_array_equal(back.stamps_ns, trajectory.stamps_ns)
    np.testing.assert_allclose(back.poses, trajectory.poses, atol=1e-9)


def test_kitti_round_trip(tmp_path: Path, trajectory: Trajectory) -> None:
    write_kitti(tmp_path / "a.txt", trajectory.poses)
    np.testing.assert_allclose(read_kitti(tmp_path / "a.txt"), trajectory.poses, atol=1e-9)


def test_comments_and_blank_lines_are_skipped(tmp_path: Path) -> None:
    path = line_file(tmp_path, "# t x y z qx qy qz qw", "", GOOD_TUM + " # first", "   ", "1630577759 1 2 3 0 0 0 1")
    assert read_tum(path).stamps_ns.tolist() == [1_630_577_758_569_489_956, 1_630_577_759 * S]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1630577759 1 2 3 0 0 0", "expected t x y z qx qy qz qw, found 7 values"),
        (GOOD_TUM.replace("58.", "59.") + " 9", "found 9 values"),
        ("1630577759 1 2 x 0 0 0 1", "expected numbers, .*'x'"),
        ("1630577759 1 nan 3 0 0 0 1", "expected finite numbers"),
        ("later 1 2 3 0 0 0 1", "expected seconds as a number, found 'later'"),
        ("inf 1 2 3 0 0 0 1", "fit 64 bits"),
        ("1630577759 1 2 3 0 0 0 1.002", "length 1.002"),
        ("1630577759 1 2 3 0 0 0 0", "length 0"),
        (GOOD_TUM, "expected a stamp after 1630577758.569489956 s"),
        ("1630577758.569489955 1 2 3 0 0 0 1", "expected a stamp after"),
    ],
)
def test_malformed_tum_lines_are_named(tmp_path: Path, line: str, message: str) -> None:
    path = line_file(tmp_path, "# a comment counts as a line", GOOD_TUM, line)
    with pytest.raises(InputError, match=rf"poses\.txt:3: .*{message}"):
        read_tum(path)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 0 0 4 0 1 0 5 0 0 1", "12 numbers of a 3x4 matrix, found 11 values"),
        ("1 0 0 4 0 1 0 5 0 0 1 x", "expected numbers"),
        ("1 0 0 4 0 1 0 5 0 0 1 inf", "expected finite numbers"),
        ("1 0 0 4 0 1 0 5 0 0 -1 6", "not a rotation"),
        ("0 0 0 4 0 0 0 5 0 0 0 6", "not a rotation"),
    ],
)
def test_malformed_kitti_lines_are_named(tmp_path: Path, line: str, message: str) -> None:
    path = line_file(tmp_path, GOOD_KITTI, line)
    with pytest.raises(InputError, match=rf"poses\.txt:2: .*{message}"):
        read_kitti(path)


def test_rounded_rotations_are_made_rotations_again(tmp_path: Path) -> None:
    R = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    rows = " ".join(f"{v:.4f}" for v in np.hstack([R, [[1.0], [2.0], [3.0]]]).ravel())
    T = read_kitti(line_file(tmp_path, rows))[0]
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-14)
    assert pose_error(T, make_pose(R, [1, 2, 3]))[0] < 0.01


@pytest.mark.parametrize("read", [read_tum, read_kitti])
def test_files_that_are_no_trajectory(tmp_path: Path, read: object) -> None:
    assert callable(read)
    with pytest.raises(InputError, match=r"absent\.txt: .*No such file"):
        read(tmp_path / "absent.txt")
    with pytest.raises(InputError, match="found none"):
        read(line_file(tmp_path, "# only a comment"))
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="not a text file"):
        read(tmp_path / "binary")


def test_writing_where_nothing_can_be_written(tmp_path: Path, trajectory: Trajectory) -> None:
    with pytest.raises(InputError, match=r"nowhere.*cannot be written"):
        write_tum(tmp_path / "nowhere" / "a.txt", trajectory)


def test_at_returns_recorded_poses_and_interpolates_between_them(trajectory: Trajectory) -> None:
    for k in (0, 7, 19):
        np.testing.assert_array_equal(trajectory.at(int(trajectory.stamps_ns[k])), trajectory.poses[k])
    first, second = trajectory.poses[:2]
    middle = trajectory.at(int(trajectory.stamps_ns[0]) + 499_457_121 // 2)
    np.testing.assert_allclose(middle[:3, 3], (first[:3, 3] + second[:3, 3]) / 2, atol=1e-6)
    assert pose_error(middle, first)[0] == pytest.approx(pose_error(second, first)[0] / 2, abs=1e-5)


def test_at_outside_the_span_is_an_error_beyond_the_tolerance(trajectory: Trajectory) -> None:
    first, last = int(trajectory.stamps_ns[0]), int(trajectory.stamps_ns[-1])
    np.testing.assert_array_equal(trajectory.at(first - 5, tolerance_ns=5), trajectory.poses[0])
    np.testing.assert_array_equal(trajectory.at(last + 5, tolerance_ns=5), trajectory.poses[-1])
    for stamp in (first - 6, last + 6):
        with pytest.raises(TransformUnavailableError, match=text_from_ns(stamp)):
            trajectory.at(stamp, tolerance_ns=5)
    np.testing.assert_array_equal(trajectory.at(first - 36), trajectory.poses[0])
    with pytest.raises(TransformUnavailableError):
        trajectory.at(last + 1_000_001)


def test_a_trajectory_checks_its_stamps_and_shapes() -> None:
    with pytest.raises(InputError, match="increasing"):
        Trajectory(np.array([1, 1]), np.stack([np.eye(4)] * 2))
    with pytest.raises(InputError, match="poses"):
        Trajectory(np.array([1, 2]), np.eye(4)[None])


@pytest.mark.parametrize("stamp_ns", [0, 1, -1, -1_500_000_000, 1_630_577_758_569_489_956, 2**63 - S])
def test_stamps_survive_text(stamp_ns: int) -> None:
    assert ns_from_text(text_from_ns(stamp_ns)) == stamp_ns


def test_the_reference_of_the_walk_loads_exactly(shared_data: Path) -> None:
    reference = read_tum(shared_data / "bags" / "os0_64_walk" / "reference_tum.txt")
    assert int(reference.stamps_ns[0]) == 1_630_577_758_569_489_956
    assert int(reference.stamps_ns[1]) == 1_630_577_759_068_947_077
    assert reference.poses[1, 1, 3] == -0.006718536
