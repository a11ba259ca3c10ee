"""Two streams become pairs: which, when, and what happens to the rest."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svc_ros.core.errors import ConfigError
from svc_ros.core.result import Reason
from svc_ros.pipeline.pairing import Matched, StampPairer, Unmatched

SKEW = 5
sorted_stamps = st.lists(st.integers(0, 60), max_size=12).map(sorted)


def feed(pairer, arrivals):
    """Add (side, stamp, item) in order; returns all events and the final flush."""
    events = []
    for side, stamp, item in arrivals:
        events += (pairer.add_source if side == "source" else pairer.add_target)(stamp, item)
    return events + pairer.flush()


def interleave(sources, targets, order):
    """Arrivals of both streams, each in its own order; `order` says whose turn it is."""
    queues = {
        "source": [("source", stamp, f"s{i}") for i, stamp in enumerate(sources)],
        "target": [("target", stamp, f"t{i}") for i, stamp in enumerate(targets)],
    }
    arrivals = []
    for turn in [*order, *["source", "target"] * (len(sources) + len(targets))]:
        if queues[turn]:
            arrivals.append(queues[turn].pop(0))
    return arrivals


def pairs_of(events):
    return sorted((e.source, e.target) for e in events if isinstance(e, Matched))


def greedy_pairs(sources, targets, skew):
    """The definition, slowly: all pairs within the skew, smallest difference first, ties to the earlier stamp."""
    candidates = sorted(
        (abs(s - t), s, i, t, j) for i, s in enumerate(sources) for j, t in enumerate(targets) if abs(s - t) <= skew
    )
    used, pairs = set(), []
    for _, _, i, _, j in candidates:
        if f"s{i}" not in used and f"t{j}" not in used:
            used |= {f"s{i}", f"t{j}"}
            pairs.append((f"s{i}", f"t{j}"))
    return sorted(pairs)


def test_equal_stamps_are_a_pair_at_once():
    pairer = StampPairer(SKEW)
    assert pairer.add_source(100, "s") == []
    assert pairer.add_target(100, "t") == [Matched(100, 100, "s", "t")]
    assert (pairer.num_matched, pairer.num_unmatched, pairer.num_waiting) == (1, 0, 0)


def test_pair_with_skew_waits_until_no_nearer_partner_can_come():
    pairer = StampPairer(SKEW)
    pairer.add_source(100, "s")
    assert pairer.add_target(103, "t") == []  # a source at 103 may still come
    assert pairer.add_source(120, "proof") == [Matched(100, 103, "s", "t")]


def test_pair_with_skew_is_not_made_while_a_nearer_partner_may_come():
    pairer = StampPairer(SKEW)
    pairer.add_source(100, "s")
    pairer.add_target(103, "t")
    assert pairer.add_source(104, "nearer") == []
    assert pairer.add_target(130, "proof")[0] == Matched(104, 103, "nearer", "t")


def test_nearest_partner_wins_over_the_first():
    pairer = StampPairer(SKEW)
    events = feed(pairer, [("source", 96, "far"), ("target", 100, "t"), ("source", 101, "near"), ("source", 120, "x")])
    assert Matched(101, 100, "near", "t") in events
    assert {e.item: e.reason for e in events if isinstance(e, Unmatched)} == {
        "far": Reason.TIME_SKEW, "x": Reason.TIME_SKEW,
    }  # fmt: skip


def test_item_without_partner_waits_until_the_other_stream_has_passed():
    pairer = StampPairer(SKEW)
    pairer.add_target(94, "before")
    (before,) = pairer.add_source(100, "alone")
    assert before.item == "before"
    assert pairer.add_target(95, "late, but within the skew") == []
    assert pairer.num_late == 0
    assert pairs_of(pairer.add_target(106, "after")) == [("alone", "late, but within the skew")]
    pairer.add_source(120, "lonely")
    (*_, lonely) = pairer.add_target(126, "after")
    assert (lonely.item, lonely.reason) == ("lonely", Reason.TIME_SKEW)


def test_time_skew_names_the_missing_side():
    pairer = StampPairer(50_000_000)
    pairer.add_target(0, "t")
    (event,) = pairer.add_source(60_000_000, "s")
    assert event == Unmatched("target", 0, "t", Reason.TIME_SKEW, "no source within 0.05 s of this target")


def test_silent_stream_supersedes_the_oldest():
    pairer = StampPairer(SKEW, capacity=2)
    events = [event for stamp in (0, 10, 20, 30) for event in pairer.add_source(stamp, stamp)]
    assert [(e.item, e.reason) for e in events] == [(0, Reason.SUPERSEDED), (10, Reason.SUPERSEDED)]


def test_jump_back_drops_what_waited_and_starts_again():
    pairer = StampPairer(SKEW)
    pairer.add_source(1000, "old")
    assert [(e.item, e.reason) for e in pairer.add_source(0, "new")] == [("old", Reason.STALE)]
    assert pairer.add_target(0, "t") == [Matched(0, 0, "new", "t")]


def test_jump_back_of_both_streams_keeps_the_item_that_jumped_first():
    pairer = StampPairer(SKEW)
    feed_stamps = [("source", 1000, "s9"), ("target", 1000, "t9"), ("target", 0, "t0"), ("source", 0, "s0")]
    events = []
    for side, stamp, item in feed_stamps:
        events += (pairer.add_source if side == "source" else pairer.add_target)(stamp, item)
    assert pairs_of(events) == [("s0", "t0"), ("s9", "t9")]


def test_small_step_back_is_late_and_still_paired():
    pairer = StampPairer(SKEW)
    pairer.add_source(100, "a")
    pairer.add_source(98, "b")
    assert pairer.num_late == 1
    assert pairer.add_target(98, "t") == [Matched(98, 98, "b", "t")]


def test_clear_reports_everything_that_waited():
    pairer = StampPairer(SKEW)
    pairer.add_source(100, "s")
    pairer.add_target(103, "t")
    assert {(e.item, e.reason) for e in pairer.clear()} == {("s", Reason.STALE), ("t", Reason.STALE)}
    assert pairer.num_waiting == 0


def test_items_need_not_be_comparable():
    pairer = StampPairer(0)
    pairer.add_source(0, object())
    pairer.add_source(0, object())
    assert len(pairer.add_target(0, object())) == 1


@pytest.mark.parametrize(("skew", "capacity"), [(-1, 5), (5, 0)])
def test_impossible_bounds_are_refused(skew, capacity):
    with pytest.raises(ConfigError, match="pairing"):
        StampPairer(skew, capacity)


@given(sorted_stamps, sorted_stamps, st.lists(st.sampled_from(["source", "target"]), max_size=24), st.integers(0, 12))
@settings(max_examples=300, deadline=None)
def test_pairs_equal_the_definition_for_every_interleaving(sources, targets, order, skew):
    pairer = StampPairer(skew, capacity=100)
    events = feed(pairer, interleave(sources, targets, order))
    assert pairs_of(events) == greedy_pairs(sources, targets, skew)


@given(
    st.lists(st.tuples(st.sampled_from(["source", "target"]), st.integers(0, 200)), max_size=40),
    st.integers(0, 30),
    st.integers(1, 5),
)
@settings(max_examples=300, deadline=None)
def test_every_item_ends_in_exactly_one_event(steps, skew, capacity):
    pairer = StampPairer(skew, capacity)
    arrivals = [(side, stamp, number) for number, (side, stamp) in enumerate(steps)]
    events = feed(pairer, arrivals)
    seen = []
    for event in events:
        if isinstance(event, Matched):
            assert abs(event.source_stamp_ns - event.target_stamp_ns) <= skew
            seen += [event.source, event.target]
        else:
            seen.append(event.item)
    assert sorted(seen) == list(range(len(steps)))
    assert pairer.num_received == 2 * pairer.num_matched + pairer.num_unmatched == len(steps)
    assert pairer.num_waiting == 0
