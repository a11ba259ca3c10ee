"""Results as JSON lines and as key-values: exact keys, strict JSON, and the same result read back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.se3 import make_pose
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence
from svc_ros.core.sight.weak_directions import Motion, WeakDirection
from svc_ros.io.results import (
    append_jsonl,
    decision_values,
    json_line,
    read_jsonl,
    result_from_json,
    result_to_json,
    write_jsonl,
)

CONTRACT = {"verdict", "reason", "T_target_source", "best_candidate", "covariance", "evidence", "counts", "time_ms"}
EVIDENCE = {
    "denied_ratio",
    "wide_denied_ratio",
    "num_denied_source_in_target",
    "blocked_ratio_source_in_target",
    "blocked_ratio_target_in_source",
    "overlap_ratio",
    "oriented_overlap_ratio",
}


@pytest.fixture
def accepted() -> RegistrationResult:
    T = make_pose(np.eye(3), [1.0, -2.5, 1 / 3])
    evidence = SightViewEvidence(
        SightLines(1000, 613, np.arange(7), np.arange(7), 40, 3),
        SightLines(900, 500, np.arange(2), np.arange(2)),
        0.7,
        0.6,
        0.1,
        0.2,
        0.15,
        0.9,
        SeenSurface(900, 500, np.arange(11), 2.25, 120, 80),
        SeenSurface(1000, 600, np.arange(3), 0.5, 100, 90),
    )
    return RegistrationResult(
        Verdict.ACCEPTED, Reason.OK, "svc", T, T, np.diag(np.arange(1.0, 7.0)) * 1e-4, 0.97, evidence,
        {"correspondences": 5000}, {"matching": 1.5, "total": 20.25}, "all is well",
        (WeakDirection(Motion.SHIFT, np.array([0.8, 0.0, 0.6]), 0.02), WeakDirection(Motion.TURN, np.eye(3)[2], 0.1)),
    )  # fmt: skip


@pytest.fixture
def rejected() -> RegistrationResult:
    return RegistrationResult(Verdict.REJECTED, Reason.TOO_FEW_POINTS, "svc", detail="3 points")


def test_the_object_has_the_keys_that_others_depend_on(accepted: RegistrationResult) -> None:
    record = result_to_json(accepted, source_stamp_ns=5, target_stamp_ns=4)
    assert set(record) >= CONTRACT | {"source_stamp_ns", "target_stamp_ns"}
    assert set(record["evidence"]) >= EVIDENCE
    assert (record["verdict"], record["reason"], record["time_ms"]["total"]) == ("accepted", "ok", 20.25)
    assert np.shape(record["T_target_source"]) == (4, 4)
    assert np.shape(record["covariance"]) == (6, 6)


def test_a_refused_pair_has_the_same_keys(accepted: RegistrationResult, rejected: RegistrationResult) -> None:
    record = result_to_json(rejected)
    assert set(record) == set(result_to_json(accepted))
    assert (
        record["T_target_source"] is record["best_candidate"] is record["covariance"] is record["probability"] is None
    )
    assert (record["evidence"], record["counts"], record["time_ms"]) == ({}, {}, {"total": 0.0})


def test_an_untimed_total_is_the_sum_of_the_stages(rejected: RegistrationResult) -> None:
    timed = replace(rejected, time_ms={"a": 1.5, "b": 2.0})
    assert result_to_json(timed)["time_ms"] == {"a": 1.5, "b": 2.0, "total": 3.5}
    assert timed.time_ms == {"a": 1.5, "b": 2.0}


@pytest.mark.parametrize("name", ["accepted", "rejected"])
def test_a_result_is_read_back_as_it_was(name: str, request: pytest.FixtureRequest) -> None:
    result: RegistrationResult = request.getfixturevalue(name)
    back = result_from_json(json.loads(json_line(result_to_json(result, note="x"))))
    assert result_to_json(back) == result_to_json(result)
    assert (back.verdict, back.reason, back.accepted) == (result.verdict, result.reason, result.accepted)
    if result.T_target_source is not None:
        np.testing.assert_array_equal(back.T_target_source, result.T_target_source)
    if result.evidence is not None:
        assert back.evidence is not None
        assert back.evidence.numbers() == result.evidence.numbers()


def test_lines_of_an_older_version_are_read(accepted: RegistrationResult) -> None:
    """They have no denied surface, and shares that are not told any more."""
    record = result_to_json(accepted)
    gone = ("denied", "confirmed", "hidden", "unseen", "num_points", "weakest", "constraint", "tight", "num_free")
    record["evidence"] = {k: v for k, v in record["evidence"].items() if not any(word in k for word in gone)}
    record["evidence"] |= {"contradicted_ratio": 0.2, "scattered_ratio_source_in_target": 0.01}
    back = result_from_json(record).evidence
    assert back is not None
    assert (back.source_in_target.num_blocked, back.oriented_overlap_ratio) == (7, 0.6)
    assert (back.source_surface.num_points, back.denied_ratio, back.constraint_ratio) == (0, 0.0, 1.0)


def test_which_points_are_denied_is_not_kept(accepted: RegistrationResult) -> None:
    back = result_from_json(result_to_json(accepted)).evidence
    assert back is not None
    assert (back.source_surface.denied_idx == -1).all()
    assert (back.source_surface.num_denied, back.target_surface.wide_denied) == (11, 0.5)


@pytest.mark.parametrize("value", [np.float64(1.5), np.int32(3), np.bool_(True), np.arange(3), Path("a/b"), (1, [2.0])])
def test_extra_values_become_plain_ones(rejected: RegistrationResult, value: object) -> None:
    plain = result_to_json(rejected, extra=value)["extra"]
    assert json.loads(json.dumps(plain)) == plain


def test_json_stays_strict(rejected: RegistrationResult) -> None:
    with pytest.raises(InputError, match=r"extra.a\[1\]: expected a finite number, found nan"):
        result_to_json(rejected, extra={"a": [1.0, float("nan")]})
    with pytest.raises(InputError, match=r"time_ms.x: expected a finite number, found inf"):
        result_to_json(replace(rejected, time_ms={"x": np.inf}))
    with pytest.raises(InputError, match=r"extra: .*JSON can hold, found set"):
        json_line({"extra": {1}})
    with pytest.raises(InputError, match="extra key 'verdict'"):
        result_to_json(rejected, verdict="accepted")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"verdict": None}, "verdict: missing"),
        ({"verdict": "maybe"}, "verdict: expected one of accepted, rejected"),
        ({"reason": "bad luck"}, "reason: expected one of ok"),
        ({"T_target_source": "x"}, "T_target_source: expected a matrix"),
        ({"covariance": [[1.0]]}, "covariance: expected shape 6 x 6"),
        ({"evidence": {"overlap_ratio": 1.0}}, r"evidence\.num_lines_source_in_target: missing"),
        ({"verdict": "rejected"}, "accepted verdict"),
    ],
)
def test_a_broken_record_is_named_by_key(accepted: RegistrationResult, change: dict, message: str) -> None:  # type: ignore[type-arg]
    record = {k: v for k, v in {**result_to_json(accepted), **change}.items() if v is not None}
    with pytest.raises(InputError, match=message):
        result_from_json(record)


def test_lines_are_written_appended_and_read(tmp_path: Path, rejected: RegistrationResult) -> None:
    path = tmp_path / "decisions.jsonl"
    write_jsonl(path, [{"k": 0}, {"k": 1}])
    append_jsonl(path, result_to_json(rejected, k=2))
    assert [record["k"] for record in read_jsonl(path)] == [0, 1, 2]
    append_jsonl(tmp_path / "new.jsonl", {"k": 0})
    assert read_jsonl(tmp_path / "new.jsonl") == [{"k": 0}]


def test_broken_files_of_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    for line, message in (("{", ":2: expected one JSON object"), ("[1]", r":2: .*found '\[1\]'")):
        path.write_text('{"k": 1}\n' + line + "\n")
        with pytest.raises(InputError, match=message):
            read_jsonl(path)
    with pytest.raises(InputError, match="No such file"):
        read_jsonl(tmp_path / "absent")
    with pytest.raises(InputError, match="cannot be written"):
        write_jsonl(tmp_path / "nowhere" / "a", [])


def test_decision_values_are_flat_text(accepted: RegistrationResult) -> None:
    values = decision_values(accepted, 1_630_577_758_569_489_956, 1_630_577_757_000_000_001)
    assert values["verdict"] == "accepted"
    assert values["reason"] == "ok"
    assert values["source_stamp"] == "1630577758.569489956"
    assert values["target_stamp"] == "1630577757.000000001"
    assert float(values["probability"]) == 0.97
    assert float(values["blocked_ratio_source_in_target"]) == 0.007
    assert values["counts.correspondences"] == "5000"
    assert values["time_ms.total"] == "20.25"
    assert all(isinstance(value, str) for value in values.values())


def test_decision_values_of_a_dropped_pair_say_so() -> None:
    dropped = RegistrationResult(Verdict.DROPPED, Reason.STALE)
    values = decision_values(dropped, 2, 1)
    assert {key: values[key] for key in ("verdict", "reason")} == {"verdict": "dropped", "reason": "stale"}
    assert "probability" not in values


def test_weak_directions_are_told_by_name_and_vector_and_read_back(
    accepted: RegistrationResult, rejected: RegistrationResult
) -> None:
    record = json.loads(json_line(result_to_json(accepted)))
    shift = {"name": "along 0.80 0.00 0.60", "motion": "shift", "vector": [0.8, 0.0, 0.6], "strength": 0.02}
    turn = {"name": "yaw", "motion": "turn", "vector": [0.0, 0.0, 1.0], "strength": 0.1}
    assert record["weak_directions"] == [shift, turn]
    values = decision_values(accepted, 5, 4)
    assert values["weak_directions"] == "along 0.80 0.00 0.60, yaw"
    assert json.loads(values["weak_direction_vectors"]) == [shift, turn]
    assert result_to_json(result_from_json(record))["weak_directions"] == [shift, turn]
    held = replace(accepted, weak_directions=())
    assert (result_to_json(held)["weak_directions"], decision_values(held, 5, 4)["weak_directions"]) == ([], "")
    assert result_to_json(rejected)["weak_directions"] is None
    assert "weak_directions" not in decision_values(rejected, 5, 4)
    for wrong in (3, [{"motion": "slide", "vector": [1, 0, 0], "strength": 0}], [{"motion": "turn"}]):
        with pytest.raises(InputError, match="weak_directions"):
            result_from_json(record | {"weak_directions": wrong})
