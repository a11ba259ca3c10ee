"""Checks of how clouds arrive on a topic: how often, how large, how many of them are lost, and how old they are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from svc_ros.cli.doctor.endpoints import override
from svc_ros.cli.doctor.finding import Finding
from svc_ros.io.heard import Arrival, Heard

_BURSTS = 0.5  # of the middle step, by which one step in twenty may differ
_MISSING = 1.5  # times the middle step of the stamps, from which a cloud is missing between two
_CLOCK_S = 1.0  # stamps farther from now are of another clock, or wait somewhere
_NO_TRANSFORMS = "transforms may not exist at the header's stamp"
_SINCE_START_S = 1e8  # three years: clocks that count from their own start, not from 1970


def check_arrivals(heard: Heard) -> list[Finding]:
    """Rate, size and loss of at least one cloud; of one alone no size, which is told with the rate."""
    steps_s = np.diff([arrival.received_ns for arrival in heard.arrivals]) / 1e9
    if not len(steps_s):
        rate = Finding("rate", "warn", f"1 cloud in {heard.seconds:g} s", "listen longer: --seconds 60")
        return [rate, check_loss(heard)]
    return [_check_rate(steps_s, heard.seconds), _check_size(heard.arrivals, float(steps_s.mean())), check_loss(heard)]


def _check_rate(steps_s: NDArray[np.float64], seconds: float) -> Finding:
    middle = float(np.median(steps_s))
    off = float(np.quantile(np.abs(steps_s - middle), 0.95))
    found = (
        f"{1.0 / steps_s.mean():.1f} Hz, {len(steps_s) + 1} clouds in {seconds:g} s; steps of {1e3 * middle:.0f} ms, "
        f"95 % within {1e3 * off:.0f} ms of that, the longest {1e3 * steps_s.max():.0f} ms"
    )
    if off <= _BURSTS * middle:
        return Finding("rate", "ok", found)
    return Finding("rate", "warn", found, "clouds come in bursts: a busy machine, a slow network, or many are lost")


def _check_size(arrivals: Sequence[Arrival], step_s: float) -> Finding:
    num_bytes = float(np.mean([arrival.num_bytes for arrival in arrivals]))
    num_points = int(np.median([arrival.num_points for arrival in arrivals]))
    mbit = 8e-6 * num_bytes / step_s
    return Finding("size", "ok", f"{num_points} points, {1e-6 * num_bytes:.2f} MB a cloud, {mbit:.1f} Mbit/s")


def check_loss(heard: Heard) -> Finding:
    """What was lost on the way, by sequence numbers and by the middleware's word; the stamps are a second opinion."""
    arrivals = heard.arrivals
    by_stamp = missing_by_stamp([arrival.stamp_ns for arrival in arrivals])
    by_number = missing_by_number([arrival.sequence for arrival in arrivals]) if len(heard.publishers) == 1 else None
    numbers = "tell nothing" if by_number is None else f"leave out {by_number}"
    told = f"sequence numbers {numbers}, the middleware reports {heard.num_lost}, stamps leave out {by_stamp}"
    num_lost = max(by_number or 0, heard.num_lost)
    found = f"{num_lost / (len(arrivals) + num_lost):.1%}, {num_lost} of {len(arrivals) + num_lost}: {told}"
    if num_lost:
        return Finding("loss", "warn", found, _against_loss(heard))
    if not by_stamp:
        return Finding("loss", "ok", found)
    if by_number is None:
        return Finding("loss", "warn", found, f"lost on the way, or never sent; {_against_loss(heard)}")
    return Finding("loss", "warn", found, "nothing is lost on the way: the sensor or its driver leaves scans out")


def _against_loss(heard: Heard) -> str:
    if any(publisher.reliability != "reliable" for publisher in heard.publishers):
        return heard.cure
    repaired = override(heard, "reliability", "reliable")
    return f"{heard.cure}; or let lost clouds be sent again: reliable:=true (launch), or {repaired}"


def missing_by_number(sequence: Sequence[int | None]) -> int | None:
    """Numbers left out of one publisher's count, which begins anew with the publisher; None where a cloud has none."""
    known = [number for number in sequence if number is not None]
    if len(known) < len(sequence):
        return None
    steps = np.diff(np.array(known, np.int64))
    return int((steps[steps > 0] - 1).sum())


def missing_by_stamp(stamps_ns: Sequence[int]) -> int:
    """Clouds that would fill the gaps between the stamps, by their middle step."""
    steps = np.diff(np.array(stamps_ns, np.int64))
    steps = steps[steps > 0]
    if not len(steps):
        return 0
    gaps = steps[steps >= _MISSING * np.median(steps)]
    return int((np.round(gaps / np.median(steps)) - 1).sum())


def check_age(arrivals: Sequence[Arrival]) -> list[Finding]:
    """How old stamps are when they come: by this machine's clock, else by simulated time where there is one."""
    told = [arrival for arrival in arrivals if arrival.stamp_ns]
    if not told:
        return []
    age_s = np.array([arrival.received_ns - arrival.stamp_ns for arrival in told]) / 1e9
    simulated_s = np.array([a.clock_ns - a.stamp_ns for a in told if a.clock_ns is not None]) / 1e9
    if len(simulated_s) and abs(np.median(age_s)) > _CLOCK_S:
        found = f"{_spread(simulated_s)} by simulated time (/clock)"
        if _is_now(simulated_s):
            return [Finding("age", "ok", found, "start the node with use_sim_time:=true")]
        return [Finding("age", "warn", found, f"of this machine's clock neither: {_NO_TRANSFORMS}")]
    found = f"{_spread(age_s)} by this machine's clock"
    if not _is_now(age_s):
        return [Finding("age", "warn", found, _other_clock(float(np.median(age_s)), told[0].stamp_ns))]
    return [
        Finding(
            "age", "ok", found, "/clock is published, too: use_sim_time:=false for these" if len(simulated_s) else ""
        )
    ]


def _spread(age_s: NDArray[np.float64]) -> str:
    return f"{np.median(age_s):.3f} s when they come (spread {np.ptp(age_s):.3f} s)"


def _is_now(age_s: NDArray[np.float64]) -> bool:
    return bool(max(abs(np.median(age_s)), np.ptp(age_s)) <= _CLOCK_S)


def _other_clock(age_s: float, stamp_ns: int) -> str:
    if stamp_ns < _SINCE_START_S * 1e9:
        return "the sensor's own clock, counted from its start: let the driver stamp by the computer's, or use PTP"
    if age_s > _CLOCK_S:
        return (
            "a bag that is played? Then ros2 bag play --clock, and use_sim_time:=true for the node. "
            f"Else two clocks, or clouds that wait in a queue: {_NO_TRANSFORMS}"
        )
    return f"clocks that differ, or one that was set meanwhile: {_NO_TRANSFORMS}"
