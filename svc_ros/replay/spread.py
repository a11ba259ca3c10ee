"""Several bags replayed over Dask, a bag each worker at a time."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from svc_ros.core.errors import InputError
from svc_ros.evaluation.distributed import LOCAL, run_over
from svc_ros.replay.job import ReplayJob
from svc_ros.replay.run import replay_bag

Summary = dict[str, Any]


@dataclass
class ReplayedBags:
    """Summaries of the bags that were replayed and the reasons why others could not be, by their output folders."""

    summaries: dict[Path, Summary] = field(default_factory=dict)
    errors: dict[Path, str] = field(default_factory=dict)
    interrupted: bool = False


def replay_over(
    scheduler: str, jobs: Sequence[ReplayJob], on_progress: Callable[[int, int], None] | None = None
) -> ReplayedBags:
    """Replay every job on a worker of the scheduler (see `distributed`), which has bags and output folders at the same
    paths; each leaves its outputs as `replay_bag` does.

    A bag whose worker is lost is replayed from its beginning by another one. A bag that cannot be read does not keep
    the others. Ctrl-C leaves the outputs of the bags that were done. `on_progress(done, total)` counts bags.
    """
    done = ReplayedBags()

    def keep(index: int, answer: Summary | str) -> None:
        if isinstance(answer, str):
            done.errors[jobs[index].out] = answer
        else:
            done.summaries[jobs[index].out] = answer
        if on_progress is not None:
            on_progress(len(done.errors) + len(done.summaries), len(jobs))

    given = list(jobs) if scheduler == LOCAL else [_anywhere(job) for job in jobs]
    for job in given:
        _make_folder(job.out)
    wanted = (path for job in given for path in (job.bag, job.out, job.reference) if path is not None)
    paths = {path for path in wanted if path.exists()}  # what is not here either is told by the bag that misses it
    try:
        run_over(scheduler, _replay, given, keep, sorted(paths))
    except KeyboardInterrupt:
        done.interrupted = True
    return done


def _replay(job: ReplayJob) -> Summary | str:
    """The summary of a bag, or why it could not be replayed."""
    try:
        return replay_bag(job)
    except InputError as error:
        return str(error)


def _anywhere(job: ReplayJob) -> ReplayJob:
    """The job with paths that do not depend on the folder in which a worker was started."""
    reference = None if job.reference is None else job.reference.resolve()
    return dataclasses.replace(job, bag=job.bag.resolve(), out=job.out.resolve(), reference=reference)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be created: {error.strerror}") from None
