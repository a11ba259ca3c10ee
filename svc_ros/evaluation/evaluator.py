"""Single jobs of an evaluation: a pair to register, a pair without alignment, labelled poses to judge."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from svc_ros.core import registration
from svc_ros.core.config import Config
from svc_ros.core.errors import InputError, SvcError, TooFewPointsError
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array, Features, PreparedScan
from svc_ros.evaluation.metrics import LabelledDecision, PairOutcome, judge_pose
from svc_ros.evaluation.suite_recall import information_rmse
from svc_ros.evaluation.suite_reference import refined_reference
from svc_ros.evaluation.summary import JobReport, Row
from svc_ros.io.correspondence_files import read_correspondences
from svc_ros.io.datasets import CandidatePair, Dataset, Pair
from svc_ros.io.suites import Suite, SuitePair
from svc_ros.pipeline.decide import refused, register_pair

T = TypeVar("T")

PAIR, NEGATIVE, CANDIDATES = "pair", "negative", "candidates"
KINDS = (PAIR, NEGATIVE, CANDIDATES)

_CACHED_SCANS = 32  # a scan with features takes about 5 MB


@dataclass(frozen=True, eq=False)
class Job:
    """One unit of work; small, because it travels to other processes and machines."""

    kind: str
    item: Pair | CandidatePair


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some jobs of one data set, in order. dataset: without its lists of pairs; run: a name that no other run and no
    other data set of this run has."""

    run: str
    dataset: Dataset
    config: Config
    jobs: tuple[Job, ...]


_resident: dict[str, Evaluator] = {}


def run_chunk(chunk: Chunk) -> list[JobReport]:
    """Do all jobs of a chunk. The scans that it prepared stay for the next chunk of the same run, in this process."""
    if chunk.run not in _resident:
        _resident.clear()  # of one data set at a time
        _resident[chunk.run] = Evaluator(chunk.dataset, chunk.config)
    evaluator = _resident[chunk.run]
    return [evaluator.run(job) for job in chunk.jobs]


def forget_scans() -> None:
    """Give back the memory of what `run_chunk` keeps in this process."""
    _resident.clear()


def without_pairs(dataset: Dataset) -> Dataset:
    """The data set as it travels: its jobs carry their pairs themselves."""
    return dataclasses.replace(dataset, pairs=[], negatives=[], candidates=[])


