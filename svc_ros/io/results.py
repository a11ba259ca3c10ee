"""A decision as strict JSON, one object a line, and as flat key-values for diagnostic messages.

Keys of the JSON object: verdict, reason, method, probability, T_target_source, best_candidate, covariance, evidence,
weak_directions, counts, time_ms, detail. Matrices are nested lists, row by row, or null; `evidence` is empty, and
`weak_directions` null, where nothing was judged.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Array
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence, no_surface
from svc_ros.core.sight.weak_directions import Motion, WeakDirection, names_of
from svc_ros.io.stamps import text_from_ns

# Of an accepted pose whose method gives none: 1 m and 10 deg, so that nobody takes it for certain.
UNKNOWN_COVARIANCE = np.diag([1.0] * 3 + [np.deg2rad(10.0) ** 2] * 3)
_Code = TypeVar("_Code", bound=Enum)
_LATER_RATIOS = ("constraint_ratio", "weakest_constraint", "tight_ratio")  # not in every file of decisions


def result_to_json(result: RegistrationResult, **extra: Any) -> dict[str, Any]:
    """The result as plain values that strict JSON can hold; `extra` keys (stamps, paths, indices) come first.

    `time_ms` always has `total`: of a result that was never timed it is the sum of its stages.
    Raises InputError for a number that is NaN or inf, and for an extra key that the result itself has.
    """
    times = dict(result.time_ms)
    times.setdefault("total", float(sum(times.values())))
    own = {
        "verdict": result.verdict,
        "reason": result.reason,
        "method": result.method,
        "probability": result.probability,
        "T_target_source": result.T_target_source,
        "best_candidate": result.best_candidate,
        "covariance": result.covariance,
        "evidence": result.evidence.numbers() if result.evidence is not None else {},
        "weak_directions": _weak_to_json(result.weak_directions),
        "counts": result.counts,
        "time_ms": times,
        "detail": result.detail,
    }
    if taken := sorted(set(own) & set(extra)):
        raise InputError(f"result: extra key {taken[0]!r} is one of the result's own")
    return {key: _plain(value, key) for key, value in {**extra, **own}.items()}


def result_from_json(record: Mapping[str, Any]) -> RegistrationResult:
    """Rebuild a result from `result_to_json`; keys that are not the result's own are ignored.

    JSON keeps how many sight lines are blocked and points denied, not which: the index arrays of the evidence have the
    right length and hold -1. Lines of older versions lack some numbers: what they did not measure counts as not seen.
    Raises InputError naming the key that is missing or wrong.
    """
    return RegistrationResult(
        verdict=_code(record, "verdict", Verdict),
        reason=_code(record, "reason", Reason),
        method=str(record.get("method", "")),
        T_target_source=_matrix(record, "T_target_source"),
        best_candidate=_matrix(record, "best_candidate"),
        covariance=_matrix(record, "covariance"),
        probability=record.get("probability"),
        evidence=_evidence(record.get("evidence") or {}),
        weak_directions=_weak_from_json(record.get("weak_directions")),
        counts=dict(record.get("counts") or {}),
        time_ms=dict(record.get("time_ms") or {}),
        detail=str(record.get("detail", "")),
    )


def json_line(record: Mapping[str, Any]) -> str:
    """One record as one line of strict JSON, without the line's end; InputError names a value JSON cannot hold."""
    return json.dumps({key: _plain(value, str(key)) for key, value in record.items()}, allow_nan=False)


def write_jsonl(path: str | Path, records: Iterable[Mapping[str, Any]]) -> None:
    """Write records as JSON lines into a new file, or over an old one."""
    _write(path, "".join(json_line(record) + "\n" for record in records), "w")


def append_jsonl(path: str | Path, record: Mapping[str, Any]) -> None:
    """Add one record to the end of a file of JSON lines, which need not exist yet."""
    _write(path, json_line(record) + "\n", "a")


def read_jsonl(path: str | Path) -> list[dict[str, Any]]:
    """Read all records of a file of JSON lines; InputError names the line that is no JSON object."""
    try:
        lines = Path(path).read_text("utf-8").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected lines of JSON, found binary data") from None
    return [_parsed(line, f"{path}:{number}") for number, line in enumerate(lines, 1) if line.strip()]


