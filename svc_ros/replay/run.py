"""One bag through one mode, with everything that is found in one folder: what `svc_ros replay` does with each bag."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterable, Mapping
from contextlib import closing
from typing import Any

from svc_ros.core.errors import InputError, SvcError
from svc_ros.io.bags import Bag
from svc_ros.io.bags.result_writer import UNFINISHED
from svc_ros.io.config_yaml import config_to_yaml
from svc_ros.io.g2o import write_g2o
from svc_ros.io.trajectories import Trajectory, write_tum
from svc_ros.replay.clouds import ReplayedPair, ReplayStep
from svc_ros.replay.job import (
    CONFIG,
    DECISIONS,
    GRAPH,
    REPORT,
    RESULTS,
    SUMMARY,
    TRAJECTORY,
    Progress,
    ReplayJob,
    StopRequest,
)  # fmt: skip
from svc_ros.replay.modes import Replay, open_replay, steps_of
from svc_ros.replay.outputs import DecisionFiles, record_of
from svc_ros.replay.resume import Earlier, find_earlier
from svc_ros.replay.summary import Tally, trajectory_numbers, versions
from svc_ros.report.report import write_report
from svc_ros.report.scenes import SceneKeeper

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
    stop = should_stop or _never
    with Bag(job.bag) as bag:
        topic = bag.resolve_cloud_topic(job.topic)
        job = job.settled(bag, topic)
        config_text = config_to_yaml(job.config, job.base)
        earlier = find_earlier(job, topic, config_text)
        if earlier.finished:
            return dict(earlier.finished)
        run = _Run(job, open_replay(job, bag, topic, earlier.decisions()), earlier)
        run.begin(config_text)
        try:
            run.follow(bag, on_progress or _nothing, stop)
        except SvcError as error:
            run.finish(str(error))
            raise
    return run.finish()


class _Run:
    """One replay under way."""

    def __init__(self, job: ReplayJob, replay: Replay, earlier: Earlier) -> None:
        self._job, self._replay, self._earlier = job, replay, earlier
        self._tally = Tally()
        self._scenes: SceneKeeper | None = None
        self._state, self._begun, self._wall_s = "running", time.monotonic(), earlier.wall_time_s

    def begin(self, config_text: str) -> None:
        """Make the folder, and say in it what is going to be there; files of an older run go."""
        out = self._job.out
        still_needed = (DECISIONS,) if self._earlier.records else ()
        try:
            out.mkdir(parents=True, exist_ok=True)
            for name in {TRAJECTORY, GRAPH, REPORT, DECISIONS, RESULTS}.difference(still_needed):
                (out / name).unlink(missing_ok=True)
            for folder in out.glob(UNFINISHED):  # of a writer that was killed
                shutil.rmtree(folder)
            (out / CONFIG).write_text(config_text, encoding="utf-8")
        except OSError as error:
            raise InputError(f"--out {out}: cannot be written: {error.strerror}") from None
        self._write_summary({})

    def follow(self, bag: Bag, on_progress: Progress, should_stop: StopRequest) -> None:
        """Take step after step."""
        job, replay, known = self._job, self._replay, self._earlier.decisions()
        try:
            with (
                DecisionFiles(job.out, job.odometry_frame or "odom", self._earlier) as files,
                closing(steps_of(job, replay, bag, known)) as steps,
            ):
                self._scenes = files.scenes
                if job.with_input:
                    files.write_transforms(bag, replay.part.span_ns(bag))
                self._state = self._take_all(steps, files, on_progress, should_stop)
                for decision in known[files.num_seen :]:  # interrupted before it came to them; their lines are there
                    self._take_decision(decision, files)
        finally:
            self._wall_s += time.monotonic() - self._begun

    def _take_all(
        self, steps: Iterable[ReplayStep], files: DecisionFiles, on_progress: Progress, should_stop: StopRequest
    ) -> str:
        """Take steps until there are no more, or the request to stop; returns the state that this leaves."""
        for step in steps:
            self._take(step, files)
            num_done = self._tally.num_scans
            on_progress(num_done, max(self._replay.num_expected, num_done))
            self._wait(should_stop)
            if should_stop():
                return "interrupted"
        on_progress(self._tally.num_scans, self._tally.num_scans)
        return "complete"

    def finish(self, error: str = "") -> dict[str, Any]:
        """Write what is known only at the end: trajectory, graph, summary, report. error: why it ended early."""
        track, out = self._replay.track, self._job.out
        if error:
            self._state = "failed"
        trajectory, graph = track.trajectory(), track.graph()
        write_tum(out / TRAJECTORY, trajectory)
        write_g2o(out / GRAPH, graph)
        numbers = {
            "trajectory": {"num_poses": len(trajectory), "num_parts": track.num_parts},
            "graph": {"num_vertices": len(graph.poses), "num_edges": len(graph.edges)},
            **self._compared(trajectory), **({"error": error} if error else {}),
        }  # fmt: skip
        summary = self._write_summary(numbers)
        if self._job.report:
            begun = time.monotonic()
            reference = self._replay.reference
            truth = None if reference is None else reference.of_clouds(self._tally.frame_id)
            write_report(out / REPORT, out, self._scenes.scenes if self._scenes else [], truth)
            summary = self._write_summary({**numbers, "report_time_s": time.monotonic() - begun})
        return summary

    def _take(self, step: ReplayStep, files: DecisionFiles) -> None:
        self._tally.add_step(step)
        self._replay.track.add(step)
        if self._job.with_input:
            files.write_cloud(self._replay.topic, step.cloud)
        for decision in step.decisions:
            self._take_decision(decision, files)

    def _take_decision(self, decision: ReplayedPair, files: DecisionFiles) -> None:
        reference = self._replay.reference
        errors = None if reference is None else reference.errors(decision)
        files.write(decision, record_of(decision, reference is not None, errors))
        self._tally.add_decision(decision, errors)

    def _wait(self, should_stop: StopRequest) -> None:
        """Keep to the largest rate."""
        if self._job.max_rate_hz is None:
            return
        due = self._begun + self._tally.num_scans / self._job.max_rate_hz
        while (left := due - time.monotonic()) > 0.0 and not should_stop():
            time.sleep(min(left, _POLL_S))

    def _compared(self, trajectory: Trajectory) -> dict[str, Any]:
        """Errors against the reference; nothing without one."""
        reference, job = self._replay.reference, self._job
        if reference is None:
            return {}
        numbers = {
            "file": str(job.reference), "frame": job.reference_frame, **self._tally.reference_numbers(),
            **trajectory_numbers(trajectory, reference, self._tally.frame_id),
        }  # fmt: skip
        loops = {"false_loops": self._tally.num_false} if job.mode == "loop_closure" else {}
        return {"reference": numbers, **loops}

    def _write_summary(self, numbers: Mapping[str, Any]) -> dict[str, Any]:
        job, recorded_s = self._job, self._tally.recorded_s
        summary = {
            "bag": str(job.bag), "topic": self._replay.topic, "mode": job.mode, "state": self._state,
            "interrupted": self._state == "interrupted",
            "method": job.config.method, **job.told(),
            **self._tally.numbers(),
            "recorded_s": recorded_s, "wall_time_s": self._wall_s,
            "real_time_factor": recorded_s / self._wall_s if self._wall_s else None,
            **numbers, "versions": versions(), "run": {**job.identity(), "topic": self._replay.topic},
        }  # fmt: skip
        text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
        (job.out / SUMMARY).write_text(text, encoding="utf-8")
        return summary


def _nothing(_done: int, _total: int) -> None:
    """No progress is wanted."""


def _never() -> bool:
    return False