class Evaluator:
    """Does jobs of one data set; lives once in the serial run and once in every worker process."""

    def __init__(self, dataset: Dataset, config: Config) -> None:
        self.dataset, self.config = dataset, config
        self._prepared: Callable[[str], PreparedScan] = lru_cache(_CACHED_SCANS)(self._prepare)
        self._features: Callable[[str], Features] = lru_cache(_CACHED_SCANS)(self._describe)
        self._scan_times: list[Mapping[str, float]] = []

    def run(self, job: Job) -> JobReport:
        """Do one job; what a scan cost to prepare is reported by the job that needed it first."""
        if isinstance(job.item, CandidatePair):
            report = self._run_candidates(job.item)
        elif job.kind == PAIR:
            report = self._run_pair(job.item)
        else:
            report = self._run_negative(job.item)
        report.scan_times, self._scan_times = self._scan_times, []
        return report

    def _run_pair(self, pair: Pair) -> JobReport:
        reference = self._reference(pair)
        result = self._register(pair)
        outcome = judge_pose(result.best_candidate, reference, self.dataset.success, result.accepted)
        row = _pair_row(pair, result) | {
            "rotation_error_deg": outcome.rotation_error_deg,
            "translation_error_m": outcome.translation_error_m,
        }
        if isinstance(pair, SuitePair):
            row |= _suite_values(pair, result, reference)
        return JobReport(row=row, outcome=outcome, register_times=[result.time_ms])

    def _run_negative(self, pair: Pair) -> JobReport:
        result = self._register(pair)
        outcome = PairOutcome(result.accepted, correct=False)
        return JobReport(row=_pair_row(pair, result), outcome=outcome, register_times=[result.time_ms])

    def _run_candidates(self, pair: CandidatePair) -> JobReport:
        report = JobReport()
        for candidate in pair.candidates:
            if candidate.label == "grey":
                continue
            result = self._verify(pair, candidate.T_target_source)
            correct = candidate.label == "correct"
            decision = LabelledDecision(result.accepted, correct, result.probability, candidate.origin)
            report.decisions.append(decision)
            if "total" in result.time_ms:
                report.verify_ms.append(result.time_ms["total"])
        return report

    def _reference(self, pair: Pair) -> Array:
        if pair.T_target_source is None:
            raise InputError(f"{_name(self.dataset, pair)}: expected a reference T_target_source, found none")
        if not isinstance(self.dataset, Suite) or self.dataset.refined is None:
            return pair.T_target_source
        suite = self.dataset
        return self._named(pair, lambda: refined_reference(suite, pair))

    def _register(self, pair: Pair) -> RegistrationResult:
        folder = self.dataset.correspondences
        try:
            if folder is None:
                source, target = self._both(pair, self._features)
                return register_pair(source, target, self.config)
            given = self._named(pair, lambda: read_correspondences(folder / f"{pair.file_name}.npz"))
            source, target = self._both(pair, lambda path: _undescribed(self._prepared(path)))
        except TooFewPointsError as error:
            return refused(error, self.config)
        return register_pair(source, target, self.config, given)

    def _verify(self, pair: CandidatePair, T_target_source: ArrayLike) -> RegistrationResult:
        try:
            source, target = self._both(pair, self._prepared)
        except TooFewPointsError as error:
            return refused(error, self.config)
        return registration.verify(source, target, T_target_source, self.config)

    def _both(self, pair: Pair | CandidatePair, get: Callable[[str], T]) -> tuple[T, T]:
        return self._named(pair, lambda: (get(pair.source), get(pair.target)))

    def _named(self, pair: Pair | CandidatePair, read: Callable[[], T]) -> T:
        """What `read` returns; its errors are told with the name of the pair."""
        try:
            return read()
        except TooFewPointsError:
            raise
        except (SvcError, OSError) as error:
            raise InputError(f"{_name(self.dataset, pair)}: {error}") from None

    def _prepare(self, path: str) -> PreparedScan:
        scan = self.dataset.read_scan(path)
        return self._timed("prepare", lambda: registration.prepare(scan, self.config))

    def _describe(self, path: str) -> Features:
        prepared = self._prepared(path)
        return self._timed("features", lambda: registration.extract_features(prepared, self.config))

    def _timed(self, stage: str, work: Callable[[], T]) -> T:
        start = time.perf_counter()
        value = work()
        self._scan_times.append({stage: 1e3 * (time.perf_counter() - start)})
        return value


def _undescribed(prepared: PreparedScan) -> Features:
    """A scan whose descriptors nobody asks for, as its correspondences are given."""
    return Features(prepared, np.zeros((len(prepared), 0), np.float32))


def _pair_row(pair: Pair, result: RegistrationResult) -> Row:
    return {
        "source": pair.source,
        "target": pair.target,
        "overlap": pair.overlap,
        "verdict": result.verdict.value,
        "reason": result.reason.value,
        "rotation_error_deg": None,
        "translation_error_m": None,
        "probability": result.probability,
        "time_ms": result.time_ms.get("total"),
    }


def _suite_values(pair: SuitePair, result: RegistrationResult, reference: Array) -> Row:
    """What a benchmark's definitions of recall need, and the pose itself."""
    T, information = result.best_candidate, pair.information
    measured = T is not None and information is not None
    return {
        "group": pair.group,
        "name": pair.file_name,
        "rmse_m": information_rmse(T, reference, information) if measured else None,  # type: ignore[arg-type]
        "best_candidate": None if T is None else T.tolist(),
    }


def _name(dataset: Dataset, pair: Pair | CandidatePair) -> str:
    return f"{dataset.name}: pair {pair.source} -> {pair.target}"
