"""benchmarks/registration.py: which pairs, what counts as right and accepted, and that every package really runs."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from mini_data import write_dataset

from svc_ros.core.se3 import pose_error
from svc_ros.io.datasets import read_dataset

pytestmark = pytest.mark.usefixtures("scripts")


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """A folder of data sets with one room in it."""
    folder = tmp_path_factory.mktemp("pairs")
    write_dataset(folder / "room")
    return folder


def answer(overlap: float | None, accepted: bool, correct: bool, score: float | None = None, **more) -> dict:
    row = {"dataset": "a", "sensor": "VLP-16", "overlap": overlap, "negative": overlap is None, "method": "svc"}
    return {**row, "accepted": accepted, "correct": correct, "score": score, "total_ms": 10.0, **more}


# --- counting ---------------------------------------------------------------------------------------------------------


def test_every_pair_is_in_one_bin_and_negatives_in_their_own():
    from lib.tally import BINS, NEGATIVES, by_overlap

    rows = [answer(overlap, True, True) for overlap in (0.0, 0.1, 0.29, 0.3, 0.5, 0.7, 1.0)]
    bins = by_overlap([*rows, answer(None, True, False)])
    assert [bins[name]["num_pairs"] for name, _, _ in BINS] == [1, 1, 1, 1, 1, 2]
    assert bins[NEGATIVES] == {"num_pairs": 1, "num_right": 0, "num_accepted_right": 0, "num_false_accepted": 1}


def test_negatives_count_as_false_accepts_and_not_as_pairs():
    from lib.tally import summarise

    rows = [answer(0.5, True, True), answer(0.5, False, True), answer(0.2, True, False), answer(None, True, False)]
    found = summarise([*rows, answer(None, False, False, total_ms=1000.0)])
    assert (found["num_pairs"], found["num_right"], found["num_accepted_right"]) == (3, 2, 1)
    assert (found["num_false_accepted"], found["num_negatives"], found["num_negatives_accepted"]) == (1, 2, 1)
    assert found["time_ms_p50"] == 10.0 < found["time_ms_p95"]


def test_what_the_best_threshold_would_keep():
    from lib.tally import right_above_wrong

    rows = [answer(0.5, True, True, 9), answer(0.5, False, True, 4), answer(0.5, True, True, 3)]
    assert right_above_wrong(rows) == 3
    assert right_above_wrong([*rows, answer(None, False, False, 3)]) == 2  # one as high as a wrong one is not kept
    assert right_above_wrong([*rows, answer(0.1, True, False, 99)]) == 0
    assert right_above_wrong([answer(0.5, True, True)]) is None


def test_files_of_an_earlier_version_can_be_read():
    from lib.tally import read_rows, summarise

    old = {"dataset": "a", "overlap": None, "method": "svc", "accepted": True, "correct": False, "time_ms": 3.0}
    (row,) = read_rows({"pairs": [old]})
    assert (row["negative"], row["sensor"], row["score"]) == (True, "a", None)
    assert summarise([row])["time_ms_p50"] is None  # that time was without descriptors


def test_kinds_of_sensors_are_told_from_what_a_set_says():
    from lib.sensors import kind_of

    assert kind_of("Velodyne HDL-64E, city drive", "x") == "HDL-64E"
    assert kind_of("64-beam Ouster type, car", "x") == "OS1-64"
    assert kind_of("solid-state LiDAR on a tripod or cart", "x") == "solid state"
    assert kind_of("something new", "x") == "x"


def test_every_recorded_set_is_of_the_kind_that_it_is_left_out_with(shared_data):
    from lib.sensors import SENSORS, kind_of

    sets = [read_dataset(path.parent) for path in sorted((shared_data / "pairs").glob("*/dataset.json"))]
    assert {s.name: kind_of(s.sensor, "unknown") for s in sets if s.name in SENSORS} == SENSORS
    assert "unknown" not in {kind_of(s.sensor, "unknown") for s in sets}


# --- running ----------------------------------------------------------------------------------------------------------


def test_all_pairs_and_negatives_are_chosen_without_a_limit(data):
    from lib.pairs import choose

    dataset = read_dataset(data / "room")
    everything = choose(dataset, None)
    assert len(everything) == len(dataset.pairs) + len(dataset.negatives) > 1
    assert len(choose(dataset, 1)) == min(1, len(dataset.pairs)) + min(1, len(dataset.negatives))


@pytest.mark.parametrize("method", ["svc", "KISS-Matcher", "Open3D RANSAC", "Open3D FGR"])
def test_every_package_answers_and_says_by_what(data, method):
    from lib.attempts import ACCEPTS, PREPARED, method_of, why_not
    from lib.common import config_of

    if (reason := why_not(method)) is not None:
        pytest.skip(reason)
    dataset = read_dataset(data / "room")
    pair = dataset.pairs[0]
    run, config = method_of(method, config_of(dataset))
    scans = [dataset.read_scan(path) for path in (pair.source, pair.target)]
    first, again = run(*scans, config), run(*scans, config)
    assert first.accepted == again.accepted
    assert first.score > 0
    if method != "KISS-Matcher":  # its threads decide the order of its sums
        assert first.score == again.score
        np.testing.assert_array_equal(first.T_target_source, again.T_target_source)
    rotation_deg, translation_m = pose_error(first.T_target_source, pair.T_target_source)
    if method != "Open3D FGR":
        assert first.accepted
        assert rotation_deg < 5.0
        assert translation_m < 0.6
    assert first.time_ms > 0
    assert ACCEPTS[method]
    assert PREPARED[method]


def test_open3d_describes_a_pair_once_for_both_methods(data):
    pytest.importorskip("open3d")
    from lib.common import config_of
    from lib.peers import describe_by_open3d, run_open3d_fgr

    dataset = read_dataset(data / "room")
    scans = [dataset.read_scan(path) for path in (dataset.pairs[0].source, dataset.pairs[0].target)]
    shared = describe_by_open3d(*scans, config_of(dataset))
    assert describe_by_open3d(*scans, config_of(dataset)) is shared
    assert run_open3d_fgr(*scans, config_of(dataset)).time_ms > shared.time_ms  # the whole time counts


def test_the_report_has_what_the_pages_need(monkeypatch, data, tmp_path):
    import registration
    from lib import attempts, registration_pages
    from lib.peers import Attempt

    asked = []

    def careless(source, target, config):
        asked.append(source)
        return Attempt(True, np.eye(4), 5.0, 0.1)

    monkeypatch.setitem(attempts.PEERS, "KISS-Matcher", careless)
    monkeypatch.setattr(registration, "why_not", lambda name: None)
    monkeypatch.setattr(registration, "_asked", set())
    options = ["--data", str(data), "--out", str(tmp_path), "--workers", "1", "--methods", "svc", "KISS-Matcher"]
    monkeypatch.setattr(sys, "argv", ["registration", *options])
    registration.main()
    found = json.loads((tmp_path / "registration.json").read_text())
    dataset = read_dataset(data / "room")
    num = len(dataset.pairs) + len(dataset.negatives)
    assert found["limit"] is None
    assert len(found["pairs"]) == 2 * num == 2 * (len(asked) - 1)  # the first call is repeated: it is no time of a pair
    wrong = found["registration"]["all sets"]["KISS-Matcher"]
    assert wrong["num_accepted_right"] == 0
    assert wrong["num_false_accepted"] + wrong["num_negatives_accepted"] == num
    assert found["by_sensor"].keys() == {found["pairs"][0]["sensor"], "all sets"}
    assert found["methods"]["svc"]["accepts"]
    assert (tmp_path / "registration.png").stat().st_size > 0
    for section in registration_pages.SECTIONS.values():
        assert section({"registration": found})
    assert registration_pages.overlap_table({"registration": found}).count(" wrong**") >= 1
