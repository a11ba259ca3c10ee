"""Data sets with reference poses through the registration: what was accepted, what was right, how long it took."""

from __future__ import annotations

import multiprocessing
import signal
import uuid
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any, Protocol, TypeVar, cast

from svc_ros.core.config import Config, with_values
from svc_ros.core.errors import InputError, SvcError
from svc_ros.core.parallel import limit_threads, num_processors
from svc_ros.evaluation.evaluator import (
    CANDIDATES,
    KINDS,
    NEGATIVE,
    PAIR,
    Chunk,
    Job,
    forget_scans,
    run_chunk,
    without_pairs,
)
from svc_ros.evaluation.suite_recall import summarise_recall
from svc_ros.evaluation.summary import (
    JobReport,
    Row,
    summarise_candidates,
    summarise_negatives,
    summarise_pairs,
    summarise_times,
)
from svc_ros.io.datasets import Dataset
from svc_ros.io.suites import Suite, SuitePair

ProgressCallback = Callable[[int, int], None]
Item = TypeVar("Item")
Answer = TypeVar("Answer")

_CHUNK = 4  # neighbours in the list share scans, so a worker gets a few in a row


class Crew(Protocol):
    """Whoever does the work: gives the answers to all items in order, and tells index and answer of each when it ends.

    An exception of an item is raised, of several that of the first in order.
    """

    def __call__(
        self, function: Callable[[Item], Answer], items: Sequence[Item], on_done: Callable[[int, Answer], None], /
    ) -> list[Answer]: ...


def evaluate_dataset(
    dataset: Dataset,
    config: Config,
    limit: int | None = None,
    workers: int | Crew = 1,
    on_progress: ProgressCallback | None = None,
) -> Row:
    """Register every pair of a data set, and judge its labelled candidates where it has them.

    The data set's range limits replace the config's. `limit` keeps the first pairs of each kind. Each scan's features
    are computed once and reused: `register_p50` is the time of a pair whose features exist, and the stages `prepare`
    and `features` are times of one scan. With several `workers` the pairs are spread over processes, or over a crew
    (see `distributed`); the report is the same, times aside. `on_progress(done, total)` counts jobs. `preset` in the
    report is the data set's own. A benchmark's report has `recall` by each of its definitions too.

    Raises InputError naming the pair whose files cannot be read; a scan with too few points is a rejected pair.
    """
    return evaluate_datasets([(dataset, config)], limit, workers, on_progress)[0]


def evaluate_datasets(
    sets: Sequence[tuple[Dataset, Config]],
    limit: int | None = None,
    workers: int | Crew = 1,
    on_progress: ProgressCallback | None = None,
) -> list[Row]:
    """`evaluate_dataset` of several data sets, each with its config: all are spread together; a report each."""
    few = isinstance(workers, int) and workers < 1
    if few or (limit is not None and limit < 1):
        raise InputError(f"evaluation: expected workers and limit of at least 1, found {workers} and {limit}")
    within_range = [(dataset, _within_range(dataset, config)) for dataset, config in sets]
    jobs = [_list_jobs(dataset, limit) for dataset, _ in within_range]
    reports = iter(_run_jobs(within_range, jobs, workers, on_progress))
    return [
        _summarise(dataset, config, of_set, [next(reports) for _ in of_set])
        for (dataset, config), of_set in zip(within_range, jobs, strict=True)
    ]


def _within_range(dataset: Dataset, config: Config) -> Config:
    limits = {"preprocess.min_range_m": dataset.min_range_m, "preprocess.max_range_m": dataset.max_range_m}
    return with_values(config, limits)


def _list_jobs(dataset: Dataset, limit: int | None) -> list[Job]:
    kinds: dict[str, Sequence[Any]] = {
        PAIR: dataset.pairs, NEGATIVE: dataset.negatives, CANDIDATES: dataset.candidates or ()
    }  # fmt: skip
    return [Job(kind, item) for kind, items in kinds.items() for item in items[:limit]]


def _summarise(dataset: Dataset, config: Config, jobs: Sequence[Job], reports: Sequence[JobReport]) -> Row:
    done = list(zip(jobs, reports, strict=True))
    by_kind = {kind: [report for job, report in done if job.kind == kind] for kind in KINDS}
    summary: Row = {
        "dataset": dataset.name,
        "method": config.method,
        "preset": dataset.preset,
        "registration": summarise_pairs(by_kind[PAIR]),
        "decision": summarise_candidates(by_kind[CANDIDATES]),
        "negatives": summarise_negatives(by_kind[NEGATIVE]),
        "time_ms": summarise_times(reports),
    }
    if isinstance(dataset, Suite):
        pairs = [cast(SuitePair, job.item) for job in jobs if job.kind == PAIR]
        summary["recall"] = summarise_recall(dataset, pairs, summary["registration"]["pairs"])
    return summary


def _run_jobs(
    sets: Sequence[tuple[Dataset, Config]],
    jobs: Sequence[Sequence[Job]],
    workers: int | Crew,
    on_progress: ProgressCallback | None,
) -> list[JobReport]:
    total = sum(map(len, jobs))
    alone = isinstance(workers, int) and min(workers, total) <= 1
    size = 1 if alone else min(_CHUNK, -(-total // workers)) if isinstance(workers, int) else _CHUNK
    chunks = [chunk for of_set, given in zip(jobs, sets, strict=True) for chunk in _chunks(given, of_set, size)]
    done = 0

    def count(index: int, _: object) -> None:
        nonlocal done
        for _ in chunks[index].jobs:
            done += 1
            if on_progress is not None:
                on_progress(done, total)

    crew = crew_of(workers, total) if isinstance(workers, int) else workers
    return [report for of_chunk in crew(run_chunk, chunks, count) for report in of_chunk]


def crew_of(workers: int, num_items: int) -> Crew:
    """This process alone, or so many others, though no more than there are items."""
    alone = min(workers, num_items) <= 1
    return cast(Crew, _one_by_one if alone else partial(_over_processes, min(workers, num_items)))


def _chunks(given: tuple[Dataset, Config], jobs: Sequence[Job], size: int) -> list[Chunk]:
    run, dataset = uuid.uuid4().hex, without_pairs(given[0])
    return [Chunk(run, dataset, given[1], tuple(jobs[k : k + size])) for k in range(0, len(jobs), size)]


def _one_by_one(
    function: Callable[[Item], Answer], items: Sequence[Item], on_done: Callable[[int, Answer], None]
) -> list[Answer]:
    answers = []
    try:
        for index, item in enumerate(items):
            answers.append(function(item))
            on_done(index, answers[-1])
    finally:
        forget_scans()
    return answers


def _over_processes(
    workers: int, function: Callable[[Item], Answer], items: Sequence[Item], on_done: Callable[[int, Answer], None]
) -> list[Answer]:
    # spawned, not forked: a fork would copy the locks of numba's and Open3D's threads in whatever state they are
    context = multiprocessing.get_context("spawn")
    others = multiprocessing.active_children()
    pool = ProcessPoolExecutor(workers, context, _start_worker, (max(1, num_processors() // workers),))
    answers = []
    try:
        for index, answer in enumerate(pool.map(function, items)):
            answers.append(answer)
            on_done(index, answers[-1])
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
    return answers


def _start_worker(num_threads: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to answer, once
    limit_threads(num_threads)
