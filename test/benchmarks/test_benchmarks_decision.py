"""The script that the decision's weights come from: what it fits, what it leaves out, what it measures."""

from __future__ import annotations

import argparse
import dataclasses
import json
import pickle
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from decision_rows import evidence, planted_rows, row, surface, toy_rows
from mini_data import write_dataset
from pages import module_from
from places import BENCHMARKS

from svc_ros.core import decision, se3
from svc_ros.core.config import preset
from svc_ros.core.result import Verdict
from svc_ros.core.sight.evidence import SightLines, SightViewEvidence
from svc_ros.io.datasets import read_dataset

pytestmark = pytest.mark.usefixtures("scripts")
ONE, SAME = "os1_64_seosan", "os1_64_yard"  # two sets of one sensor
CONFIGS = {name: preset("lidar_outdoor") for name in ("a", "b", ONE, SAME)}
SENSOR_NAMES = ["a", "b", "OS1-64"]
OTHER_SENSORS = {"denied_weight": 1.0, "wide_denied_weight": 1.0, "structure_weight": 3.0, "offset": 0.0}


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> tuple[dict, Path]:
    """What the script writes of toy rows of all groups, and where."""
    folder = tmp_path_factory.mktemp("decision")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        import decision as script
        from lib import simulated as _simulated
        from lib import simulated_halls, simulated_sensors

        (folder / "pairs").mkdir()
        write_dataset(folder / "pairs" / "room")
        groups = ("room", *_simulated.PRESETS, *simulated_sensors.PRESETS, *simulated_halls.PRESETS)
        kept = folder / "rows.pkl"
        kept.write_bytes(pickle.dumps((toy_rows(groups), {"commit": "abc"})))
        options = ["--data", str(folder / "pairs"), "--out", str(folder), "--rows", str(kept)]
        patch.setattr(sys, "argv", ["decision.py", *options])
        script.main()
    return json.loads((folder / "decision.json").read_text()), folder


# --- weights ----------------------------------------------------------------------------------------------------------


def test_fitted_weights_tell_separable_poses_apart():
    from lib.weights import WEIGHTS, compare_weights

    found = compare_weights(toy_rows(CONFIGS), CONFIGS)
    assert list(found["leave_one_sensor_out"]) == SENSOR_NAMES
    for tested in found["leave_one_sensor_out"].values():
        assert tested["margin_auc"] > 0.95
        assert min(tested["weights"][name] for name in WEIGHTS) > 0.0
    assert found["num_right_and_wrong"] == {"a": [30, 30], "b": [30, 30], "OS1-64": [60, 60]}
    assert found["configured"]["structure_weight"] == CONFIGS["a"].decision.structure_weight


def test_planted_log_odds_are_found_again():
    from lib.weights import fit_weights

    fitted = fit_weights(planted_rows("a", (-1.5, -0.7, 4.0)), CONFIGS)
    assert fitted["denied_weight"] == pytest.approx(1.5, rel=0.15)
    assert fitted["wide_denied_weight"] == pytest.approx(0.7, rel=0.25)
    assert fitted["structure_weight"] == pytest.approx(4.0, rel=0.15)


@pytest.mark.parametrize(
    ("misleading", "weight"),
    [((1.5, -1.0, 3.0), "denied_weight"), ((-1.5, 1.0, 3.0), "wide_denied_weight"),
     ((-1.5, -1.0, -3.0), "structure_weight")],
)  # fmt: skip
def test_a_number_that_misleads_gets_no_weight_rather_than_a_negative_one(misleading, weight):
    from lib.weights import WEIGHTS, fit_weights

    fitted = fit_weights(planted_rows("a", misleading, 600), CONFIGS)
    assert fitted[weight] == 0.0
    assert sorted(fitted[name] for name in WEIGHTS)[1] > 0.0  # only that one is dropped


