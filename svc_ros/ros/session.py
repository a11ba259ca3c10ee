"""Everything that exists while the node is configured: inputs, the worker with its engine, outputs."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy._rclpy_pybind11 import RCLError
from rclpy.clock import JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.parameter import Parameter

from svc_ros.core.compiling import told
from svc_ros.core.errors import InputError, MissingDependencyError
from svc_ros.core.result import Reason
from svc_ros.io.places import check_place
from svc_ros.pipeline.decide import refused
from svc_ros.pipeline.scan_matching import ScanMatcher
from svc_ros.ros.diagnostics import Statistics, statuses
from svc_ros.ros.parameters import OF_MAPS, NodeParameters
from svc_ros.ros.streams.decision import Decision, Engine, labels
from svc_ros.ros.streams.first_choice import FirstChoice
from svc_ros.ros.streams.judges import Judges
from svc_ros.ros.streams.localization_engine import LocalizationEngine
from svc_ros.ros.streams.loop_engine import LoopEngine
from svc_ros.ros.streams.matching_engine import MatchingEngine
from svc_ros.ros.streams.registrar import PairRegistrar
from svc_ros.ros.streams.worker import DropJob, Job, PairJob, Worker
from svc_ros.ros.topics.conversions import status_name
from svc_ros.ros.topics.frames import Frames
from svc_ros.ros.topics.inputs import CLOUD_INPUTS, Inputs
from svc_ros.ros.topics.optimised_path import OptimisedPath
from svc_ros.ros.topics.outputs import Outputs
from svc_ros.ros.topics.sources import Sources

# How soon Python asks the thread that computes to let the executor in. With its own 5 ms, a thread that lets go of the
# interpreter for a moment every few milliseconds is never asked, and the executor waits for all of its work: 0.1 s.
_SWITCH_S = 1e-3
_FINISH_S, _MOST_S = 0.4, 1.0  # for decisions that wait for slow readers at the end; with what is left of the time
_JUMP = JumpThreshold(min_forward=None, min_backward=Duration(seconds=-1), on_clock_change=False)


class Session:
    """The node at work. Raises MissingDependencyError where a parameter needs a package that is not there, InputError
    where `graph_file` cannot be written or `map_folder` is no map, ConfigError for QoS overrides that are none.

    is_active: take new work; without it every input is dropped as `inactive`. Lowers the interpreter's switch interval.
    """

    def __init__(self, node: Node, parameters: NodeParameters) -> None:
        self._node, self._parameters = node, parameters
        settings = parameters.settings
        self.is_active, self.is_enabled = False, True
        self.statistics = Statistics(CLOUD_INPUTS[settings.mode], status_name(node))
        self.judges = Judges(self._finish)
        # What may need a package that is not there comes first, and nothing is left behind by what cannot be made.
        self.engine: Engine = self._make_engine()
        with contextlib.ExitStack() as undo:
            self.frames = Frames(node, settings)
            undo.callback(self.frames.destroy)
            self.outputs = Outputs(node, settings, self.frames, lambda: self.is_active)
            undo.callback(self.outputs.destroy)
            undo.callback(self.outputs.finish, 0.0)
            self._optimised = self._make_optimised(undo)
            self._first_choice = FirstChoice(parameters, Sources(self, parameters).origin, node.get_logger().info)
            self.inputs = Inputs(node, parameters, self.statistics, self._take)
            undo.pop_all()
        self.worker = Worker(self._process, self._warm_up)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        node.add_on_set_parameters_callback(self._check_change)
        self._jumps = node.get_clock().create_jump_callback(_JUMP, post_callback=self._on_clock_jump)
        sys.setswitchinterval(min(_SWITCH_S, sys.getswitchinterval()))
        self.worker.start()

    def stop(self, timeout_s: float) -> bool:
        """End worker and judges after what they do now, answer what waits and write what is to be kept.

        False if it was still computing when the time was over.
        """
        self.is_active = False
        self.inputs.clear()
        end = time.monotonic() + timeout_s
        self.judges.close("the node was stopped")
        is_done = self.worker.stop(timeout_s) and self.judges.join(max(end - time.monotonic(), 0.0))
        if self._optimised is not None:
            self._optimised.stop(max(end - time.monotonic(), 0.0))
        self.outputs.finish(min(max(end - time.monotonic(), 0.0) + _FINISH_S, _MOST_S))
        try:
            self.write_graph()
        except InputError as error:
            self._node.get_logger().error(str(error))
        return is_done

    def destroy(self) -> None:
        """Give everything back to the node; `stop` comes first."""
        self._node.remove_on_set_parameters_callback(self._check_change)
        self._jumps.unregister()
        for part in (self.inputs, self.outputs, self._optimised, self.frames):
            if part is not None:
                part.destroy()
        self._node.destroy_publisher(self._diagnostics)
        self.close_files()

    def close_files(self) -> None:
        """Give back what the engine reads from, which is not the node's."""
        if isinstance(self.engine, LocalizationEngine):
            self.engine.close()

    def tell(self) -> None:
        """Publish diagnostics and the way so far; nothing if the session ends meanwhile on another thread."""
        settings = self._parameters.settings
        try:
            self.inputs.look()
        except InvalidHandle:
            pass
        except RCLError:
            if self._node.context.ok():
                raise  # otherwise shut down meanwhile: nobody listens any more
        with self.inputs.lock:
            message = DiagnosticArray(status=statuses(self.statistics, self.flow(), settings.process_every))
        message.header.stamp = self._node.get_clock().now().to_msg()
        with contextlib.suppress(InvalidHandle):
            self._diagnostics.publish(message)
            self.outputs.publish_path(settings)
            if self._optimised is not None:
                self._optimised.tell()

    @property
    def has_graph(self) -> bool:
        """Whether the mode keeps a pose graph."""
        return isinstance(self.engine, LoopEngine)

    def status(self) -> dict[str, Any]:
        """What the node is set to do, and all that it counts: one moment's snapshot."""
        parameters = self._parameters
        with self.inputs.lock:
            return {
                "mode": parameters.settings.mode,
                "preset": parameters.preset_name,
                **({} if parameters.choice is None else {"chosen": dict(parameters.choice.summary())}),
                "method": parameters.config.method,
                "received": {name: monitor.num_received for name, monitor in self.statistics.inputs.items()},
                "lost": {topic: loss.num_lost for topic, loss in self.statistics.losses.items()},
                **self.flow(),
                **self.statistics.numbers(),
            }

    def enable(self, wanted: bool) -> None:
        """Take new work again, or give up what waits and drop what comes."""
        self.is_enabled = wanted
        if not wanted:
            self.deactivate("the node was disabled")

    def deactivate(self, detail: str) -> None:
        """Give up what waits to be computed; what is computed now gets its decision."""
        self._give_up(Reason.INACTIVE, detail)

    def forget_inputs(self, detail: str) -> None:
        """Empty pairing, queue, guesses and odometry; what waited is `stale`."""
        self.inputs.clear()
        self._give_up(Reason.STALE, detail)

    def call_on_worker(self, call: Callable[[], None]) -> None:
        """Let the worker call, between two jobs."""
        self.worker.jobs.call_next(call)

    def flow(self) -> dict[str, Any]:
        """Counters of pairing and worker, for status and diagnostics."""
        pairer, settings = self.inputs.pairer, self._parameters.settings
        return {
            "pairing": {
                "matched": pairer.num_matched,
                "unmatched": pairer.num_unmatched,
                "late": pairer.num_late,
                "waiting": pairer.num_waiting,
            },
            "worker": {
                "ready": self.worker.ready.is_set(),
                "enabled": self.is_enabled and self.is_active,
                "queue": self.worker.jobs.num_waiting,
                "queue_size": settings.queue_size,
                "to_judge": self.judges.num_waiting,
                **self.engine.numbers(),
            },
            "output": self.outputs.numbers(),
        }

    def _make_engine(self) -> Engine:
        settings, sources = self._parameters.settings, Sources(self, self._parameters)
        if settings.mode == "localization":
            return LocalizationEngine.of_folder(sources, settings, self._parameters.take_map)
        if settings.mode == "scan_matching" or (settings.mode == "loop_closure" and settings.odometry == "own"):
            ScanMatcher(self._parameters.config)  # a package that is missing is said now, not with the first scan
        if settings.mode == "scan_matching":
            return MatchingEngine(sources.origin, sources.base, settings.odom_frame)
        if settings.mode == "loop_closure":
            graph_file = Path(settings.graph_file) if settings.graph_file else None
            if graph_file is not None:
                check_place("graph_file", graph_file)
            return LoopEngine(sources, settings.odometry == "own", self.judges.wait, graph_file)
        return PairRegistrar(sources.origin, sources.guess)

    def _make_optimised(self, undo: contextlib.ExitStack) -> OptimisedPath | None:
        if not isinstance(self.engine, LoopEngine):
            return None
        sources = Sources(self, self._parameters)
        made = OptimisedPath(self._node, self.engine.graph, lambda: sources.odometry_frame)
        undo.callback(made.destroy)
        return made

    # on the executor's thread

    def _take(self, job: Job) -> None:
        settings = self._parameters.settings
        if not isinstance(job, DropJob) and not (self.is_enabled and self.is_active):
            job = job.drop(Reason.INACTIVE, "the node is not active" if self.is_enabled else "the node is disabled")
        self.statistics.receive()
        self.worker.jobs.put(job, None if settings.process_every else settings.capacity)

    def _give_up(self, reason: Reason, detail: str) -> None:
        self.worker.jobs.give_up(reason, detail)
        self.judges.give_up(reason, detail)

    def _check_change(self, parameters: list[Parameter]) -> SetParametersResult:
        """A frame that is set at work needs TF from now on; what the values mean is checked elsewhere."""
        fixed = [p.name for p in parameters if p.name.startswith(OF_MAPS)]
        if fixed and isinstance(self.engine, LocalizationEngine):
            return SetParametersResult(successful=False, reason=f"{fixed[0]}: the map was made with another value")
        if any(p.name == "sensor_frame" and p.value for p in parameters):
            try:
                self.frames.listen("sensor_frame")
            except MissingDependencyError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_clock_jump(self, _jump: TimeJump) -> None:
        """Simulated time went back. Clouds that came since then already are of the new time: those stay."""
        if self.inputs.is_ahead_of(self._node.get_clock().now().nanoseconds):
            self.inputs.watch.clock_jumped()
            self.forget_inputs("the clock jumped back")
            self.frames.clear()
            self.call_on_worker(self.reset_engine)

    # on the worker's thread

    def reset_engine(self) -> None:
        """Forget everything computed. Raises InputError where what is to be kept of it cannot be written."""
        self.outputs.forget()
        self.engine.reset()

    def judge_again(self) -> dict[str, Any]:
        """Judge the last pose once more, for a service; see Engine."""
        return self.engine.judge_again(self._parameters.config)

    def write_graph(self) -> Path | None:
        """Write the pose graph, if the mode keeps one; safe from any thread. See LoopEngine."""
        return self.engine.write_graph() if isinstance(self.engine, LoopEngine) else None

    def _warm_up(self) -> None:
        start, logger = time.monotonic(), self._node.get_logger()
        logger.info("warming up")
        with told(logger.info):
            self.engine.warm_up(self._parameters.config)
        logger.info(
            f"ready: mode {self._parameters.settings.mode}, preset {self._parameters.preset_name}, "
            f"method {self._parameters.config.method} (warm-up {time.monotonic() - start:.1f} s)"
        )

    def _process(self, job: Job) -> None:
        settings = self._parameters.settings
        try:
            if isinstance(job, PairJob):
                self.frames.check_one_stamp(settings, job.source.label, job.target.label)
            self._first_choice.settle(job)
            outcome = self.engine.process(job, self._parameters.config)
        except Exception as error:
            outcome = [Decision(refused(error, self._parameters.config), *labels(job))]
        self.judges.put(outcome, settings.capacity, settings.process_every)

    # on the thread that has what is to be told next

    def _finish(self, decisions: list[Decision]) -> None:
        settings = self._parameters.settings
        self.statistics.finish(decisions)
        for decision in decisions:
            try:
                self.outputs.publish(decision, settings)
            except Exception:
                if self._node.context.ok():
                    raise
                return  # shut down while this was computed: nobody listens any more
            self._node.get_logger().debug(f"{decision.result.verdict.value}: {decision.result.reason.value}")
