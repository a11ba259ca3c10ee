"""Losses as a share: gaps in the messages' numbers, and what the middleware reports."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from svc_ros.ros.topics.loss import LossMonitor


def played(numbers: list[int | None], period_s: float = 0.1) -> LossMonitor:
    loss = LossMonitor()
    for k, number in enumerate(numbers):
        loss.take(number, k * period_s)
    return loss


def test_what_comes_without_a_gap_is_no_loss():
    loss = played([*range(7, 37)])
    assert loss.num_lost == 0
    assert loss.share(2.9) == (0, 30)
    assert loss.warning(2.9) == ""


def test_a_gap_counts_what_is_missing():
    loss = played([1, 2, 5, 6])
    assert loss.num_lost == 2
    assert loss.share(0.4) == (2, 6)
    assert loss.warning(0.4) == "2 of 6 lost in 3 s (33 %)"


def test_a_gap_that_the_middleware_reports_too_counts_once():
    loss = played([1, 2])
    loss.report(3, 0.2)
    assert loss.num_lost == 3
    loss.take(6, 0.3)
    assert loss.num_lost == 3
    loss.take(8, 0.4)
    loss.report(1, 0.5)
    assert loss.num_lost == 4


def test_where_nothing_comes_at_all_reports_count():
    loss = LossMonitor()
    loss.report(5, 1.0)
    assert loss.warning(1.5) == "5 of 5 lost in 3 s (100 %)"


def test_five_percent_is_no_warning_and_more_is():
    exactly = played([*range(1, 11), *range(12, 21)])  # 1 of 20
    assert exactly.warning(1.9) == ""
    assert played([*range(1, 11), *range(12, 20)]).warning(1.8) == "1 of 19 lost in 3 s (5 %)"


def test_a_publisher_that_begins_anew_loses_nothing():
    assert played([98, 99, 1, 2]).num_lost == 0


def test_numbers_of_several_publishers_say_nothing():
    loss = played([10, None, 500, 501])
    assert loss.num_lost == 0


def test_reports_count_after_gaps_that_the_middleware_did_not_report():
    loss = played([1, 13])
    assert loss.num_lost == 11
    loss.take(None, 0.2)  # a second publisher: numbers say nothing any more
    loss.report(9, 0.3)
    assert loss.num_lost == 20


def test_a_warning_stays_for_ten_seconds_after_the_last_loss_and_then_goes():
    loss = played([1, 3])
    assert loss.warning(0.2)
    loss.take(4, 6.0)
    assert loss.warning(6.0) == "1 of 3 lost in 3 s (33 %)"
    loss.take(5, 10.3)
    assert loss.warning(10.3) == ""
    assert loss.num_lost == 1