def test_the_offset_is_that_of_even_odds():
    from lib.weights import fit_weights

    rows = [row("a", correct, evidence(denied)) for correct, denied in ((True, 0.01), (False, 0.2))]
    config = dataclasses.replace(CONFIGS["a"].decision, **fit_weights(rows, CONFIGS))
    right, wrong = (decision.measure_margins(evidence(denied), config).seen for denied in (0.01, 0.2))
    assert right > 1 > -1 > wrong
    assert right + wrong == pytest.approx(0.0, abs=0.2)  # rounding of offset and weights


def test_a_left_out_sensor_is_not_used():
    from lib.weights import fit_without_each

    rows = toy_rows(CONFIGS)
    spoilt = [dataclasses.replace(r, correct=not r.correct) if r.dataset == SAME else r for r in rows]
    honest, other = fit_without_each(rows, CONFIGS), fit_without_each(spoilt, CONFIGS)
    assert list(honest) == SENSOR_NAMES
    assert honest["OS1-64"] == other["OS1-64"]
    assert honest["a"] != other["a"]
    assert honest["b"] != other["b"]
    kept = [r for r in rows if r.dataset in ("a", "b")]
    assert fit_without_each([*kept, row(ONE, True, evidence(0.3))], CONFIGS)["OS1-64"] == honest["OS1-64"]


def test_left_out_poses_are_answered_by_the_weights_of_the_others():
    from lib.rules import Variant, answer_variant
    from lib.sensors import sensor_of
    from lib.weights import WEIGHTS, answer_left_out, fit_without_each

    rows = toy_rows(CONFIGS)
    for name in (None, *WEIGHTS):
        fitted = fit_without_each(rows, CONFIGS, name)
        assert all((weights[key] == 0.0) == (key == name) for weights in fitted.values() for key in WEIGHTS)
        answers = answer_left_out(rows, CONFIGS, name)
        for r, answer in zip(rows, answers, strict=True):
            borders = fitted[sensor_of(r.dataset)]
            assert answer == answer_variant(r, CONFIGS["a"], Variant(borders=borders))
    relabelled = [dataclasses.replace(r, correct=not r.correct) if r.dataset == "b" else r for r in rows]
    once, again = answer_left_out(rows, CONFIGS), answer_left_out(relabelled, CONFIGS)
    of_b = [k for k, r in enumerate(rows) if r.dataset == "b"]
    assert [once[k] for k in of_b] == [again[k] for k in of_b]  # labels of a tested sensor are never looked at
    assert once != again


@pytest.mark.parametrize("name", ["wide_denied_weight", "structure_weight"])
def test_a_number_that_is_not_weighed_is_not_seen(name):
    from lib.weights import fit_weights

    rng = np.random.default_rng(5)

    def with_noise(r):
        seen = dict(r.seen["refined"])
        if name == "structure_weight":
            seen["weakest_constraint"] = rng.uniform(0.0, 0.3)
        else:
            seen |= {f"wide_denied_{way}": rng.uniform(0, 900) for way in ("source_in_target", "target_in_source")}
        return dataclasses.replace(r, seen={**r.seen, "refined": seen})

    rows = toy_rows(CONFIGS)
    noisy = [with_noise(r) for r in rows]
    assert fit_weights(noisy, CONFIGS, name) == fit_weights(rows, CONFIGS, name)
    assert fit_weights(noisy, CONFIGS) != fit_weights(rows, CONFIGS)


def test_sensors_and_labels_weigh_the_same_however_many_poses_they_have():
    from lib.weights import fit_weights

    rows = toy_rows(CONFIGS)
    many = rows + [r for r in rows if r.dataset == "a" and r.correct] * 4
    assert fit_weights(many, CONFIGS) == fit_weights(rows, CONFIGS)
    unequal = rows + [r for r in rows if r.dataset == ONE and r.correct] * 4  # half of that sensor's right poses
    assert fit_weights(unequal, CONFIGS) != fit_weights(rows, CONFIGS)


