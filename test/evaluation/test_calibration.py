"""Numbers of a calibration, against scipy and by hand; what is said where data are too few."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from places import PROJECT_ROOT
from scipy.stats import binom, binomtest

from svc_ros.core.config import preset
from svc_ros.core.errors import InputError
from svc_ros.evaluation.calibration import run as calibration_run
from svc_ros.evaluation.calibration.claims import (
    JudgedPose,
    binomial_upper_bound,
    choose_claim,
    claim_at,
    curve,
    expected_calibration_error,
    pair_scores,
    pairs_needed,
    reliability_bins,
    surest_claim,
)
from svc_ros.evaluation.calibration.page import border_rows, count_rows, write_calibration_page
from svc_ros.evaluation.calibration.run import CalibrationOptions, calibrated_yaml
from svc_ros.evaluation.calibration.summary import Goal, JudgedSet, percent, statement, summarise_calibration
from svc_ros.evaluation.calibration.trials import Judged
from svc_ros.io.config_yaml import read_config_file
from svc_ros.io.datasets import Dataset, Pair, SuccessThresholds


def pose(pair: str, probability: float | None, correct: bool = False, **more) -> JudgedPose:
    accepted = more.pop("accepted", probability is not None and probability >= 0.5)
    return JudgedPose(more.pop("dataset", "a"), pair, more.pop("kind", "slip"), correct, accepted, probability, **more)


def summary_of(scores: list[float], goal: Goal | None = None) -> dict:
    judged = [
        Judged((pose(str(k), 0.9, True, kind="reference"), pose(str(k), score))) for k, score in enumerate(scores)
    ]
    return summarise_calibration([JudgedSet("a", [], judged)], goal or Goal(0.05, 0.95, 0.5))


class TestBound:
    @pytest.mark.parametrize(("failures", "trials"), [(0, 1), (0, 299), (1, 20), (3, 400), (19, 20), (7, 7)])
    @pytest.mark.parametrize("confidence", [0.8, 0.95, 0.999])
    def test_it_is_the_exact_one_of_scipy(self, failures, trials, confidence):
        expected = binomtest(failures, trials, alternative="less").proportion_ci(confidence, "exact").high
        assert binomial_upper_bound(failures, trials, confidence) == pytest.approx(expected, abs=1e-12)

    def test_so_few_failures_would_be_that_rare_at_the_bound(self):
        assert binom.cdf(2, 150, binomial_upper_bound(2, 150, 0.95)) == pytest.approx(0.05)

    def test_no_trial_promises_nothing(self):
        assert binomial_upper_bound(0, 0) == 1.0

    @pytest.mark.parametrize("counts", [(-1, 3), (4, 3)])
    def test_impossible_counts_are_refused(self, counts):
        with pytest.raises(InputError, match="failures: expected 0 to 3"):
            binomial_upper_bound(*counts)

    @pytest.mark.parametrize("confidence", [0.0, 1.0, 95.0, float("nan")])
    def test_a_confidence_is_a_share(self, confidence):
        with pytest.raises(InputError, match="confidence: expected a number between 0 and 1"):
            binomial_upper_bound(0, 3, confidence)

    @pytest.mark.parametrize(("rate", "confidence", "num"), [(0.01, 0.95, 299), (0.5, 0.5, 1), (0.001, 0.99, 4603)])
    def test_as_many_pairs_as_needed_and_not_one_more(self, rate, confidence, num):
        assert pairs_needed(rate, confidence) == num
        assert binomial_upper_bound(0, num, confidence) <= rate + 1e-12
        assert num == 1 or binomial_upper_bound(0, num - 1, confidence) > rate


class TestPairs:
    def test_a_pair_is_as_bad_as_its_worst_wrong_pose(self):
        poses = [pose("1", 0.6), pose("1", 0.8), pose("1", 0.99, True), pose("2", 0.2), pose("3", 0.9, True)]
        poses += [pose("1", 0.7, dataset="b")]
        assert pair_scores(poses) == {("a", "1"): 0.8, ("a", "2"): 0.0, ("b", "1"): 0.7}

    def test_what_doubts_withdrew_is_accepted_at_no_probability(self):
        assert pose("1", 0.9, accepted=False).score == 0.0
        assert pose("1", None).score == 0.0

    def test_the_border_itself_accepts(self):
        assert claim_at(0.8, [0.8, 0.79, 0.0]).num_failed == 1

    def test_the_smallest_value_that_keeps_the_promise_is_chosen(self):
        scores = [0.0] * 300 + [0.7, 0.93456, 0.6]
        claim = choose_claim(scores, 0.01)
        assert (claim.min_probability, claim.num_failed, claim.num_pairs) == (0.9346, 0, 303)
        assert claim.bound <= 0.01
        lenient = choose_claim(scores, 0.016)
        assert (lenient.min_probability, lenient.num_failed) == (0.7001, 1)
        assert choose_claim(scores, 0.1).min_probability == 0.5

    def test_a_score_with_four_digits_is_refused_by_the_next(self):
        assert choose_claim([0.93] + [0.0] * 298, 0.01).min_probability == 0.9301

    def test_few_pairs_promise_what_they_can(self):
        assert choose_claim([0.0, 0.6], 0.01) is None
        claim = surest_claim([0.0, 0.6])
        assert (claim.min_probability, claim.num_failed) == (0.6001, 0)
        assert claim.bound == pytest.approx(1 - 0.05**0.5)

    def test_a_wrong_pose_that_is_certain_cannot_be_kept_out(self):
        scores = [0.99999] + [0.0] * 500
        assert choose_claim(scores, 0.005) is None
        assert surest_claim(scores).num_failed == 1
        assert surest_claim([]).bound == 1.0

    def test_the_promise_is_kept(self):
        """In more than 95 % of draws the true rate at the chosen value is below the rate that was asked for."""
        rng, broken = np.random.default_rng(5), 0
        for _ in range(400):
            claim = choose_claim(rng.uniform(-3.0, 1.0, 100), 0.1)
            true_rate = (1.0 - claim.min_probability) / 4.0 if claim else 0.0
            broken += true_rate > 0.1
        assert broken / 400 <= 0.06


class TestReliability:
    def test_by_hand(self):
        rows = reliability_bins([0.05, 0.15, 0.95, 1.0], [False, True, True, True])
        assert [row["num"] for row in rows] == [1, 1, 0, 0, 0, 0, 0, 0, 0, 2]
        assert rows[9] == {"low": 0.9, "high": 1.0, "num": 2, "mean_probability": 0.975, "right_share": 1.0}
        assert rows[3]["mean_probability"] is None
        error = expected_calibration_error([0.05, 0.15, 0.95, 1.0], [False, True, True, True])
        assert error == pytest.approx((0.05 + 0.85 + 2 * 0.025) / 4)

    def test_edges_belong_to_the_bin_above(self):
        edges = [0.1, 0.3, 0.6, 0.7]
        nums = [row["num"] for row in reliability_bins(edges, [True] * 4)]
        assert [k for k, num in enumerate(nums) if num] == [1, 3, 6, 7]

    def test_true_probabilities_have_no_error(self):
        rng = np.random.default_rng(0)
        p = rng.random(20_000)
        assert expected_calibration_error(p, rng.random(20_000) < p) < 0.02
        assert expected_calibration_error(p, rng.random(20_000) < p**3) > 0.2

    def test_nothing_has_no_error_and_nonsense_is_refused(self):
        assert expected_calibration_error([], []) is None
        for values, labels in (([0.5], []), ([1.5], [True]), ([float("nan")], [True])):
            with pytest.raises(InputError, match="probabilities"):
                expected_calibration_error(values, labels)
        with pytest.raises(InputError, match="bins"):
            reliability_bins([0.5], [True], 0)


class TestSummary:
    def test_a_promise_that_holds(self):
        summary = summary_of([0.0] * 98 + [0.6, 0.7])
        assert summary["present"]["num_failed_pairs"] == 2
        assert summary["chosen"]["min_probability"] == 0.6001
        assert summary["chosen"]["right_accepted_share"] == 1.0
        assert summary["present"]["wrong_accepted_by_kind"] == {"slip": 2}
        assert (summary["num_pairs_needed"], summary["num_pairs_missing"]) == (59, 0)
        assert [row["probability"] for row in summary["wrong_accepted"]] == [0.7, 0.6]
        said = statement(summary)
        assert "decision.min_probability 0.6001, 1 of 100 pairs" in said
        assert "at most 4.66 % at 95 % confidence, as asked for (5 %)" in said
        json.dumps(summary, allow_nan=False)

    def test_too_few_pairs_say_how_many_are_missing(self):
        summary = summary_of([0.0] * 10)
        assert summary["chosen"] is None
        assert summary["num_pairs_missing"] == 49
        assert "Too few pairs: 5 % takes 59 pairs" in statement(summary)
        assert "these are 10, 49 too few" in statement(summary)
        assert "at most 25.9 % at 95 %" in statement(summary)

    def test_wrong_poses_that_are_certain_are_told_as_such(self):
        assert "cannot be promised by any value" in statement(summary_of([1.0] * 9 + [0.0] * 60))

    def test_the_curve_falls_and_holds_the_borders(self):
        poses = [pose(str(k), score) for k, score in enumerate((0.0, 0.55, 0.8))] + [pose("0", 0.7, True)]
        told = curve(poses, 0.95, [0.6789])
        assert told["num_failed_pairs"][0] == 2
        assert 0.6789 in told["min_probability"]
        for key in ("num_failed_pairs", "bound", "num_wrong_accepted", "right_accepted_share"):
            assert (np.diff(told[key]) <= 0).all(), key
        assert curve([], 0.95)["right_accepted_share"][0] is None

    def test_registrations_are_told_alone(self):
        judged = [Judged((pose("1", 0.8, kind="register"),)), Judged((pose("2", 0.9, True, kind="register"),))]
        register = summarise_calibration([JudgedSet("a", [], judged)], Goal(0.01, 0.95, 0.5))["register"]
        assert (register["num_registrations"], register["num_right"]) == (2, 1)
        assert [(at["num_wrong_accepted"], at["num_right_accepted"]) for at in register["at"]] == [(1, 1), (0, 1)]

    @pytest.mark.parametrize(
        ("share", "text"),
        [(0.00995, "0.995 %"), (0.009951, "0.996 %"), (0.01, "1 %"), (0.348, "34.8 %"), (0.0, "0 %"), (1.0, "100 %")],
    )
    def test_a_bound_is_never_rounded_down(self, share, text):
        assert percent(share, up=True) == text

    def test_the_file_holds_the_value_and_what_differs_from_the_preset(self, tmp_path):
        text = calibrated_yaml(summary_of([0.0] * 98 + [0.6, 0.7]), "lidar_indoor", preset("lidar_indoor"), "by\nme")
        (tmp_path / "calibration.yaml").write_text(text)
        read = read_config_file(tmp_path / "calibration.yaml")
        assert (read.preset, read.values) == ("lidar_indoor", {"decision.min_probability": 0.6001})
        assert "# by\n# me\n/**:" in text


class TestPage:
    def test_it_is_one_file_with_its_numbers(self, tmp_path):
        pytest.importorskip("plotly")
        write_calibration_page(tmp_path / "page.html", summary_of([0.0] * 98 + [0.6, 0.7]))
        text = (tmp_path / "page.html").read_text("utf-8")
        (data,) = re.findall(r'<script id="report-data" type="application/json">(.*?)</script>', text, re.DOTALL)
        told = json.loads(data)
        assert told["statement"].startswith("With decision.min_probability 0.6001")
        shell = re.sub(r"/\*\*\n\* plotly\.js.*?\n</script>", "", text.replace(data, ""), flags=re.DOTALL)
        assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!data:|#)|@import|url\(""", shell)
        assert "@@" not in shell

    def test_it_draws_in_a_browser(self, tmp_path):
        pytest.importorskip("plotly")
        pytest.importorskip("websocket")
        sys.path.insert(0, str(PROJECT_ROOT / "tools"))
        import chromium

        if chromium.find_chromium() is None:
            pytest.skip("no Chromium found: apt-get install chromium")
        write_calibration_page(tmp_path / "page.html", summary_of([0.0] * 20))
        with chromium.Chromium() as browser:
            browser.open(tmp_path / "page.html")
            browser.wait_for("document.querySelectorAll('#reliability svg').length > 0")
            assert browser.evaluate("document.getElementById('curve').data.length") == 3
            assert browser.evaluate("document.querySelectorAll('#borders tr').length") == 6
            assert browser.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
            assert browser.complaints == []
            assert browser.requests == [(tmp_path / "page.html").as_uri()]

    def test_several_data_sets_have_rows_of_their_own(self):
        judged = [JudgedSet(name, [], [Judged((pose("1", 0.6),))]) for name in ("x", "y")]
        rows = border_rows(summarise_calibration(judged, Goal(0.01, 0.95, 0.5)))
        assert ["x: right accepted", "-", "-"] in rows
        assert {len(row) for row in rows} == {3}
        assert {len(row) for row in count_rows(summary_of([0.0]))} == {2}


