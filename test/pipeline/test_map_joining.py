"""Which loops between two maps become edges: those that confirm each other, not those that drift would forgive."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from svc_ros.core import se3
from svc_ros.core.config import preset
from svc_ros.core.errors import InputError
from svc_ros.io.g2o import GraphEdge, PoseGraph
from svc_ros.pipeline.mapping import joining
from svc_ros.pipeline.mapping.confirming import JoiningLoop, LoopJudge

CONFIG = preset("lidar_indoor")
COVARIANCE = np.diag([1e-4] * 3 + [1e-6] * 3)
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def way(xs: Iterable[float], more: Sequence[tuple[int, int]] = ()) -> PoseGraph:
    """Keyframes along x, each joined to the next one, and those of `more`."""
    poses = np.array([se3.make_pose(np.eye(3), (float(x), 0.0, 0.0)) for x in xs])
    pairs = [*((k + 1, k) for k in range(len(poses) - 1)), *more]
    return PoseGraph(poses, [GraphEdge(s, t, se3.invert(poses[t]) @ poses[s], COVARIANCE) for s, t in pairs])


STRAIGHT = way(range(200))


def loop(source: int, target: int, slip_m: float = 0.0, turn: np.ndarray | None = None) -> JoiningLoop:
    """Between two ways along x, exact but for a slip along it, or a turn."""
    T = se3.make_pose(np.eye(3) if turn is None else turn, (float(source - target) + slip_m, 0.0, 0.0))
    return JoiningLoop(source, target, T, COVARIANCE)


def core(loops: Sequence[JoiningLoop], first: PoseGraph = STRAIGHT) -> list[int]:
    return LoopJudge(first, STRAIGHT, CONFIG).largest_core(loops)


def test_loops_that_say_the_same_are_told_from_others() -> None:
    right = [loop(1, 0), loop(4, 4, 0.01), loop(8, 9, -0.02)]
    wrong = [loop(2, 2, 3.0), loop(3, 8, -2.0), loop(6, 5, 5.0), loop(8, 8, 9.0)]
    mixed = [wrong[0], right[0], wrong[1], right[1], wrong[2], right[2], wrong[3]]
    assert core(mixed) == [1, 3, 5]
    assert core([]) == []
    assert core([*right[:2], loop(4, 4, turn=QUARTER)]) == [0, 1]


def test_loops_of_one_place_confirm_nothing() -> None:
    assert core([loop(5, 5), loop(5, 6), loop(6, 5), loop(7, 7)]) == []


@pytest.mark.parametrize("farther", [8, 20, 60, 150])
@pytest.mark.parametrize("slip_m", [1.5, 5.0, 20.0])
def test_what_drift_would_forgive_is_not_confirmed(farther: int, slip_m: float) -> None:
    right = [loop(k, k) for k in (10, 14, 18)]
    assert core([*right, loop(18 + farther, 18 + farther, slip_m)]) == [0, 1, 2]


def test_far_loops_are_confirmed_by_those_between() -> None:
    assert core([loop(k, k) for k in range(10, 100, 4)]) == list(range(23))


def test_no_more_drift_is_assumed_than_the_loops_need() -> None:
    """Ten metres apart: where maps are good loops confirm each other, where one has drifted they do not reach."""
    judge = LoopJudge(STRAIGHT, STRAIGHT, CONFIG)
    good = [loop(k, k) for k in (10, 20, 30, 40, 50)]
    assert core(good) == []
    assert judge.surest(good)[1] == [0, 1, 2, 3, 4]
    assert judge.surest([*good, loop(70, 70, 5.0)])[1] == [0, 1, 2, 3, 4]
    assert judge.surest(good[:3])[1] == []  # so few would agree by chance
    drifted = [loop(k, k, 0.05 * k) for k in range(10, 70, 4)]
    assert len(core(drifted)) == 15
    assert judge.surest(drifted)[1] == list(range(15))


def test_a_map_that_was_there_twice_counts_the_shortest_way() -> None:
    """Sixty metres along the way, but an edge says that it is the same place."""
    xs = [*range(30), *range(29, -1, -1)]
    both = [JoiningLoop(5, 5, np.eye(4), COVARIANCE), JoiningLoop(9, 50, np.eye(4), COVARIANCE)]
    assert xs[50] == 9
    assert core(both, way(xs)) == []
    assert core(both, way(xs, [(51, 8)])) == [0, 1]


def joined(by_look: Sequence[JoiningLoop], by_place: dict[int, JoiningLoop], monkeypatch: Any) -> list[tuple[int, int]]:
    """Pairs of the loops that two maps along the same way are joined by, of those found by look and by place."""

    def near(_: object, __: object, ___: object, source: int) -> Iterator[JoiningLoop]:
        yield from [by_place[source]] if source in by_place else []

    class Straight(SimpleNamespace):
        def __len__(self) -> int:
            return len(STRAIGHT.poses)

    one: Any = Straight(poses=STRAIGHT.poses, graph=STRAIGHT, config=CONFIG, runs=[SimpleNamespace(source="walk")])
    monkeypatch.setattr(joining, "_loops_by_look", lambda _, __: iter(by_look))
    monkeypatch.setattr(joining, "_loops_by_place", near)
    return sorted((each.source, each.target) for each in joining.find_joining_loops(one, one))


def test_wrong_loops_far_along_become_no_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    right, wrong = [loop(k, k) for k in (10, 14, 18)], [loop(k, k - 9, -9.0) for k in (70, 74)]
    near_by = {16: loop(16, 16, 1.5), 15: loop(15, 15), 72: loop(72, 63, -9.0)}
    assert joined([*right, *wrong], near_by, monkeypatch) == [(10, 10), (14, 14), (15, 15), (18, 18)]


def test_two_groups_of_which_neither_is_larger_join_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    groups = [loop(10, 10), loop(14, 14), loop(70, 61, -9.0), loop(74, 65, -9.0)]
    with pytest.raises(InputError, match=r"found 4 loops, of which 2 agree: the runs are not joined"):
        joined(groups, {}, monkeypatch)


def test_loops_by_place_lead_to_far_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those by look that nothing reaches at first are judged again, and wrong ones by place do not lead on."""
    ends = [loop(k, k) for k in (10, 14, 70, 74)]
    between = {k: loop(k, k) for k in range(0, 90, 2)}
    expected = sorted((k, k) for k in {*between, 10, 14, 70, 74})
    assert joined(ends, between, monkeypatch) == expected
    astray = {k: loop(k, k, 0.4 * (k - 14)) for k in range(24, 90)}
    assert joined(ends[:2], astray, monkeypatch) == [(10, 10), (14, 14)]


def test_as_many_rivals_join_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    right = [loop(k, k) for k in (10, 14, 18)]
    rivals = [loop(12, 12, 3.0), loop(16, 16, -4.0)]
    assert joined([*right, rivals[0]], {}, monkeypatch) == [(10, 10), (14, 14), (18, 18)]
    with pytest.raises(InputError, match=r"found 5 loops, of which 3 agree"):
        joined([*right, *rivals], {}, monkeypatch)
