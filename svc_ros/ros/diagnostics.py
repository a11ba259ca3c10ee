"""What the node counts about itself, and how that reads as /diagnostics and as ~/status."""

from __future__ import annotations

import threading
import time
from collections import Counter, defaultdict, deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from svc_ros.core.result import Reason, Verdict
from svc_ros.core.scan import Array
from svc_ros.pipeline.agreement import ORIGIN
from svc_ros.pipeline.localisation import LocalisationState
from svc_ros.ros.middleware import cure
from svc_ros.ros.streams.decision import Decision
from svc_ros.ros.topics.loss import LossMonitor

_RATE_WINDOW_S = 10.0
STALE_AFTER_S = 5.0
_REJECTS_IN_A_ROW = 5
_KEPT_LATENCIES = 200
_FAULTS = (Reason.INTERNAL_ERROR, Reason.TF_UNAVAILABLE)
_OK, _WARN, _ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class InputMonitor:
    """When clouds came on one input; times are of a steady clock [s], so a paused bag is seen as silence.

    is_needed: silence is worth a warning even before the first cloud.
    """

    def __init__(self, is_needed: bool = True) -> None:
        self.num_received, self.is_needed = 0, is_needed
        self._start = time.monotonic()
        self._times: deque[float] = deque(maxlen=1000)

    def tick(self, now_s: float) -> None:
        """One cloud came."""
        self.num_received += 1
        self._times.append(now_s)

    def rate_hz(self, now_s: float) -> float:
        """Clouds a second over the last ten seconds."""
        span = min(_RATE_WINDOW_S, max(now_s - self._start, 1e-3))
        return sum(t > now_s - span for t in self._times) / span

    def silence_s(self, now_s: float) -> float:
        """Seconds since the last cloud, or since the start."""
        return now_s - (self._times[-1] if self._times else self._start)


class Statistics:
    """Counts of everything since the start. The worker writes decisions, callbacks the rest; reads are snapshots.

    inputs: their names, and whether the mode cannot do without them; node: what its statuses are told under.
    """

    def __init__(self, inputs: Mapping[str, bool], node: str = "svc_registration") -> None:
        self.node = node
        self.inputs = {name: InputMonitor(is_needed) for name, is_needed in inputs.items()}
        self.qos_problems: dict[str, str] = {}
        self.losses: defaultdict[str, LossMonitor] = defaultdict(LossMonitor)  # by topic, as the node names it
        self.type_problems: dict[str, str] = {}  # of a topic: what is sent on it and not taken, and what to do
        self.fault = ""
        self._lock = threading.Lock()
        self._verdicts: Counter[str] = Counter({verdict.value: 0 for verdict in Verdict})
        self._reasons: Counter[str] = Counter()
        self._latencies_ms: deque[float] = deque(maxlen=_KEPT_LATENCIES)
        self._rejects_in_a_row = 0
        self._num_jobs, self._num_pending, self._num_silent, self._num_revised = 0, 0, 0, 0

    def receive(self) -> None:
        """One more pair, scan or cloud without a partner will be decided."""
        with self._lock:
            self._num_jobs += 1
            self._num_pending += 1

    def finish(self, decisions: Sequence[Decision]) -> None:
        """All decisions on one of them, and later words on earlier ones; none for a scan without candidates."""
        with self._lock:
            self._num_pending -= 1
            self._num_silent += not decisions
            self.fault = "" if not decisions else self.fault  # a scan without candidates is a scan without a fault
            for decision in decisions:
                if decision.origin == ORIGIN:  # its pair is counted
                    self._num_revised += 1
                else:
                    self._count(decision)

    def _count(self, decision: Decision) -> None:
        result = decision.result
        self._verdicts[result.verdict.value] += 1
        self._reasons[result.reason.value] += 1
        self.fault = f"{result.reason.value}: {result.detail}" if result.reason in _FAULTS else ""
        if "latency_ms" in decision.timings_ms:
            self._latencies_ms.append(decision.timings_ms["latency_ms"])
        if result.verdict is not Verdict.DROPPED:
            self._rejects_in_a_row = 0 if result.accepted else self._rejects_in_a_row + 1

    def numbers(self) -> dict[str, Any]:
        """Verdicts, reasons, latency percentiles and the length of the current run of rejects: one moment's snapshot.

        `jobs.received` is `jobs.pending` plus `jobs.without_candidate` plus all decisions, where each job has one.
        """
        with self._lock:
            latencies = np.array(self._latencies_ms)
            return {
                "jobs": {
                    "received": self._num_jobs,
                    "pending": self._num_pending,
                    "without_candidate": self._num_silent,
                },
                "decisions": dict(self._verdicts),
                "revised": self._num_revised,
                "reasons": dict(self._reasons),
                "latency_ms": _percentiles(latencies),
                "rejects_in_a_row": self._rejects_in_a_row,
            }


