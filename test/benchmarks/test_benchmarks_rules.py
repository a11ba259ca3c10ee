"""The rules that benchmarks/decision.py compares, the sensors it leaves out, and whether probabilities come true."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from decision_rows import evidence, row, toy_rows

from svc_ros.core.config import preset
from svc_ros.io.datasets import read_dataset

pytestmark = pytest.mark.usefixtures("scripts")
ONE, SAME = "os1_64_seosan", "os1_64_yard"  # two sets of one sensor
CONFIG = preset("lidar_outdoor")
CONFIGS = dict.fromkeys(("a", "b", ONE, SAME), CONFIG)
GOOD, BAD = evidence(0.004, 0.25), evidence(0.4, 0.25)
MOVED = {"moved": (0.0, 50.0)}


def answer(variant: str, seen, slips=(), turns=(), **changes) -> bool:
    """Whether a variant accepts the pose, whose probability tells the same."""
    from lib.rules import VARIANTS, answer_variant

    accepted, probability = answer_variant(row("a", True, seen, slips, turns, **changes), CONFIG, VARIANTS[variant])
    assert accepted == (probability >= 0.5)
    return accepted


# --- rules ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("variant", "seen"),
    [
        ("svc, nothing denied", BAD),
        ("svc, nothing denied", evidence(0.004, 0.25, source_in_target=dataclasses.replace(
            GOOD.source_in_target, num_free_blocked=300))),
        ("svc, plain overlap", dataclasses.replace(GOOD, oriented_overlap_ratio=0.05)),
        ("svc, opposed surfaces allowed", dataclasses.replace(GOOD, opposed_ratio=0.9)),
        ("svc, one plane is enough", dataclasses.replace(GOOD, constraint_ratio=0.002)),
    ],
)  # fmt: skip
def test_what_is_taken_away_is_what_refused_the_pose(variant, seen):
    from lib.rules import VARIANTS

    accepting = {name for name in VARIANTS if answer(name, seen)}
    assert accepting == {variant}
    assert {name for name in VARIANTS if answer(name, GOOD)} == set(VARIANTS)


def test_a_pose_that_moves_away_is_refused_unless_it_is_not_refined():
    from lib.rules import MOVED_AWAY, VARIANTS, answer_denied_share, answer_variant

    accepting = {name for name in VARIANTS if answer(name, GOOD, **MOVED)}
    assert accepting == {"svc, not refined"}
    moved = row("a", True, GOOD, **MOVED)
    assert answer_variant(moved, CONFIG, VARIANTS["svc"]) == (False, MOVED_AWAY)
    assert answer_denied_share(moved, CONFIG) == (False, 0.0)
    limit = CONFIG.shortlist.max_moved_translation_m
    assert answer("svc", GOOD, moved=(0.0, limit))
    assert not answer("svc", GOOD, moved=(CONFIG.shortlist.max_moved_rotation_deg + 0.1, 0.0))


def test_the_view_is_that_of_the_variant():
    from lib.rules import VARIANTS, answer_variant

    apart = row("a", True, GOOD, seen={"refined": BAD.numbers(), "given": GOOD.numbers()})
    answers = {name: answer_variant(apart, CONFIG, variant)[0] for name, variant in VARIANTS.items()}
    assert {name for name, accepted in answers.items() if accepted} == {"svc, not refined", "svc, nothing denied"}


def test_slips_raise_doubts_by_their_place():
    """Far back, back, ahead, far ahead; a near one is a rival only where it looks better than the pose itself."""
    better = dataclasses.replace(GOOD, oriented_overlap_ratio=0.65, overlap_ratio=0.65)
    assert answer("svc", GOOD, [BAD] * 4)
    assert answer("svc", GOOD, [BAD, GOOD, GOOD, BAD])
    for slips in ([GOOD, BAD, BAD, BAD], [BAD, BAD, BAD, GOOD], [BAD] * 4 + [BAD, BAD, BAD, GOOD],
                  [BAD, better, BAD, BAD], [BAD, BAD, better, BAD]):  # fmt: skip
        assert not answer("svc", GOOD, slips)
        assert answer("svc, no doubt by slips", GOOD, slips)


def test_half_turns_raise_doubts_where_they_are_about_as_likely():
    worse = evidence(0.07, 0.25)  # still likelier right than wrong
    for turn, doubted in ((GOOD, True), (evidence(0.006, 0.25), True), (worse, False), (BAD, False)):
        for turns in ([turn], [BAD, BAD, turn]):
            assert answer("svc", GOOD, turns=turns) == (not doubted)
            assert answer("svc, no doubt by slips", GOOD, turns=turns) == (not doubted)
            assert answer("svc, no doubt by half turns", GOOD, turns=turns)
    assert not answer("svc, no doubt by half turns", GOOD, [GOOD] * 4)  # slips still do


def test_the_denied_share_alone():
    from lib.rules import answer_denied_share

    def judge(seen) -> tuple[bool, float]:
        return answer_denied_share(row("a", True, seen), CONFIG)

    assert judge(evidence(0.075)) == (True, pytest.approx(0.925))
    assert judge(evidence(0.085)) == (False, pytest.approx(0.915))  # told like any other: the score ranks it
    assert judge(evidence(0.075, structure=0.0, wide=0.9)) == (True, pytest.approx(0.925))  # of nothing else
    assert judge(evidence(0.01, overlap=0.079)) == (False, 0.0)
    assert judge(evidence(0.01, constraint_ratio=0.009)) == (False, 0.0)
    other_view = row("a", True, evidence(0.01))
    other_view = dataclasses.replace(other_view, seen={**other_view.seen, "given": BAD.numbers()})
    assert answer_denied_share(other_view, CONFIG)[0]


def test_paper_and_overlap_look_at_the_pose_as_given():
    from lib.rules import answer_overlap, answer_paper

    r = row("a", True, evidence(0.01, overlap=0.29), paper_blocked=0.3, paper_passed=True)
    r = dataclasses.replace(r, seen={**r.seen, "refined": evidence(0.01, overlap=0.9).numbers()})
    assert answer_paper(r) == (True, pytest.approx(0.7))
    assert answer_overlap(r) == (False, 0.29)
    assert answer_overlap(row("a", True, evidence(0.4, overlap=0.3))) == (True, 0.3)


# --- logistic regression ----------------------------------------------------------------------------------------------


def test_a_logistic_fit_finds_planted_weights():
    from lib.rules import fit_logistic

    rng = np.random.default_rng(0)
    features = rng.normal(size=(8000, 3)) * (1.0, 10.0, 0.1)
    odds = features @ (2.0, 0.0, -15.0)
    correct = rng.random(8000) < 1.0 / (1.0 + np.exp(-odds))
    model = fit_logistic(features, correct)
    assert model.weights == pytest.approx([2.0, 0.0, -15.0], rel=0.1, abs=0.02)
    assert model.offset == pytest.approx(0.0, abs=0.1)
    assert model(features[:5]) == pytest.approx(1.0 / (1.0 + np.exp(-odds[:5])), abs=0.1)
    bounded = fit_logistic(features, correct, never_negative=True)
    assert bounded.weights.min() == bounded.weights[2] == 0.0
    assert bounded.weights[0] > 1.0


def test_both_classes_weigh_the_same_and_counts_are_as_copies():
    from lib.rules import fit_logistic

    rng = np.random.default_rng(1)
    features = np.concatenate((rng.normal(1.0, 1.0, (50, 1)), rng.normal(-1.0, 1.0, (500, 1))))
    correct = np.arange(550) < 50
    assert fit_logistic(features, correct).offset == pytest.approx(0.0, abs=0.4)  # -2.3 by the numbers of poses
    counted = np.where(np.arange(550) % 2, 1.0, 3.0)
    copied = np.repeat(np.arange(550), counted.astype(int))
    one, other = fit_logistic(features, correct, counted), fit_logistic(features[copied], correct[copied])
    assert (one.offset, *one.weights) == pytest.approx((other.offset, *other.weights), rel=1e-3)


def test_logistic_answers_never_saw_the_sensor():
    from lib.rules import MOVED_AWAY, answer_logistic, features_with_sight_lines, features_without_sight_lines

    def numbers(r):
        return [np.log(r.seen["refined"]["denied_ratio"] + 1e-3)]

    rows = [*toy_rows(CONFIGS), row("a", True, GOOD, **MOVED)]
    spoilt = [dataclasses.replace(r, correct=not r.correct) if r.dataset in (ONE, SAME) else r for r in rows]
    honest, other = (answer_logistic(given, CONFIGS, numbers) for given in (rows, spoilt))
    of_sensor = [k for k, r in enumerate(rows) if r.dataset in (ONE, SAME)]
    assert [honest[k] for k in of_sensor] == [other[k] for k in of_sensor]
    right = [accepted == r.correct for (accepted, _), r in zip(honest, rows, strict=True)]
    assert np.mean(right) > 0.85
    assert honest[0] != other[0]
    assert honest[-1] == (False, MOVED_AWAY)
    r = row("a", True, dataclasses.replace(GOOD, overlap_ratio=0.7))
    assert features_without_sight_lines(r) == [0.7, 0.6, 0.01]
    assert features_with_sight_lines(r) == pytest.approx([0.7, 0.6, 0.01, np.log((0.01 + 1e-3) / 0.6)])


# --- sensors ----------------------------------------------------------------------------------------------------------


def test_sets_of_one_sensor_are_left_out_together():
    from lib.sensors import sensor_of, sensors_of, weigh_groups

    assert sensor_of(ONE) == sensor_of(SAME) == "OS1-64"
    assert sensor_of("simulated smear") == "simulated smear"
    labels = ((ONE, True), ("a", True), (SAME, True), (SAME, False), ("a", True), ("a", True), ("a", False))
    rows = [row(name, correct, GOOD) for name, correct in labels]
    assert sensors_of(rows) == ["OS1-64", "a"]
    assert weigh_groups(rows).tolist() == pytest.approx([1 / 2, 1 / 3, 1 / 2, 1.0, 1 / 3, 1 / 3, 1.0])


def test_the_sensor_of_every_recorded_set_is_known(shared_data):
    """One that is not named would be left out alone, and the fit tested on a sensor that it has seen."""
    from lib.sensors import SENSORS

    sets = [read_dataset(path.parent) for path in sorted((shared_data / "pairs").glob("*/dataset.json"))]
    assert {dataset.name for dataset in sets if dataset.candidates} == set(SENSORS)


# --- calibration ------------------------------------------------------------------------------------------------------


def calibrated(names, num: int = 4000, power: float = 1.0) -> tuple[list, list]:
    """Rows and answers; a pose is right as often as its probability to that power says."""
    rng = np.random.default_rng(2)
    rows, answers, seen = [], [], row("a", True, GOOD)
    for name in names:
        for p in rng.uniform(0.0, 1.0, num):
            rows.append(dataclasses.replace(seen, dataset=name, correct=bool(rng.random() < p**power)))
            answers.append((p >= 0.5, float(p)))
    return rows, answers


def test_the_bins_add_up_by_group():
    from lib.calibration import ALL, RECORDED, measure

    names = (ONE, SAME, "simulated smear")
    rows, answers = calibrated(names, 300)
    found = measure(rows, answers)
    assert list(found["expected_calibration_error"]) == ["OS1-64", "simulated smear", RECORDED, ALL]
    sums = {name: sum(b["num"] for b in bins) for name, bins in found["reliability"].items()}
    assert sums == {RECORDED: 600, ALL: 900}
    bins = found["reliability"][ALL]
    assert sum(b["num"] * b["right_share"] for b in bins) == pytest.approx(sum(r.correct for r in rows))
    assert sum(b["num"] * b["mean_probability"] for b in bins) == pytest.approx(sum(p for _, p in answers))
    assert [b["low"] for b in bins] == pytest.approx(np.arange(10) / 10)


def test_true_probabilities_have_no_calibration_error_and_others_do():
    from lib.calibration import ALL, measure

    def error(rows, answers, name=ALL) -> float:
        return measure(rows, answers)["expected_calibration_error"][name]

    assert error(*calibrated(["a"])) < 0.03
    assert error(*calibrated(["a"], power=3.0)) == pytest.approx(0.25, abs=0.03)  # of x - x^3, uniform: 1/2 - 1/4
    rows, answers = calibrated(["a", "simulated smear"])
    wrong = [dataclasses.replace(r, correct=False) if r.dataset != "a" else r for r in rows]
    assert error(wrong, answers, "a") == error(rows, answers, "a") == error(wrong, answers, "recorded sets")
    assert error(wrong, answers, "simulated smear") == pytest.approx(0.5, abs=0.03)


def test_calibration_is_shown_and_drawn(capsys, tmp_path):
    from lib import calibration as _calibration

    found = _calibration.measure(*calibrated(["a"], 50))
    _calibration.show(found)
    told = capsys.readouterr().out
    assert f"{found['expected_calibration_error']['a']:.3f}" in told
    assert "0.9 to 1.0" in told
    _calibration.draw(found, tmp_path / "reliability.png")
    assert (tmp_path / "reliability.png").read_bytes().startswith(b"\x89PNG")