def test_poses_out_of_contact_or_moved_away_do_not_count():
    from lib.weights import compare_weights, fit_weights

    rows = toy_rows(CONFIGS)
    misleading = [
        row("a", True, evidence(0.6, 0.02, overlap=0.05)),
        row("a", True, evidence(0.6, 0.02, constraint_ratio=0.001)),
        row("a", True, evidence(0.6, 0.02), moved=(0.0, 50.0)),
    ]
    assert fit_weights(rows + misleading, CONFIGS) == fit_weights(rows, CONFIGS)
    assert compare_weights(rows + misleading, CONFIGS)["num_right_and_wrong"]["a"] == [30, 30]
    assert fit_weights([*rows, row("a", True, evidence(0.6, 0.02))], CONFIGS) != fit_weights(rows, CONFIGS)


def test_nothing_is_fitted_to_one_label():
    from lib.weights import fit_weights, fit_without_each

    with pytest.raises(ValueError, match="3 right of 3"):
        fit_weights([row("a", True, evidence(0.01))] * 3, CONFIGS)
    rows = [row("a", True, evidence(0.01)), row("b", True, evidence(0.01)), row("b", False, evidence(0.3))]
    with pytest.raises(ValueError, match="1 right of 1"):
        fit_without_each(rows, CONFIGS)


def test_poses_that_move_away_rank_last_and_are_no_extremes():
    from lib.weights import judge_margins

    rows = [row("a", True, evidence(0.01)), row("a", True, evidence(0.001), moved=(0.0, 50.0)),
            row("a", False, evidence(0.3)), row("a", False, evidence(0.0), moved=(90.0, 0.0))]  # fmt: skip
    found = judge_margins(rows, CONFIGS, OTHER_SENSORS)
    config = dataclasses.replace(CONFIGS["a"].decision, **OTHER_SENSORS)
    right, wrong = (decision.measure_margins(evidence(denied), config).smallest for denied in (0.01, 0.3))
    assert (found["smallest_right_margin"], found["largest_wrong_margin"]) == (right, wrong)
    assert found["margin_auc"] == pytest.approx((2 + 0.5) / 4)  # the moved right pose ties with the moved wrong one


# --- what is kept of a pose -------------------------------------------------------------------------------------------


def test_kept_numbers_make_the_same_evidence_again():
    from lib.evidence import evidence_of

    ways = (SightLines(5000, 1500, np.zeros(50), np.zeros(50), 700, 7), SightLines(400, 90, np.zeros(3), np.zeros(3)))
    seen = SightViewEvidence(*ways, 0.6, 0.5, 0.02, 0.11, 0.07, 0.8, surface(0.05, 0.09), surface(0.2, 0.01))
    numbers = seen.numbers()
    assert evidence_of(numbers).numbers() == pytest.approx(numbers)
    assert decision.describe(evidence_of(numbers)) == pytest.approx(decision.describe(seen))
    assert evidence_of(numbers).source_in_target.num_free == 700
    config = CONFIGS["a"].decision
    assert decision.decide(evidence_of(numbers), config) == decision.decide(seen, config)