def decision_values(result: RegistrationResult, source_stamp_ns: int, target_stamp_ns: int) -> dict[str, str]:
    """The decision as flat key-values, for a DiagnosticStatus.

    `verdict`, `reason`, `source_stamp`, `target_stamp` (seconds with nine decimals), `method` and `detail` are always
    there; `probability` and the evidence's numbers where something was judged, and `weak_directions` (their names) with
    `weak_direction_vectors` (JSON, as in the record); `counts.NAME` and `time_ms.STAGE`.
    """
    values = {
        "verdict": result.verdict.value,
        "reason": result.reason.value,
        "source_stamp": text_from_ns(source_stamp_ns),
        "target_stamp": text_from_ns(target_stamp_ns),
        "method": result.method,
        "detail": result.detail,
    }
    if result.weak_directions is not None:
        values["weak_directions"] = names_of(result.weak_directions)
        values["weak_direction_vectors"] = json.dumps(_weak_to_json(result.weak_directions))
    numbers: dict[str, Any] = {} if result.probability is None else {"probability": result.probability}
    numbers |= result.evidence.numbers() if result.evidence is not None else {}
    numbers |= {f"counts.{name}": count for name, count in result.counts.items()}
    numbers |= {f"time_ms.{stage}": round(float(ms), 3) for stage, ms in result.time_ms.items()}
    return values | {key: f"{_plain(value, key):.9g}" for key, value in numbers.items()}


def _plain(value: Any, key: str) -> Any:
    """The value in JSON's own types; `key` is its path, for the complaint."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise InputError(f"result: {key}: expected a finite number, found {value}")
        return value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {str(name): _plain(item, f"{key}.{name}") for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, f"{key}[{k}]") for k, item in enumerate(value)]
    raise InputError(f"result: {key}: expected something that JSON can hold, found {type(value).__name__}")


def _code(record: Mapping[str, Any], key: str, codes: type[_Code]) -> _Code:
    try:
        return codes(record[key])
    except KeyError:
        raise InputError(f"result: {key}: missing") from None
    except ValueError:
        known = ", ".join(str(code.value) for code in codes)
        raise InputError(f"result: {key}: expected one of {known}, found {record[key]!r:.60}") from None


def _matrix(record: Mapping[str, Any], key: str) -> Array | None:
    value = record.get(key)
    if value is None:
        return None
    try:
        return np.array(value, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"result: {key}: expected a matrix of numbers, found {value!r:.60}") from None


def _weak_to_json(directions: Sequence[WeakDirection] | None) -> list[dict[str, Any]] | None:
    if directions is None:
        return None
    return [
        {"name": d.name, "motion": d.motion.value, "vector": d.vector.tolist(), "strength": d.strength}
        for d in directions
    ]


def _weak_from_json(found: Any) -> tuple[WeakDirection, ...] | None:
    if found is None:
        return None
    try:
        return tuple(WeakDirection(Motion(d["motion"]), d["vector"], float(d["strength"])) for d in found)
    except (KeyError, TypeError, ValueError):
        raise InputError(f"result: weak_directions: expected a list of directions, found {found!r:.60}") from None


def _evidence(numbers: Mapping[str, Any]) -> SightViewEvidence | None:
    if not numbers:
        return None
    try:
        return SightViewEvidence(
            source_in_target=_sight_lines(numbers, "source_in_target"),
            target_in_source=_sight_lines(numbers, "target_in_source"),
            overlap_ratio=float(numbers["overlap_ratio"]),
            oriented_overlap_ratio=float(numbers["oriented_overlap_ratio"]),
            opposed_ratio=float(numbers["opposed_ratio"]),
            **{name: float(numbers[name]) for name in _LATER_RATIOS if name in numbers},
            source_surface=_surface(numbers, "source_in_target"),
            target_surface=_surface(numbers, "target_in_source"),
        )
    except KeyError as error:
        raise InputError(f"result: evidence.{error.args[0]}: missing") from None


def _sight_lines(numbers: Mapping[str, Any], direction: str) -> SightLines:
    num_lines = int(numbers[f"num_lines_{direction}"])
    unknown = np.full(int(numbers[f"num_blocked_{direction}"]), -1)
    num_observed = round(float(numbers[f"observed_ratio_{direction}"]) * num_lines)
    num_free, num_filled = (int(numbers.get(f"{name}_{direction}", 0)) for name in ("num_free", "num_free_blocked"))
    return SightLines(num_lines, num_observed, unknown, unknown, num_free, num_filled)


def _surface(numbers: Mapping[str, Any], direction: str) -> SeenSurface:
    if f"num_denied_{direction}" not in numbers:
        return no_surface()
    points, confirmed, hidden, unseen, denied = (
        int(numbers[f"num_{name}_{direction}"]) for name in ("points", "confirmed", "hidden", "unseen", "denied")
    )
    wide = float(numbers[f"wide_denied_{direction}"])
    return SeenSurface(points, confirmed, np.full(denied, -1), wide, hidden, unseen)


def _parsed(line: str, place: str) -> dict[str, Any]:
    try:
        record = json.loads(line)
    except json.JSONDecodeError as error:
        raise InputError(f"{place}: expected one JSON object, found {error.msg} in column {error.colno}") from None
    if not isinstance(record, dict):
        raise InputError(f"{place}: expected one JSON object, found {line!r:.60}")
    return record


def _write(path: str | Path, text: str, mode: str) -> None:
    try:
        with Path(path).open(mode, encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
