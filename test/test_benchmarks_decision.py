"""The script that the decision's weights come from: what it fits, what it leaves out, what it measures."""

from __future__ import annotations

import dataclasses
import json
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from mini_data import write_dataset

from svc_ros.core import decision
from svc_ros.core.config import preset
from svc_ros.core.evidence import SightLines, SightViewEvidence
from svc_ros.core.result import Verdict

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"
CONFIGS = {name: preset("lidar_outdoor") for name in "abc"}
NUM_LINES = 5000


@pytest.fixture(autouse=True)
def scripts(monkeypatch):
    """The scripts import each other from their own folder."""
    monkeypatch.syspath_prepend(str(FOLDER))


def evidence(blocked: float, tight: float, observed: float = 0.3, overlap: float = 0.6) -> SightViewEvidence:
    """Evidence with these shares, half of what is blocked being scattered."""
    num = round(blocked * NUM_LINES)
    lines = SightLines(NUM_LINES, round(observed * NUM_LINES), np.zeros(num), np.zeros(num), num // 2, True, 700, 7)
    return SightViewEvidence(lines, lines, overlap, overlap, 0.01, 0.2, 0.2, tight)


def row(dataset: str, correct: bool, seen: SightViewEvidence, **changes):
    """A row whose views all show the same, without slips."""
    from _evidence import VIEWS, Row

    views = dict.fromkeys(VIEWS, seen.numbers())
    slips = dict.fromkeys(VIEWS, ())
    made = Row(dataset, "pair", "toy", correct, (0.0, 0.0), views, slips, 0.5, not correct)
    return dataclasses.replace(made, **changes)


def toy_rows(names=tuple(CONFIGS), num: int = 30, seed: int = 0) -> list:
    """Sets in which right poses are blocked little and tight, wrong ones blocked much and loose, with an overlap."""
    rng, rows = np.random.default_rng(seed), []
    for name in names:
        for correct in (True, False):
            for _ in range(num):
                blocked = np.exp(rng.normal(-5.0 if correct else -3.5, 0.5))
                tight = 1.0 / (1.0 + np.exp(-rng.normal(2.0 if correct else 1.0, 0.5)))
                rows.append(row(name, correct, evidence(blocked, tight)))
    return rows


def test_fitted_weights_tell_separable_poses_apart():
    from _weights import compare_weights

    found = compare_weights(toy_rows(), CONFIGS)
    assert set(found["leave_one_set_out"]) == set(CONFIGS)
    for tested in found["leave_one_set_out"].values():
        assert tested["margin_auc"] > 0.95
        assert tested["weights"]["tight_weight"] > 0.0
        assert tested["weights"]["blocked_weight"] + tested["weights"]["scattered_weight"] > 0.0
    assert found["num_right_and_wrong"] == {name: [30, 30] for name in CONFIGS}


def test_the_offset_is_that_of_even_odds():
    from _weights import FIELDS, fit_weights

    rows = [row("a", correct, evidence(blocked, 0.8)) for correct, blocked in ((True, 0.005), (False, 0.05))]
    fitted = fit_weights(rows, CONFIGS)
    config = dataclasses.replace(CONFIGS["a"].decision, **{name: fitted[name] for name in FIELDS})
    right, wrong = (
        np.array(decision.describe_contradiction(evidence(blocked, 0.8))) @ (
            -config.blocked_weight, -config.scattered_weight, -config.contradicted_weight, config.tight_weight
        ) + config.free_offset
        for blocked in (0.005, 0.05)
    )  # fmt: skip
    assert right > 0 > wrong
    assert (right + wrong) / 2 == pytest.approx(0.0, abs=0.12)  # rounding of offset and weights


def test_a_left_out_set_is_not_used():
    from _weights import fit_without_each

    rows = toy_rows()
    spoilt = [dataclasses.replace(r, correct=not r.correct) if r.dataset == "b" else r for r in rows]
    honest, other = fit_without_each(rows, CONFIGS), fit_without_each(spoilt, CONFIGS)
    assert honest["b"] == other["b"]
    assert honest["a"] != other["a"]
    assert honest["c"] != other["c"]


def test_left_out_poses_are_answered_by_the_weights_of_the_others():
    from _rules import Variant, answer_variant
    from _weights import answer_left_out, fit_without_each

    rows = toy_rows()
    fitted = fit_without_each(rows, CONFIGS, "tight_weight")
    assert all(weights["tight_weight"] == 0.0 for weights in fitted.values())
    answers = answer_left_out(rows, CONFIGS, "tight_weight")
    for r, answer in zip(rows, answers, strict=True):
        assert answer == answer_variant(r, CONFIGS["a"], Variant(borders=fitted[r.dataset]))


def test_sets_and_labels_weigh_the_same_however_many_poses_they_have():
    from _weights import fit_weights

    rows = toy_rows()
    many = rows + [r for r in rows if r.dataset == "a" and r.correct] * 4
    assert fit_weights(many, CONFIGS) == fit_weights(rows, CONFIGS)


def test_poses_out_of_contact_or_moved_away_do_not_count():
    from _weights import fit_weights

    rows = toy_rows()
    misleading = [
        row("a", True, evidence(0.2, 0.3, overlap=0.05)),
        row("a", True, dataclasses.replace(evidence(0.2, 0.3), constraint_ratio=0.001)),
        row("a", True, evidence(0.2, 0.3), moved=(0.0, 50.0)),
    ]
    assert fit_weights(rows + misleading, CONFIGS) == fit_weights(rows, CONFIGS)
    assert fit_weights([*rows, row("a", True, evidence(0.2, 0.3))], CONFIGS) != fit_weights(rows, CONFIGS)


def test_nothing_is_fitted_to_one_label():
    from _weights import fit_weights

    with pytest.raises(ValueError, match="3 right of 3"):
        fit_weights([row("a", True, evidence(0.01, 0.8))] * 3, CONFIGS)


def test_a_number_that_misleads_gets_no_weight_rather_than_a_negative_one():
    from _weights import fit_weights

    rows = [row("a", correct, evidence(blocked, tight)) for correct, blocked, tight in
            ((True, 0.005, 0.6), (False, 0.05, 0.9), (True, 0.006, 0.65), (False, 0.04, 0.85))]  # fmt: skip
    fitted = fit_weights(rows, CONFIGS)
    assert fitted["tight_weight"] == 0.0
    assert min(fitted[name] for name in fitted if name != "free_offset") >= 0.0


def test_kept_numbers_make_the_same_evidence_again():
    from _evidence import evidence_of

    numbers = evidence(0.02, 0.8).numbers()
    assert evidence_of(numbers).numbers() == pytest.approx(numbers)
    assert evidence_of(numbers).source_in_target.num_free == 700


def test_slips_are_measured_wherever_a_variant_may_accept():
    from _evidence import _may_be_accepted, evidence_of
    from _rules import VARIANTS

    rng, config, accepted = np.random.default_rng(3), CONFIGS["a"].decision, dict.fromkeys(VARIANTS, 0)
    for _ in range(400):
        seen = evidence(*rng.uniform((0.0, 0.3, 0.0), (0.3, 1.0, 0.5)))
        overlap, oriented, opposed, constraint = rng.uniform(0.0, (1.0, 0.8, 1.0, 0.2))
        seen = dataclasses.replace(
            seen, overlap_ratio=overlap, oriented_overlap_ratio=oriented, opposed_ratio=opposed,
            constraint_ratio=constraint, weakest_constraint=rng.uniform(0.0, 0.3),
        )  # fmt: skip
        for name, variant in VARIANTS.items():
            judged = evidence_of(seen.numbers())
            if variant.plain_overlap:
                judged = dataclasses.replace(judged, oriented_overlap_ratio=overlap)
            decided = decision.decide(judged, dataclasses.replace(config, **variant.borders))
            if decided.verdict is Verdict.ACCEPTED:
                accepted[name] += 1
                assert _may_be_accepted(seen, config), name
    assert accepted["svc, no sight lines"] > 2 * accepted["svc"] > 0


def test_traffic_is_labelled_with_the_true_pose():
    import _simulated

    rows = _simulated.gather_simulated((_simulated.Place(_simulated.TRAFFIC, "VLP-16", 1), 1))
    assert [r.correct for r in rows] == [True] * 3
    for r in rows:
        assert r.dataset == _simulated.TRAFFIC
        assert r.moved[1] < 0.1  # refinement stays at the truth
        assert np.abs(r.contact.error[:3]).max() < 0.1
        assert r.seen["refined"]["oriented_overlap_ratio"] > 0.3
    assert sum(r.seen["refined"]["num_blocked_source_in_target"] for r in rows) > 0  # something did change


def test_half_of_the_parked_cars_are_gone():
    import _simulated

    from svc_ros.simulation import build_scene
    from svc_ros.simulation.world import SceneConfig

    scene = build_scene("street", np.random.default_rng(2), SceneConfig(moving_share=0.0))
    cars = scene.kinds().count("car")
    left = [thing.mesh_at(60.0) is not None for thing in _simulated.without_cars(scene, 2).objects]
    assert len(left) - sum(left) == round(0.5 * cars) > 0
    assert all(thing.mesh_at(0.0) is not None for thing in _simulated.without_cars(scene, 2).objects)


def test_rooms_are_wrong_poses_that_registration_found(monkeypatch):
    import _simulated

    monkeypatch.setattr(_simulated, "_BOTH_SIDES", ((5, 6),))
    rows = _simulated.gather_simulated((_simulated.Place(_simulated.ROOMS, "VLP-16", 26), 0))
    (only,) = rows
    assert (only.correct, only.contact, only.origin, only.dataset) == (False, None, "register", _simulated.ROOMS)
    assert only.seen["refined"]["oriented_overlap_ratio"] > 0.2  # they do look alike
    assert only.verified is not None


def test_the_script_compares_fits_and_writes(monkeypatch, tmp_path):
    import _simulated
    import decision as script

    (tmp_path / "pairs").mkdir()
    write_dataset(tmp_path / "pairs" / "room")
    rows = toy_rows(("room", _simulated.TRAFFIC, _simulated.ROOMS))
    kept = tmp_path / "rows.pkl"
    kept.write_bytes(pickle.dumps((rows, {"commit": "abc"})))
    options = ["--data", str(tmp_path / "pairs"), "--out", str(tmp_path), "--rows", str(kept)]
    monkeypatch.setattr(sys, "argv", ["decision.py", *options])
    script.main()
    found = json.loads((tmp_path / "decision.json").read_text())
    assert found["run"] == {"commit": "abc"}
    assert set(found["num_poses"]) == {"room", _simulated.TRAFFIC, _simulated.ROOMS}
    assert set(found["weights"]["leave_one_set_out"]) == set(found["num_poses"])
    assert found["decision"]["all sets"][script.OTHERS]["roc_auc"] > 0.95
    assert (tmp_path / "risk-coverage.png").stat().st_size > 0