def test_slips_are_measured_wherever_a_variant_may_accept():
    from lib.evidence import _may_be_accepted, evidence_of
    from lib.rules import VARIANTS, Variant

    variants = VARIANTS | {"other weights": Variant(borders=OTHER_SENSORS | {"offset": 8.0})}
    rng, config, accepted = np.random.default_rng(3), CONFIGS["a"].decision, dict.fromkeys(variants, 0)
    for _ in range(400):
        denied, wide = np.exp(rng.uniform(-6.0, -0.3, 2))
        overlap, oriented, opposed, constraint = rng.uniform(0.0, (1.0, 0.8, 1.0, 0.2))
        lines = SightLines(5000, 1500, np.zeros(50), np.zeros(50), 700, int(rng.uniform(0, 200)))
        seen = evidence(
            denied, rng.uniform(0.0, 0.3), wide, overlap, oriented_overlap_ratio=oriented, opposed_ratio=opposed,
            constraint_ratio=constraint, source_in_target=lines,
        )  # fmt: skip
        for name, variant in variants.items():
            judged = evidence_of(seen.numbers())
            if variant.plain_overlap:
                judged = dataclasses.replace(judged, oriented_overlap_ratio=overlap)
            decided = decision.decide(judged, dataclasses.replace(config, **variant.borders))
            if decided.verdict is Verdict.ACCEPTED:
                accepted[name] += 1
                assert _may_be_accepted(seen, config), name
    assert accepted["svc, nothing denied"] > 2 * accepted["svc"] > 0
    assert not _may_be_accepted(evidence(0.0, overlap=0.05), config)
    assert not _may_be_accepted(evidence(0.0, constraint_ratio=0.0), config)


def test_slips_come_far_near_near_far_along_every_weak_direction():
    from lib.evidence import slipped

    contact = SimpleNamespace(weak_directions=lambda limit, at_least=1: np.eye(3)[: 2 if limit == 0.13 else 3])
    pair = SimpleNamespace(config=CONFIGS["a"], contact=lambda T: contact)
    shifts = [T[:3, 3].tolist() for T in slipped(pair, np.eye(4))]
    along = [-2.4, -1.2, 1.2, 2.4]
    assert shifts == [[d, 0.0, 0.0] for d in along] + [[0.0, d, 0.0] for d in along]


def test_measured_rows_are_answered_as_verify_answers_them(monkeypatch, tmp_path):
    from lib import evidence as _evidence
    from lib.common import config_of
    from lib.rules import VARIANTS, answer_variant

    monkeypatch.setattr(_evidence, "_EVERY", 1)
    dataset = read_dataset(write_dataset(tmp_path / "room"))
    rows = _evidence.gather((dataset, dataset.candidates[0], 0))
    assert [(r.correct, r.origin) for r in rows] == [(True, "reference"), (False, "far")]  # the grey one is left out
    answers = {k: answer_variant(r, config_of(dataset), VARIANTS["svc"]) for k, r in enumerate(rows)}
    assert _evidence.check_against_verify(rows, answers) == (2, 0)
    assert answers[0][0]
    assert rows[0].slips["refined"]
    others = {0: (not answers[0][0], answers[0][1]), 1: (answers[1][0], answers[1][1] + 0.01)}
    assert _evidence.check_against_verify(rows, others) == (0, 2)


# --- simulated sets ---------------------------------------------------------------------------------------------------


def test_traffic_is_labelled_with_the_true_pose():
    from lib import simulated as _simulated

    rows = _simulated.gather_simulated((_simulated.Place(_simulated.TRAFFIC, "VLP-16", 1), 1))
    assert [r.correct for r in rows] == [True] * 3
    for r in rows:
        assert r.dataset == _simulated.TRAFFIC
        assert r.moved[1] < 0.1  # refinement stays at the truth
        assert np.abs(r.contact.error[:3]).max() < 0.1
        assert r.seen["refined"]["oriented_overlap_ratio"] > 0.3
    assert sum(r.seen["refined"]["num_blocked_source_in_target"] for r in rows) > 0  # something did change


def test_half_of_the_parked_cars_are_gone():
    from lib import simulated as _simulated

    from svc_ros.simulation import build_scene
    from svc_ros.simulation.world import SceneConfig

    scene = build_scene("street", np.random.default_rng(2), SceneConfig(moving_share=0.0))
    cars = scene.kinds().count("car")
    left = [thing.mesh_at(60.0) is not None for thing in _simulated.without_cars(scene, 2).objects]
    assert len(left) - sum(left) == round(0.5 * cars) > 0
    assert all(thing.mesh_at(0.0) is not None for thing in _simulated.without_cars(scene, 2).objects)