class TestRegisterAgain:
    """A registration that is not accepted searches on: what it finds then belongs to the promise."""

    @pytest.fixture
    def run(self, monkeypatch):
        config, calls = preset("lidar_indoor"), []
        items = [Pair(str(k), "t", np.eye(4)) for k in range(60)]
        dataset = Dataset(Path(), "a", "", "lidar_indoor", 0.5, 60.0, np.zeros(3), SuccessThresholds(5.0, 0.6), items)

        def judge(sets, trials, workers, on_progress, min_probability=0.5):
            calls.append((min_probability, [trial.pair.source for trial in trials[0]]))
            if len(calls) == 1:  # pair 0 has a wrong pose at 0.7, and every third registration is right at 0.6
                probability = [0.6 if k % 3 == 0 else 0.95 for k in range(60)]
                found = [[pose(t.name, p, True, kind="register"), pose(t.name, 0.7 if k == 0 else 0.1)]
                         for k, (t, p) in enumerate(zip(trials[0], probability, strict=True))]  # fmt: skip
            else:  # pair 3 finds a wrong pose at 0.9 instead
                found = [[pose(t.name, 0.9 if t.pair.source == "3" else 0.2, kind="register")] for t in trials[0]]
            return [[Judged(tuple(poses)) for poses in found]]

        monkeypatch.setattr(calibration_run, "judge_trials", judge)
        return calibration_run.calibrate([(dataset, config)], CalibrationOptions(Goal(0.05, 0.95, 0.5))), calls

    def test_what_is_found_then_raises_the_demand(self, run):
        summary, calls = run
        assert calls[0][0] == 0.5
        assert calls[1] == (0.7001, [str(k) for k in range(0, 60, 3)])
        assert summary["chosen"]["min_probability"] == 0.9001
        assert summary["num_poses_by_kind"]["register_again"] >= 1
        assert summary["wrong_accepted"][0]["pair"] == "3 - t"
