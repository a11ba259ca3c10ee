"""Which sight lines and denied points are drawn."""

from __future__ import annotations

import numpy as np

from svc_ros.core.sight.evidence import SeenSurface, SightLines
from svc_ros.report.sight_lines import MAX_DENIED, choose_denied, choose_evenly, choose_lines


def lines(num: int, blocked: list[int]) -> SightLines:
    return SightLines(num, num, np.array(blocked), np.zeros(len(blocked), np.int64))


def test_few_lines_are_all_drawn_and_none_is_both_clear_and_blocked():
    drawn = choose_lines(lines(6, [4, 1, 4]), 6, 10)
    assert drawn.clear_idx.tolist() == [0, 2, 3, 5]
    assert drawn.blocked_idx.tolist() == [1, 4]


def test_many_lines_are_thinned_each_kind_for_itself():
    drawn = choose_lines(lines(1000, list(range(0, 1000, 2))), 1000, 50)
    assert (len(drawn.clear_idx), len(drawn.blocked_idx)) == (50, 50)
    assert set(drawn.clear_idx % 2) == {1}
    assert set(drawn.blocked_idx % 2) == {0}
    assert np.diff(drawn.blocked_idx).max() < 40  # evenly: nowhere a hole


def test_denied_points_are_few_and_from_all_of_them():
    surface = SeenSurface(9000, 100, np.arange(0, 8000, 2), 0.0, 0, 0)
    chosen = choose_denied(surface)
    assert len(chosen) == MAX_DENIED
    assert set(chosen % 2) == {0}
    assert (chosen[0], chosen[-1], np.diff(chosen).max()) == (0, 7998, 10)
    assert choose_denied(surface, 9000).tolist() == surface.denied_idx.tolist()


def test_an_even_choice_keeps_order_and_both_ends():
    chosen = choose_evenly(np.arange(100, 200), 7)
    assert (chosen[0], chosen[-1], len(chosen)) == (100, 199, 7)
    assert (np.diff(chosen) > 0).all()
    assert choose_evenly(np.arange(0), 7).tolist() == []
