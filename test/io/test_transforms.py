"""TransformTree: chains of frames, interpolation, and every way in which a transform can be missing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.se3 import invert, make_pose, pose_error
from svc_ros.io.transforms import TransformTree, interpolate_poses

S = 1_000_000_000
START = 1_700_000_000 * S


def pose(x: float, yaw_deg: float = 0.0) -> np.ndarray:
    return make_pose(Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix(), [x, 0.0, 0.5])


@pytest.fixture
def tree() -> TransformTree:
    """map -> odom (timed) -> base (timed) -> lidar (static), and base -> camera (static)."""
    tree = TransformTree()
    for k in (2, 0, 1):  # out of order on purpose
        tree.add("map", "odom", START + k * S, pose(10.0 * k, 10.0 * k))
        tree.add("odom", "/base", START + k * S, pose(float(k), -20.0 * k))
    tree.add("base", "lidar", 0, pose(0.3, 90.0), static=True)
    tree.add("base", "camera", 0, pose(0.6, -90.0), static=True)
    return tree


def test_a_chain_is_the_product_of_its_edges(tree: TransformTree) -> None:
    expected = pose(10.0, 10.0) @ pose(1.0, -20.0) @ pose(0.3, 90.0)
    np.testing.assert_allclose(tree.lookup("map", "lidar", START + S), expected, atol=1e-12)


def test_the_reverse_look_up_is_the_inverse(tree: TransformTree) -> None:
    stamp = START + 1_234_567_891
    forward, backward = tree.lookup("map", "lidar", stamp), tree.lookup("lidar", "map", stamp)
    np.testing.assert_allclose(backward, invert(forward), atol=1e-12)


def test_siblings_meet_in_their_common_ancestor_whatever_the_time(tree: TransformTree) -> None:
    # Neither edge above `base` is recorded at this time, and none is needed.
    T = tree.lookup("camera", "lidar", START - 99 * S)
    np.testing.assert_allclose(T, invert(pose(0.6, -90.0)) @ pose(0.3, 90.0), atol=1e-12)


def test_between_two_samples_the_pose_is_interpolated(tree: TransformTree) -> None:
    T = tree.lookup("map", "odom", START + S // 4)
    rotation_deg, translation_m = pose_error(T, pose(2.5, 2.5))
    assert rotation_deg < 1e-9
    assert translation_m < 1e-9


def test_interpolation_takes_the_short_way_round() -> None:
    T = interpolate_poses(pose(0.0, 179.0), pose(2.0, -179.0), 0.5)
    rotation_deg, translation_m = pose_error(T, pose(1.0, 180.0))
    assert rotation_deg < 1e-9
    assert translation_m < 1e-12


def test_at_a_sample_the_answer_is_that_sample_to_the_nanosecond(tree: TransformTree) -> None:
    np.testing.assert_allclose(tree.lookup("map", "odom", START + 2 * S), pose(20.0, 20.0), atol=1e-14)


def test_a_leading_slash_is_the_same_frame(tree: TransformTree) -> None:
    np.testing.assert_array_equal(tree.lookup("/map", "/lidar", START), tree.lookup("map", "lidar", START))
    assert tree.frames == ["base", "camera", "lidar", "map", "odom"]


def test_a_frame_to_itself_is_identity_even_if_unknown() -> None:
    np.testing.assert_array_equal(TransformTree().lookup("lidar", "/lidar", START), np.eye(4))


@pytest.mark.parametrize("offset_ns", [-1, 2 * S + 1])
def test_outside_the_recorded_span_names_frames_and_times(tree: TransformTree, offset_ns: int) -> None:
    with pytest.raises(TransformUnavailableError) as caught:
        tree.lookup("map", "lidar", START + offset_ns)
    asked = "1699999999.999999999" if offset_ns < 0 else "1700000002.000000001"
    for part in ("map <- lidar", asked, "1700000000.000000000", "1700000002.000000000"):
        assert part in str(caught.value)


def test_an_unknown_frame_lists_the_frames_there_are(tree: TransformTree) -> None:
    with pytest.raises(TransformUnavailableError, match=r"no frame 'radar' .*base, camera, lidar, map, odom"):
        tree.lookup("map", "radar", START)
    with pytest.raises(TransformUnavailableError, match="frames recorded: none"):
        TransformTree().lookup("map", "radar", START)


def test_unconnected_frames_are_named_with_their_roots(tree: TransformTree) -> None:
    tree.add("world", "drone", 0, np.eye(4), static=True)
    with pytest.raises(TransformUnavailableError, match=r"not connected \(map hangs on map, drone on world"):
        tree.lookup("map", "drone", START)


def test_a_gap_longer_than_allowed_is_not_bridged() -> None:
    tree = TransformTree(max_gap_ns=S)
    for k in (0, 1, 5):
        tree.add("map", "base", START + k * S, pose(float(k)))
    assert tree.lookup("map", "base", START + S // 2)[0, 3] == pytest.approx(0.5)
    assert tree.lookup("map", "base", START + 5 * S)[0, 3] == pytest.approx(5.0)
    with pytest.raises(TransformUnavailableError, match=r"map -> base: .*largest gap of 1\.000000000 s"):
        tree.lookup("map", "base", START + 3 * S)


def test_a_single_timed_sample_answers_at_its_stamp_only() -> None:
    tree = TransformTree()
    tree.add("map", "base", START, pose(1.0))
    assert tree.lookup("map", "base", START)[0, 3] == 1.0
    with pytest.raises(TransformUnavailableError):
        tree.lookup("map", "base", START + 1)


def test_samples_added_after_a_look_up_count(tree: TransformTree) -> None:
    tree.lookup("map", "odom", START + S // 2)
    tree.add("map", "odom", START + 4 * S, pose(40.0, 20.0))
    assert tree.lookup("map", "odom", START + 3 * S)[0, 3] == pytest.approx(30.0)


def test_two_parents_and_loops_are_refused_when_asked_for(tree: TransformTree) -> None:
    tree.add("world", "lidar", 0, np.eye(4), static=True)
    with pytest.raises(TransformUnavailableError, match=r"'lidar' has more than one parent \(base, world\)"):
        tree.lookup("map", "lidar", START)
    assert tree.lookup("base", "camera", START)[0, 3] == pytest.approx(0.6)
    tree.add("a", "b", 0, np.eye(4), static=True)
    tree.add("b", "a", 0, np.eye(4), static=True)
    with pytest.raises(TransformUnavailableError, match="a -> b -> a"):
        tree.lookup("a", "b", START)


def test_a_fault_blocks_only_the_frames_that_depend_on_it(tree: TransformTree) -> None:
    tree.mark_faulty("lidar", "transform base -> lidar: its rotation is broken")
    with pytest.raises(TransformUnavailableError, match="its rotation is broken"):
        tree.lookup("map", "lidar", START)
    assert np.isfinite(tree.lookup("map", "camera", START)).all()
    tree.mark_faulty("radar", "transform base -> radar: it holds NaN")  # and nothing else is known of this frame
    with pytest.raises(TransformUnavailableError, match="it holds NaN"):
        tree.lookup("map", "radar", START)


@pytest.mark.parametrize(
    ("parent", "child", "T", "message"),
    [
        ("map", "/map", np.eye(4), "own parent"),
        ("map", "/", np.eye(4), "expected a name"),
        ("map", "base", np.diag([1.0, 1.0, -1.0, 1.0]), "map -> base: .*not a rotation"),
        ("map", "base", np.full((4, 4), np.nan), "map -> base: .*NaN"),
    ],
)
def test_impossible_samples_are_refused(parent: str, child: str, T: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        TransformTree().add(parent, child, START, T)


def test_an_edge_is_either_static_or_timed(tree: TransformTree) -> None:
    with pytest.raises(InputError, match="both as static and over time"):
        tree.add("base", "lidar", START, np.eye(4))


def test_the_input_matrix_is_not_kept() -> None:
    T, tree = pose(1.0), TransformTree()
    tree.add("map", "base", 0, T, static=True)
    T[0, 3] = 7.0
    assert tree.lookup("map", "base", START)[0, 3] == 1.0
