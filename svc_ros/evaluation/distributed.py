"""Work spread over processes of this machine or over machines, by Dask: the answers are those of a serial run."""

from __future__ import annotations

import asyncio
import logging
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import svc_ros
from svc_ros.core.errors import InputError, MissingDependencyError, SvcError
from svc_ros.core.parallel import limit_threads, num_processors

LOCAL = "local"

_CONNECT_S, _WORKERS_S = 15.0, 30.0  # until a scheduler answers, until it has a worker
_ALONE_S = 60.0  # without any worker, or without the scheduler, before the run is given up
_POLL_S = 0.02

Item = TypeVar("Item")
Answer = TypeVar("Answer")


def run_over(
    scheduler: str,
    function: Callable[[Item], Answer],
    items: Sequence[Item],
    on_done: Callable[[int, Answer], None] | None = None,
    paths: Sequence[Path] = (),
) -> list[Answer]:
    """The answers of `function` to all items, in order.

    scheduler: `local` (a worker process for each processor of this machine) or the address of a Dask scheduler, whose
    workers need this package in this version, one thread each, and the `paths`. Function and items are pickled; each
    worker does one item at a time, its kernels on one thread. `on_done(index, answer)` is called as items end.

    What a lost worker had to do is done by another one; an item that takes four workers down raises SvcError. An
    exception of an item is raised as a serial run would: that of the first one in order. Raises InputError for workers
    that cannot do the work, SvcError where the scheduler or its workers do not answer, MissingDependencyError.
    """
    if not items:
        return []
    with _connected(scheduler, len(items)) as client:
        _check_workers(client, scheduler, paths)
        return _Run(client, scheduler, on_done).answers(function, items)


class _Run:
    """One list of items on its way."""

    def __init__(self, client: Any, scheduler: str, on_done: Callable[[int, Any], None] | None) -> None:
        self.client, self.scheduler, self.on_done = client, scheduler, on_done
        self.failed: dict[int, BaseException] = {}
        self.last_alive = time.monotonic()

    def answers(self, function: Callable[[Item], Answer], items: Sequence[Item]) -> list[Answer]:
        futures = self.client.map(partial(_work, function), items, pure=False)
        pending = dict(zip(futures, range(len(items)), strict=True))
        found: dict[int, Answer] = {}
        try:
            while any(self._is_wanted(k) for k in pending.values()):
                ended = [future for future in pending if future.done()]
                for future in ended:
                    self._take(future, pending.pop(future), found)
                if not ended:
                    self._check_alive()
                    time.sleep(_POLL_S)
        finally:
            self.client.cancel(list(pending))
        if self.failed:
            raise self.failed[min(self.failed)]
        return [found[k] for k in range(len(items))]

    def _is_wanted(self, index: int) -> bool:
        """A serial run would not have come to what stands after a failure."""
        return not self.failed or index < min(self.failed)

    def _take(self, future: Any, index: int, found: dict[int, Any]) -> None:
        try:
            found[index] = future.result()
        except _import_distributed().KilledWorker as error:
            lost = f"{self.scheduler}: item {index + 1} was given up: every worker that had it was lost"
            self.failed[index] = SvcError(f"{lost}, perhaps for lack of memory ({error.allowed_failures + 1} workers)")
        except Exception as error:
            self.failed[index] = error
        else:
            if self.on_done is not None:
                self.on_done(index, found[index])

    def _check_alive(self) -> None:
        now = time.monotonic()
        if self.client.status == "running" and self.client.scheduler_info()["workers"]:
            self.last_alive = now
        elif now - self.last_alive > _ALONE_S:
            raise SvcError(f"{self.scheduler}: expected a scheduler with workers, found none for {_ALONE_S:.0f} s")


def _work(function: Callable[[Item], Answer], item: Item) -> Answer:
    """On the worker: the machine's other processors belong to its other workers."""
    limit_threads(1)
    return function(item)


@contextmanager
def _connected(scheduler: str, num_items: int) -> Iterator[Any]:
    dask = _import_distributed()
    if scheduler == LOCAL:
        num_workers = min(num_processors(), num_items)
        options = {"threads_per_worker": 1, "processes": True, "preload": [__name__]}
        quiet = {"dashboard_address": ":0", "silence_logs": logging.ERROR}
        with dask.LocalCluster(n_workers=num_workers, **options, **quiet) as cluster, dask.Client(cluster) as client:
            yield client
        return
    if "://" not in scheduler:
        raise InputError(f"scheduler: expected '{LOCAL}' or an address such as tcp://host:8786, found '{scheduler}'")
    try:
        client = dask.Client(scheduler, timeout=_CONNECT_S)
    except (OSError, ValueError, asyncio.TimeoutError) as error:
        raise SvcError(f"{scheduler}: expected a Dask scheduler, found none that answers: {error}") from None
    with client:
        yield client


def dask_setup(_: Any) -> None:
    """What Dask calls in a local worker that begins: Ctrl-C is the parent's to answer, once."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _import_distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise MissingDependencyError("--scheduler needs Dask: pip install distributed (extra: cluster)") from None
    return distributed


def _check_workers(client: Any, scheduler: str, paths: Sequence[Path]) -> None:
    try:
        client.wait_for_workers(1, timeout=_WORKERS_S)
    except (TimeoutError, asyncio.TimeoutError):
        found = f"found none for {_WORKERS_S:.0f} s (start one: dask worker {scheduler} --nthreads 1)"
        raise SvcError(f"{scheduler}: expected a worker, {found}") from None
    for worker, num_threads in client.nthreads().items():
        if num_threads != 1:
            raise InputError(f"worker {worker}: expected one thread (dask worker --nthreads 1), found {num_threads}")
    wanted = [str(path) for path in paths]
    for worker, told in client.run(_look_around, wanted, on_error="return").items():
        if isinstance(told, BaseException):
            raise InputError(f"worker {worker}: expected svc_ros {svc_ros.__version__}, which does not load: {told}")
        version, missing = told
        if version != svc_ros.__version__:
            raise InputError(f"worker {worker}: expected svc_ros {svc_ros.__version__}, found {version}")
        if missing:
            raise InputError(f"worker {worker}: expected the data at {missing[0]}, found nothing at that path there")


def _look_around(paths: Sequence[str]) -> tuple[str, list[str]]:
    """On a worker: its version of this package, and those of the paths that it does not have."""
    return svc_ros.__version__, [path for path in paths if not Path(path).exists()]
