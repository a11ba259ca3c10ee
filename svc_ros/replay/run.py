"""One bag through one mode, with everything that is found in one folder: what `svc_ros replay` does with each bag.

Read `replay_bag`: open, decide, write, summarise.
"""

from __future__ import annotations

import time
from contextlib import ExitStack, closing
from typing import Any

from svc_ros.core.errors import SvcError
from svc_ros.io.bags import Bag
from svc_ros.io.config_yaml import config_to_yaml
from svc_ros.replay.clouds import ReplayedPair, ReplayStep
from svc_ros.replay.folder import RunFolder
from svc_ros.replay.job import Progress, ReplayJob, StopRequest
from svc_ros.replay.modes import Replay, open_replay, steps_of
from svc_ros.replay.outputs import DecisionFiles, record_of
from svc_ros.replay.resume import find_earlier

__all__ = ["ReplayJob", "replay_bag"]

_POLL_S = 0.1  # how soon a request to stop is noticed while the replay waits for its rate


def replay_bag(
    job: ReplayJob, on_progress: Progress | None = None, should_stop: StopRequest | None = None
) -> dict[str, Any]:
    """Replay one bag and write all outputs into `job.out`; returns what summary.json holds.

    on_progress: called after every cloud; should_stop: asked after every cloud, True ends the replay there with
    complete outputs whose summary has the state `interrupted`. Raises InputError, ConfigError and
    MissingDependencyError; of a bag that breaks off there are complete outputs, too, and the state is `failed`.
    """
    with Bag(job.bag, job.strict) as bag, ExitStack() as opened:
        topic = bag.resolve_cloud_topic(job.topic)
        job = job.settled(bag, topic)
        config_text = config_to_yaml(job.config, job.base)
        earlier = find_earlier(job, topic, config_text)
        if earlier.finished:
            return dict(earlier.finished)
        known = earlier.decisions()
        replay = opened.enter_context(open_replay(job, bag, topic, known))
        folder, pace = RunFolder(job, replay, earlier), _Pace(job.max_rate_hz, should_stop or _never)
        folder.begin(config_text)
        try:
            with folder.decisions() as files, closing(steps_of(job, replay, bag, known)) as steps:
                if job.with_input:
                    files.write_transforms(bag, replay.part.span_ns(bag))
                for step in steps:
                    _write_step(step, job, replay, folder, files)
                    _tell(on_progress, folder.tally.num_scans, replay.num_expected)
                    if pace.is_over_after(folder.tally.num_scans):
                        folder.state = "interrupted"
                        break
                else:
                    _tell(on_progress, folder.tally.num_scans, folder.tally.num_scans)
                    folder.state = "complete"
                for decision in known[files.num_seen :]:  # interrupted before it came to them; their lines are there
                    _write_decision(decision, replay, folder, files)
        except SvcError as error:
            folder.finish(bag.damage, str(error))
            raise
    return folder.finish(bag.damage)


def _write_step(step: ReplayStep, job: ReplayJob, replay: Replay, folder: RunFolder, files: DecisionFiles) -> None:
    """A cloud, and every decision that it led to."""
    folder.tally.add_step(step)
    replay.track.add(step)
    if job.with_input:
        files.write_cloud(replay.topic, step.cloud)
    for decision in step.decisions:
        _write_decision(decision, replay, folder, files)


def _write_decision(decision: ReplayedPair, replay: Replay, folder: RunFolder, files: DecisionFiles) -> None:
    errors = None if replay.reference is None else replay.reference.errors(decision)
    files.write(decision, record_of(decision, replay.reference is not None, errors))
    folder.tally.add_decision(decision, errors)


class _Pace:
    """Keeps to the largest rate, and asks whether to go on."""

    def __init__(self, max_rate_hz: float | None, should_stop: StopRequest) -> None:
        self._max_rate_hz, self._should_stop, self._begun = max_rate_hz, should_stop, time.monotonic()

    def is_over_after(self, num_scans: int) -> bool:
        """Wait until the next cloud is due; True as soon as the replay is to stop."""
        if self._max_rate_hz is not None:
            due = self._begun + num_scans / self._max_rate_hz
            while (left := due - time.monotonic()) > 0.0 and not self._should_stop():
                time.sleep(min(left, _POLL_S))
        return self._should_stop()


def _tell(on_progress: Progress | None, num_done: int, num_expected: int) -> None:
    if on_progress is not None:
        on_progress(num_done, max(num_expected, num_done))


def _never() -> bool:
    return False
