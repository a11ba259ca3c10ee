"""A data set with reference poses through the registration: what was accepted, what was right, how long it took."""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

from numpy.typing import ArrayLike

from svc_ros.core import registration
from svc_ros.core.config import Config, with_values
from svc_ros.core.errors import InputError, SvcError, TooFewPointsError
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Features, PreparedScan
from svc_ros.evaluation.metrics import LabelledDecision, PairOutcome, judge_pose
from svc_ros.evaluation.summary import (
    JobReport,
    Row,
    summarise_candidates,
    summarise_negatives,
    summarise_pairs,
    summarise_times,
)
from svc_ros.io.datasets import CandidatePair, Dataset, Pair
from svc_ros.pipeline.decide import refused, register_pair

ProgressCallback = Callable[[int, int], None]
T = TypeVar("T")

_CACHED_SCANS = 32  # a scan with features takes about 5 MB
_CHUNK = 4  # neighbours in the list share scans, so a worker gets a few in a row

_PAIR, _NEGATIVE, _CANDIDATES = "pair", "negative", "candidates"


@dataclass(frozen=True)
class _Job:
    """One unit of work; small, because it travels to another process."""

    kind: str
    index: int


class _Evaluator:
    """Does jobs of one data set; lives once in the serial run and once in every worker process."""

    def __init__(self, dataset: Dataset, config: Config) -> None:
        self.dataset, self.config = dataset, config
        self._prepared: Callable[[str], PreparedScan] = lru_cache(_CACHED_SCANS)(self._prepare)
        self._features: Callable[[str], Features] = lru_cache(_CACHED_SCANS)(self._describe)
        self._scan_times: list[Mapping[str, float]] = []

    def run(self, job: _Job) -> JobReport:
        """Do one job; what a scan cost to prepare is reported by the job that needed it first."""
        if job.kind == _PAIR:
            report = self._run_pair(self.dataset.pairs[job.index])
        elif job.kind == _NEGATIVE:
            report = self._run_negative(self.dataset.negatives[job.index])
        else:
            report = self._run_candidates(self.dataset.candidates[job.index])
        report.scan_times, self._scan_times = self._scan_times, []
        return report

    def _run_pair(self, pair: Pair) -> JobReport:
        if pair.T_target_source is None:
            raise InputError(f"{_name(self.dataset, pair)}: expected a reference T_target_source, found none")
        result = self._register(pair)
        outcome = judge_pose(result.best_candidate, pair.T_target_source, self.dataset.success, result.accepted)
        row = _pair_row(pair, result) | {
            "rotation_error_deg": outcome.rotation_error_deg,
            "translation_error_m": outcome.translation_error_m,
        }
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

    def _register(self, pair: Pair) -> RegistrationResult:
        try:
            source, target = self._both(pair, self._features)
        except TooFewPointsError as error:
            return refused(error, self.config)
        return register_pair(source, target, self.config)

    def _verify(self, pair: CandidatePair, T_target_source: ArrayLike) -> RegistrationResult:
        try:
            source, target = self._both(pair, self._prepared)
        except TooFewPointsError as error:
            return refused(error, self.config)
        return registration.verify(source, target, T_target_source, self.config)

    def _both(self, pair: Pair | CandidatePair, get: Callable[[str], T]) -> tuple[T, T]:
        try:
            return get(pair.source), get(pair.target)
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


def evaluate_dataset(
    dataset: Dataset,
    config: Config,
    limit: int | None = None,
    workers: int = 1,
    on_progress: ProgressCallback | None = None,
) -> Row:
    """Register every pair of a data set, and judge its labelled candidates where it has them.

    The data set's range limits replace the config's. `limit` keeps the first pairs of each kind. Each scan's features
    are computed once and reused: `register_p50` is the time of a pair whose features exist, and the stages `prepare`
    and `features` are times of one scan. With several `workers` the pairs are spread over processes; the report is
    the same, times aside. `on_progress(done, total)` counts jobs. `preset` in the report is the data set's own.

    Raises InputError naming the pair whose files cannot be read; a scan with too few points is a rejected pair.
    """
    if workers < 1 or (limit is not None and limit < 1):
        raise InputError(f"evaluation: expected workers and limit of at least 1, found {workers} and {limit}")
    config = with_values(
        config, {"preprocess.min_range_m": dataset.min_range_m, "preprocess.max_range_m": dataset.max_range_m}
    )
    jobs = _list_jobs(dataset, limit)
    reports = []
    for report in _run_jobs(dataset, config, jobs, workers):
        reports.append(report)
        if on_progress is not None:
            on_progress(len(reports), len(jobs))
    by_kind = {
        kind: [r for job, r in zip(jobs, reports, strict=True) if job.kind == kind]
        for kind in (_PAIR, _NEGATIVE, _CANDIDATES)
    }
    return {
        "dataset": dataset.name,
        "method": config.method,
        "preset": dataset.preset,
        "registration": summarise_pairs(by_kind[_PAIR]),
        "decision": summarise_candidates(by_kind[_CANDIDATES]),
        "negatives": summarise_negatives(by_kind[_NEGATIVE]),
        "time_ms": summarise_times(reports),
    }


def _list_jobs(dataset: Dataset, limit: int | None) -> list[_Job]:
    kinds: dict[str, Sequence[Any]] = {
        _PAIR: dataset.pairs, _NEGATIVE: dataset.negatives, _CANDIDATES: dataset.candidates or ()
    }  # fmt: skip
    return [_Job(kind, i) for kind, items in kinds.items() for i in range(len(items[:limit]))]


def _run_jobs(dataset: Dataset, config: Config, jobs: Sequence[_Job], workers: int) -> Iterator[JobReport]:
    if workers == 1 or len(jobs) < 2:
        evaluator = _Evaluator(dataset, config)
        yield from map(evaluator.run, jobs)
        return
    # spawned, not forked: a fork would copy the locks of numba's and Open3D's threads in whatever state they are
    context = multiprocessing.get_context("spawn")
    others = multiprocessing.active_children()
    pool = ProcessPoolExecutor(min(workers, len(jobs)), context, _start_worker, (dataset, config))
    try:
        yield from pool.map(_run_in_worker, jobs, chunksize=min(_CHUNK, -(-len(jobs) // workers)))
    except BrokenProcessPool:
        raise SvcError("evaluation: a worker process died, perhaps for lack of memory: use fewer workers") from None
    except BaseException:
        # an error or Ctrl-C: what the workers still do is of no use to anyone, so nobody waits for it
        for child in multiprocessing.active_children():
            if child not in others:
                child.terminate()
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


_worker: _Evaluator | None = None


def _start_worker(dataset: Dataset, config: Config) -> None:
    global _worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to answer, once
    _worker = _Evaluator(dataset, config)


def _run_in_worker(job: _Job) -> JobReport:
    assert _worker is not None  # the pool's initializer made it
    return _worker.run(job)


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


def _name(dataset: Dataset, pair: Pair | CandidatePair) -> str:
    return f"{dataset.name}: pair {pair.source} -> {pair.target}"