def test_rooms_are_wrong_poses_that_registration_found(monkeypatch):
    from lib import simulated as _simulated

    monkeypatch.setattr(_simulated, "_BOTH_SIDES", ((5, 6),))
    rows = _simulated.gather_simulated((_simulated.Place(_simulated.ROOMS, "VLP-16", 26), 0))
    (only,) = rows
    assert (only.correct, only.contact, only.origin, only.dataset) == (False, None, "register", _simulated.ROOMS)
    assert only.seen["refined"]["oriented_overlap_ratio"] > 0.2  # they do look alike
    assert only.verified is not None


def test_halls_are_a_true_pose_and_its_half_turn(monkeypatch):
    from lib import evidence as _evidence
    from lib import simulated_halls
    from lib.rules import VARIANTS, answer_variant

    places = simulated_halls.places()
    assert len(set(places)) == len(places) == 24
    place = places[0]
    monkeypatch.setattr(_evidence, "_EVERY", 1)
    truth, turned = judged = simulated_halls.judge(place).candidates
    assert [(c.label, c.origin) for c in judged] == [("correct", "truth"), ("wrong", "half turn")]
    apart = se3.invert(truth.T_target_source) @ turned.T_target_source
    assert se3.pose_error(apart, np.eye(4))[0] == pytest.approx(180.0, abs=1e-3)
    assert abs(apart[2, 3]) < 1e-9  # about the vertical
    rows = simulated_halls.gather_simulated((place, 0))
    assert [(r.dataset, r.correct) for r in rows] == [(simulated_halls.HALLS, True), (simulated_halls.HALLS, False)]
    assert all(r.seen["refined"]["oriented_overlap_ratio"] > 0.3 for r in rows)  # the walls agree either way
    answers = {k: answer_variant(r, place.config, VARIANTS["svc"]) for k, r in enumerate(rows)}
    assert _evidence.check_against_verify(rows, answers) == (2, 0)
    assert not answers[1][0]


def test_no_weight_is_fitted_to_halls():
    from lib.weights import compare_weights, fit_weights

    rows, configs = toy_rows(CONFIGS), CONFIGS | {"simulated halls": preset("lidar_indoor")}
    halls = [row("simulated halls", correct, evidence(0.6 if correct else 0.001, 0.2)) for correct in (True, False)]
    assert fit_weights(rows + halls, configs) == fit_weights(rows, CONFIGS)
    found = compare_weights(rows + halls, configs)
    assert found["num_right_and_wrong"]["simulated halls"] == [0, 0]
    assert found["leave_one_sensor_out"]["simulated halls"]["weights"] == found["fitted_to_all"]


# --- the script -------------------------------------------------------------------------------------------------------


def test_recorded_and_all_simulated_poses_are_measured_once(monkeypatch, tmp_path):
    import decision as script
    from lib import simulated as _simulated
    from lib import simulated_halls, simulated_sensors

    asked = []

    def spread(work, jobs, workers, text):
        asked.append((work, list(jobs)))
        return [toy_rows([text], 1)]

    monkeypatch.setattr(script, "spread", spread)
    dataset = read_dataset(write_dataset(tmp_path / "room"))
    options = argparse.Namespace(rows=tmp_path / "rows.pkl", workers=1)
    rows, run = script.collect([dataset], options, simulate=True)
    (_, recorded), *simulated = asked
    assert [job[1:] for job in recorded] == [(dataset.candidates[0], 0)]
    for (gather, jobs), group in zip(simulated, (_simulated, simulated_sensors, simulated_halls), strict=True):
        assert gather is group.gather_simulated
        assert [place for place, _ in jobs] == group.places()
    assert len(rows) == 8
    again, same = script.collect([dataset], options, simulate=True)
    assert (again, same, len(asked)) == (rows, run, 4)
    options.rows = None
    assert len(script.collect([dataset], options, simulate=False)[0]) == 2


