"""How kernels are compiled, by numba on first use, and a word about it to whoever asked for one.

They are kept: beside their files, else in the user's cache folder; NUMBA_CACHE_DIR names another one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

_EVERY_S = 5.0  # a line; a minute of silence looks like a program that hangs
_SECONDS_EACH = 0.35  # of a processor of 2023
_OPTIONS = {"nogil": True, "cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_NOT_KEPT = "at every start, as no folder can be written to keep them: NUMBA_CACHE_DIR names one"


@dataclass(frozen=True)
class Compiling:
    """Where compilation stands.

    num_done: kernels compiled so far; num_expected: those that were missing at first, of which some may stay unused;
    is_kept: the next start finds them compiled; seconds: that it took so far; is_busy: one is being compiled.
    """

    num_done: int
    num_expected: int
    is_kept: bool
    seconds: float
    is_busy: bool

    @property
    def seconds_left(self) -> float:
        """As the pace so far foretells."""
        pace = self.seconds / self.num_done if self.num_done else _SECONDS_EACH
        return pace * max(self.num_expected - self.num_done, 0)


Watcher = Callable[[Compiling], None]


class _Kernels:
    """The kernels of this process, and which of them it had to compile."""

    def __init__(self) -> None:
        self.all: list[Any] = []
        self.watchers: list[Watcher] = []
        self.is_kept = True
        self._done: set[Any] = set()
        self._num_known = self._num_expected = 0
        self._begin_s, self._seconds, self._depth = 0.0, 0.0, 0

    def add(self, dispatcher: Any) -> None:
        if not self.all:
            self._listen()
        self.all.append(dispatcher)

    def _listen(self) -> None:
        from numba.core import event

        told = self

        class Listener(event.Listener):
            def on_start(self, event: Any) -> None:
                told.note(event.data["dispatcher"], 1)

            def on_end(self, event: Any) -> None:
                told.note(event.data["dispatcher"], -1)

        event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]

    def note(self, dispatcher: Any, step: int) -> None:
        """A kernel is compiled from now on (step 1) or was (-1); numba lets one thread compile at a time."""
        if not self.watchers or dispatcher not in self.all:
            return
        now = time.monotonic()
        if self._depth == 0:
            self._begin_s = now
        self._depth = max(self._depth + step, 0)
        taken = now - self._begin_s
        if self._depth == 0:
            self._seconds, taken = self._seconds + taken, 0.0
        if self._num_known != len(self.all):  # more were imported
            self._num_known = len(self.all)
            self._num_expected = len(self._done) + sum(d not in self._done and _is_missing(d) for d in self.all)
        if step < 0:
            self._done.add(dispatcher)
        seconds, num_expected = self._seconds + taken, max(self._num_expected, len(self._done))
        state = Compiling(len(self._done), num_expected, self.is_kept, seconds, self._depth > 0)
        for watcher in self.watchers:
            watcher(state)


_kernels = _Kernels()


def kernel(**options: Any) -> Callable[[Any], Any]:
    """numba.njit as all kernels want it, cached where any folder can be written."""
    from numba import njit

    def compiled_on_use(function: Any) -> Any:
        try:
            dispatcher = njit(**{**_OPTIONS, **options})(function)
        except RuntimeError:  # numba found no folder for its cache
            dispatcher = njit(**{**_OPTIONS, **options, "cache": False})(function)
            _kernels.is_kept = False
        if _stamp(dispatcher) is not None:
            _cache_file(dispatcher)._source_stamp = (_stamp(dispatcher), _made_of(function, type(dispatcher)))
        _kernels.add(dispatcher)
        return dispatcher

    return compiled_on_use


def _made_of(function: Any, dispatcher_type: type) -> tuple[Any, ...]:
    """What the kernel's file has of others: their kernels, and plain numbers.

    All that is compiled into it, but numba's cache looks at the text of the kernel's own file only.
    """
    used: list[Any] = []
    for name, value in sorted(function.__globals__.items(), key=lambda item: item[0]):
        if isinstance(value, dispatcher_type) and value.__module__ != function.__module__:
            used.append((name, _stamp(value)))
        elif isinstance(value, int | float | tuple | np.generic):
            used.append((name, repr(value)))
    return tuple(used)


def _cache_file(dispatcher: Any) -> Any:
    """None in a numba that builds its cache otherwise; it is left as it is then."""
    return getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)


def _stamp(dispatcher: Any) -> Any:
    return getattr(_cache_file(dispatcher), "_source_stamp", None)


def _is_missing(dispatcher: Any) -> bool:
    """Neither loaded nor in the cache, as far as can be told."""
    load_index = getattr(_cache_file(dispatcher), "_load_index", dict)
    return not dispatcher.signatures and not load_index()


@contextmanager
def watched(watcher: Watcher) -> Iterator[None]:
    """Call the watcher before and after every kernel that is compiled meanwhile, by whatever thread compiles it."""
    _kernels.watchers.append(watcher)
    try:
        yield
    finally:
        _kernels.watchers.remove(watcher)


@contextmanager
def told(say: Callable[[str], None]) -> Iterator[None]:
    """Say in lines, every few seconds at most, what is compiled meanwhile; nothing where nothing is."""
    states: list[Compiling] = []
    said_s = -_EVERY_S

    def watch(state: Compiling) -> None:
        nonlocal said_s
        if not states:
            say(opening(state))
            said_s = state.seconds
        elif state.seconds - said_s >= _EVERY_S:
            said_s = state.seconds
            say(f"compiling the kernels: {state.num_done} of {state.num_expected}, {_span(state.seconds_left)} left")
        states[:] = [state]

    with watched(watch):
        yield
    if states:
        say(closing(states[0]))


def opening(state: Compiling) -> str:
    """The line before the first kernel."""
    how_long = f"compiling {_kernels_of(state.num_expected)} for this machine, {_span(state.seconds_left)}"
    return f"{how_long}, once" if state.is_kept else f"{how_long}, {_NOT_KEPT}"


def closing(state: Compiling) -> str:
    """The line after the last one."""
    return f"compiled {_kernels_of(state.num_done)} in {state.seconds:.0f} s"


def _kernels_of(num: int) -> str:
    return f"{num} kernel{'' if num == 1 else 's'}"


def _span(seconds: float) -> str:
    return f"about {max(round(seconds), 1)} s"