def statuses(statistics: Statistics, flow: Mapping[str, Any], process_every: bool) -> list[DiagnosticStatus]:
    """The statuses of /diagnostics. `flow`: the node's own counters (pairing, worker, output)."""
    now = time.monotonic()
    numbers = statistics.numbers()
    told = [
        _input_status(statistics, now),
        _status("pairing", _OK, "pairs by stamp", flow["pairing"]),
        _worker_status(flow, numbers, process_every),
        _decision_status(statistics, numbers, flow["output"]),
    ]
    if "state" in flow["worker"]:
        told.append(_localization_status(flow["worker"]))
    for status in told:
        status.name, status.hardware_id = f"{statistics.node}: {status.name}", statistics.node
    return told


def _input_status(statistics: Statistics, now: float) -> DiagnosticStatus:
    values: dict[str, Any] = {}
    silent = []
    for side, monitor in statistics.inputs.items():
        values |= {f"{side}_received": monitor.num_received, f"{side}_rate_hz": round(monitor.rate_hz(now), 2)}
        is_expected = monitor.is_needed or monitor.num_received > 0
        if is_expected and monitor.silence_s(now) > STALE_AFTER_S:
            silent.append(side)
    values |= {f"qos_{topic}": text for topic, text in statistics.qos_problems.items()}
    values |= {f"lost_{topic}": loss.num_lost for topic, loss in statistics.losses.items()}
    values |= {f"type_{topic}": text for topic, text in statistics.type_problems.items()}
    losses = {topic: lost for topic, loss in statistics.losses.items() if (lost := loss.warning(now))}
    if statistics.qos_problems:
        return _status("input", _ERROR, "incompatible QoS: " + ", ".join(statistics.qos_problems), values)
    if statistics.type_problems:
        return _status("input", _ERROR, "; ".join(statistics.type_problems.values()), values)
    if losses:
        told = "; ".join(f"{topic}: {lost}" for topic, lost in losses.items())
        return _status("input", _WARN, f"{told}: {cure()}", values)
    if silent:
        return _status("input", _WARN, f"no clouds for {STALE_AFTER_S:g} s: " + ", ".join(silent), values)
    return _status("input", _OK, "clouds arrive", values)


def _worker_status(flow: Mapping[str, Any], numbers: Mapping[str, Any], process_every: bool) -> DiagnosticStatus:
    values = {**flow["worker"], **{f"latency_ms_{name}": value for name, value in numbers["latency_ms"].items()}}
    if not flow["worker"]["ready"]:
        return _status("worker", _WARN, "warming up", values)
    if not flow["worker"]["enabled"]:
        return _status("worker", _WARN, "disabled", values)
    if process_every and flow["worker"]["queue"] > flow["worker"]["queue_size"]:
        return _status("worker", _WARN, "pairs come faster than they are registered", values)
    return _status("worker", _OK, "ready", values)


def _decision_status(statistics: Statistics, numbers: Mapping[str, Any], output: Mapping[str, Any]) -> DiagnosticStatus:
    run = numbers["rejects_in_a_row"]
    values = {**numbers["decisions"], **numbers["jobs"], **{f"reason_{k}": n for k, n in numbers["reasons"].items()}}
    values |= {"rejects_in_a_row": run, **{f"output_{name}": value for name, value in output.items()}}
    if statistics.fault:
        return _status("decisions", _ERROR, statistics.fault, values)
    if problem := output.get("map_problem"):
        return _status("decisions", _WARN, f"map_frame: {problem}", values)
    if output["reader_stopped"]:
        return _status("decisions", _WARN, "a reader of ~/decision does not acknowledge what it is sent", values)
    if run >= _REJECTS_IN_A_ROW:
        return _status("decisions", _WARN, f"{run} pairs in a row were not accepted", values)
    return _status("decisions", _OK, f"{numbers['decisions']['accepted']} accepted", values)


def _localization_status(worker: Mapping[str, Any]) -> DiagnosticStatus:
    values = {name: worker[name] for name in ("state", "map_keyframes", "told", "told_wrong", "told_problem")}
    state = worker["state"]
    if worker["told_wrong"]:
        return _status("localization", _ERROR, f"{state}; the pose that others tell is wrong", values)
    if state == LocalisationState.LOST.value:
        return _status("localization", _ERROR, "lost: no scan says any more where the sensor is", values)
    if problem := worker["told_problem"]:
        return _status("localization", _WARN, f"{state}; a told pose could not be judged: {problem}", values)
    level = _OK if state == LocalisationState.LOCALISED.value else _WARN
    return _status("localization", level, state, values)


def _status(name: str, level: bytes, message: str, values: Mapping[str, Any]) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(level=level, name=name, message=message, values=pairs)


def _percentiles(latencies_ms: Array) -> dict[str, float]:
    if not len(latencies_ms):
        return {}
    return {f"p{q}": round(float(np.percentile(latencies_ms, q)), 1) for q in (50, 95, 99)}
