"""A few neighbouring scans of a bag, registered: what a preset makes of them, and how fast the sensor moves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from svc_ros.cli.doctor.finding import Finding
from svc_ros.core import se3
from svc_ros.core.config import preset
from svc_ros.core.result import RegistrationResult
from svc_ros.core.se3 import pose_error
from svc_ros.io.clouds.point_cloud2 import CloudReading
from svc_ros.pipeline.decide import register_pair

_SWEEP_S = 0.1  # of a spinning sensor, where neither times nor a faster rate tell it
_LEVER_M = 10.0  # where a turn is turned into metres
_SMEARED_M = 0.5  # a scan that is smeared by more blocks its own sight lines
_OTHER = {"lidar_indoor": "lidar_outdoor", "lidar_outdoor": "lidar_indoor"}
Pair = tuple[CloudReading, CloudReading]


def try_pairs(pairs: Sequence[Pair], preset_name: str) -> list[Finding]:
    """Register the second scan of each pair to the first; with the other LiDAR preset, too, if few are accepted."""
    if not pairs:
        return []
    results = _register(pairs, preset_name)
    findings = [_judge(results, preset_name)]
    if findings[0].level != "ok" and preset_name in _OTHER:
        findings.append(_judge(_register(pairs, _OTHER[preset_name]), _OTHER[preset_name]))
    accepted = [(pair, result) for pair, result in zip(pairs, results, strict=True) if result.accepted]
    if preset_name == "rgbd_indoor":  # a depth image is taken at one instant
        return findings
    return [*findings, *_check_motion(accepted)]


def _register(pairs: Sequence[Pair], preset_name: str) -> list[RegistrationResult]:
    config = preset(preset_name)
    return [register_pair(second.scan, first.scan, config) for first, second in pairs]


def _judge(results: Sequence[RegistrationResult], preset_name: str) -> Finding:
    name = f"registration, {preset_name}"
    accepted = [result for result in results if result.accepted]
    found = f"{len(accepted)} of {len(results)} neighbouring pairs accepted"
    others = Counter(result.reason.value for result in results if not result.accepted)
    if others:
        found += f" ({', '.join(f'{reason} {count}' for reason, count in others.most_common())})"
    if 2 * len(accepted) >= len(results):
        return Finding(name, "ok", found)
    return Finding(name, "warn", found, "look the reasons up in docs/decisions.md; what is odd above may explain them")


def _check_motion(accepted: Sequence[tuple[Pair, RegistrationResult]]) -> list[Finding]:
    """How far the sensor moves within a sweep; whether a driver has compensated that, a cloud does not tell."""
    smears = [_smear(*pair, result) for pair, result in accepted]
    known = [smear for smear in smears if smear is not None]
    if not known:
        return []
    smear, speed, turn, sweep = max(known)
    found = f"up to {speed:.1f} m/s and {turn:.0f} deg/s: {smear:.2f} m in a sweep of {sweep:.2f} s"
    timed = all(reading.scan.point_times_s is not None for pair, _ in accepted for reading in pair)
    if smear <= _SMEARED_M or timed:
        return [Finding("motion", "ok", found)]
    advice = "scans are smeared by that much unless the driver compensates motion: there are no point times to undo it"
    return [Finding("motion", "warn", found, advice)]


def _smear(first: CloudReading, second: CloudReading, result: RegistrationResult) -> tuple[float, ...] | None:
    """Smear [m] at ten metres, speed [m/s], turn rate [deg/s] and sweep [s]; None where the stamps tell no time."""
    step_s = (second.scan.stamp_ns - first.scan.stamp_ns) / 1e9
    if step_s <= 0 or result.T_target_source is None:
        return None
    angle_deg, _ = pose_error(result.T_target_source, np.eye(4))
    way = se3.apply(result.T_target_source, second.scan.sensor_origin[None])[0] - first.scan.sensor_origin
    distance_m = float(np.linalg.norm(way))
    times = second.scan.point_times_s
    sweep_s = float(np.ptp(times)) if times is not None and len(times) else min(step_s, _SWEEP_S)
    speed, turn = distance_m / step_s, angle_deg / step_s
    return (speed + np.radians(turn) * _LEVER_M) * sweep_s, speed, turn, sweep_s