def test_metrics_are_pooled_by_sensor_and_over_recorded_sets():
    import decision as script

    rows = [row(name, True, evidence(0.01)) for name in (ONE, SAME, "a", "simulated rooms")]
    tables = script.tabulate(rows, {"svc": [(True, 0.9), (False, 0.1), (True, 0.9), (False, 0.2)]})
    counts = {name: (table["svc"]["num_correct"], table["svc"]["recall"]) for name, table in tables.items()}
    assert counts == {
        ONE: (1, 1.0), SAME: (1, 0.0), "a": (1, 1.0), "simulated rooms": (1, 0.0), "OS1-64": (2, 0.5),
        script.RECORDED: (3, pytest.approx(2 / 3)), script.ALL: (4, 0.5),
    }  # fmt: skip


def test_equal_scores_are_accepted_together():
    import decision as script

    scores, correct = np.array([0.9, 0.5, 0.5, 0.1]), np.array([True, False, True, False])
    coverage, risk = script.risk_curve(scores, correct)
    assert coverage.tolist() == [0.5, 1.0, 1.0]
    assert risk.tolist() == pytest.approx([0.0, 1 / 3, 0.5])


@pytest.mark.slow
def test_the_script_compares_fits_and_writes(report):
    import decision as script

    found, folder = report
    assert found["run"] == {"commit": "abc"}
    assert len(found["num_poses"]) == 9
    assert set(found["num_poses"].values()) == {60}
    assert list(found["weights"]["leave_one_sensor_out"]) == list(found["num_poses"])
    rules = found["decision"]["all sets"]
    assert rules[script.OTHERS]["roc_auc"] > 0.95
    assert set(script.IN_PICTURE) <= set(rules)
    assert found["calibration"]["expected_calibration_error"]["all sets"] < 0.2
    for picture in ("risk-coverage.png", "reliability.png"):
        assert (folder / picture).read_bytes().startswith(b"\x89PNG")


def test_the_tables_of_the_pages_can_be_made_of_what_the_script_writes(report):
    """All sections are of the keys and names that decision.py writes now, however old the stored run is."""
    tables = module_from(BENCHMARKS / "tables.py")
    found, _ = report
    results = {**tables.read_results(tables.RESULTS), "decision": found}
    written = {name: section(results) for name, section in tables.SECTIONS.items()}
    sensors = list(found["num_poses"])
    for name in ("left out", "margins"):
        assert [line.split(" | ")[0] for line in written[name].splitlines()[2:]] == [f"| {s}" for s in sensors]
    own = found["decision"]["room"]["svc, weights of the other sensors"]
    paper = found["decision"]["room"]["svc_paper"]
    error = found["calibration"]["expected_calibration_error"]["room"]
    accepted = round(own["recall"] * own["num_correct"])
    told = (f"room | {accepted} of 30 | {own['num_false_accepted']} of 30 | {own['f1']:.3f} | {error:.3f} | "
            f"{round(paper['recall'] * 30)} of 30 | {paper['num_false_accepted']} |")  # fmt: skip
    assert told in written["left out"]
    assert written["weights"].count("`decision.") == len(tables.WEIGHTS) == len(found["weights"]["configured"])
    for name, lines in (("decision rules", tables.RULES), ("parts", tables.PARTS)):
        assert len(written[name].splitlines()) == 2 + len(lines)
    assert [line.split(" | ")[0] for line in written["numbers"].splitlines()[2:]] == [
        "| nothing", "| denied", "| wide denied", "| structure",
    ]  # fmt: skip
    changed = {**results, "decision": json.loads(json.dumps(found))}
    changed["decision"]["calibration"]["expected_calibration_error"]["room"] = 0.777
    assert "| 0.777 |" in tables.left_out_table(changed)
    assert written["calibration error"] == f"{found['calibration']['expected_calibration_error']['all sets']:.3f}"
