"""The folder of one replay: what stands in it from the first moment on, and what is known only at the end."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from svc_ros.core.errors import InputError
from svc_ros.io.bags import Damage
from svc_ros.io.bags.result_writer import UNFINISHED
from svc_ros.io.g2o import write_g2o
from svc_ros.io.trajectories import Trajectory, write_tum
from svc_ros.replay.job import CONFIG, DECISIONS, GRAPH, OPTIMIZED, REPORT, RESULTS, SUMMARY, TRAJECTORY, ReplayJob
from svc_ros.replay.modes import Replay
from svc_ros.replay.optimised import OptimisedWay, optimise_way
from svc_ros.replay.outputs import DecisionFiles
from svc_ros.replay.resume import Earlier
from svc_ros.replay.summary import Tally, trajectory_numbers, versions
from svc_ros.replay.track import LoopTrack
from svc_ros.report.report import write_report
from svc_ros.report.scenes import SceneKeeper


class RunFolder:
    """Outputs of one replay under way. state: of the run, as summary.json tells it; tally: what was decided so far."""

    def __init__(self, job: ReplayJob, replay: Replay, earlier: Earlier) -> None:
        self.state, self.tally = "running", Tally()
        self._job, self._replay, self._earlier = job, replay, earlier
        self._scenes: SceneKeeper | None = None
        self._wall_s = earlier.wall_time_s

    def begin(self, config_text: str) -> None:
        """Make the folder, and say in it what is going to be there; files of an older run go."""
        out = self._job.out
        still_needed = (DECISIONS,) if self._earlier.records else ()
        try:
            out.mkdir(parents=True, exist_ok=True)
            for name in {TRAJECTORY, OPTIMIZED, GRAPH, REPORT, DECISIONS, RESULTS}.difference(still_needed):
                (out / name).unlink(missing_ok=True)
            for folder in out.glob(UNFINISHED):  # of a writer that was killed
                shutil.rmtree(folder)
            (out / CONFIG).write_text(config_text, encoding="utf-8")
        except OSError as error:
            raise InputError(f"--out {out}: cannot be written: {error.strerror}") from None
        self._write_summary({})

    @contextmanager
    def decisions(self) -> Iterator[DecisionFiles]:
        """The files that fill while the replay runs; the time that they are open is the time that it took."""
        begun = time.monotonic()
        try:
            with DecisionFiles(self._job.out, self._job.fixed_frame, self._earlier) as files:
                self._scenes = files.scenes
                yield files
        finally:
            self._wall_s += time.monotonic() - begun

    def finish(self, damage: Sequence[Damage] = (), error: str = "") -> dict[str, Any]:
        """Write trajectory, graph, summary and report; returns the summary.

        damage: of the bag; error: why the replay ended early.
        """
        track, out = self._replay.track, self._job.out
        if error:
            self.state = "failed"
        trajectory, graph = track.trajectory(), track.graph()
        write_tum(out / TRAJECTORY, trajectory)
        write_g2o(out / GRAPH, graph)
        optimised = None
        if isinstance(track, LoopTrack):
            optimised = optimise_way(trajectory, track.keyframes, graph)
            optimised.write(out / OPTIMIZED)
        numbers = {
            "trajectory": {"num_poses": len(trajectory), "num_parts": track.num_parts},
            "graph": {"num_vertices": len(graph.poses), "num_edges": len(graph.edges)},
            **({} if optimised is None else {"optimized": optimised.numbers()}),
            "damage": [one.told() for one in damage],
            **self._compared(trajectory, optimised), **({"error": error} if error else {}),
        }  # fmt: skip
        summary = self._write_summary(numbers)
        if self._job.report:
            begun = time.monotonic()
            reference = self._replay.reference
            truth = None if reference is None else reference.of_clouds(self.tally.frame_id)
            write_report(out / REPORT, out, self._scenes.scenes if self._scenes else [], truth)
            summary = self._write_summary({**numbers, "report_time_s": time.monotonic() - begun})
        return summary

    def _compared(self, trajectory: Trajectory, optimised: OptimisedWay | None) -> dict[str, Any]:
        """Errors against the reference; nothing without one."""
        reference, job = self._replay.reference, self._job
        if reference is None:
            return {}
        numbers = {
            "file": str(job.reference), "frame": job.reference_frame, **self.tally.reference_numbers(),
            **trajectory_numbers(trajectory, reference, self.tally.frame_id),
            **({} if optimised is None else optimised.compared(reference, self.tally.frame_id)),
        }  # fmt: skip
        loops = {"false_loops": self.tally.num_false} if job.mode == "loop_closure" else {}
        return {"reference": numbers, **loops}

    def _write_summary(self, numbers: Mapping[str, Any]) -> dict[str, Any]:
        job, recorded_s = self._job, self.tally.recorded_s
        summary = {
            "bag": str(job.bag), "topic": self._replay.topic, "mode": job.mode, "state": self.state,
            "interrupted": self.state == "interrupted",
            "method": job.config.method, **job.told(),
            **self.tally.numbers(),
            "recorded_s": recorded_s, "wall_time_s": self._wall_s,
            "real_time_factor": recorded_s / self._wall_s if self._wall_s else None,
            **numbers, "versions": versions(), "run": {**job.identity(), "topic": self._replay.topic},
        }  # fmt: skip
        text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
        (job.out / SUMMARY).write_text(text, encoding="utf-8")
        return summary
