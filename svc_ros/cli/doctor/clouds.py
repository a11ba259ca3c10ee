"""Checks of what is in the clouds of a bag, and the preset that fits them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from svc_ros.cli.doctor.finding import Finding, Level
from svc_ros.cli.doctor.notes import CloudNotes
from svc_ros.core.auto_preset import NEAREST_M, Choice, choose_by_outlooks
from svc_ros.core.config import PreprocessConfig
from svc_ros.core.scan import Array
from svc_ros.core.scans.oddities import FARTHEST_M, explain_crossed, explain_few_points, explain_ranges, explain_shape
from svc_ros.core.scans.preprocess import crop_range, thin_on_voxel_grid

_MANY = 0.5  # share of dropped points above which somebody should look
_HERE = np.zeros(3)  # points of a view are relative to the sensor
_LONGEST_SWEEP_S = 0.5
_CUT = 0.2  # share of points outside the preset's ranges above which its values do not fit


def suggest_preset(notes: CloudNotes) -> Choice:
    """What `auto` chooses by the clouds that were looked at, which are spread over all of the recording."""
    return choose_by_outlooks([view.outlook for view in notes.views if view.outlook is not None])


def check_clouds(notes: CloudNotes) -> list[Finding]:
    """Fields, numbers of points, points that carry nothing, times, the point of view, and the preset."""
    found = [_check_fields(notes), *_check_points(notes)]
    if notes.num_repeated:
        found.append(
            Finding("repeated clouds", "warn", f"{notes.num_repeated} hold the points of the one before",
                    "the driver sends old data under new stamps, or the bag was thinned badly")
        )  # fmt: skip
    if notes.views:
        if suggest_preset(notes).preset != "rgbd_indoor":  # a depth image is taken at one instant
            found.append(_check_times(notes))
        found += [*_check_free(notes), *_check_viewpoint(notes), *_check_preset(notes)]
    return found


def _check_fields(notes: CloudNotes) -> Finding:
    found = " | ".join(layout for layout, _ in notes.layouts.most_common())
    if not notes.refused:
        return Finding("fields", "ok", found)
    share = f"{len(notes.refused)} of {len(notes.stamps_ns)} clouds refused: {notes.refused[0]}"
    level: Level = "warn" if notes.num_points else "error"
    return Finding("fields", level, f"{found}; {share}", "mend the driver that writes these clouds")


def _check_points(notes: CloudNotes) -> list[Finding]:
    if not notes.num_points:
        return []
    total, empty = sum(notes.num_points), notes.num_points.count(0)
    low, middle, high = min(notes.num_points), int(np.median(notes.num_points)), max(notes.num_points)
    found = f"{middle} a cloud ({low} to {high}), {empty} clouds empty"
    points = Finding("points", "ok", found)
    if not notes.num_usable:
        advice = "the driver runs without measurements: look at the sensor, its cable, and the driver's range limits"
        points = Finding("points", "error", f"{found}, not one that can be used", advice)
    elif empty:
        points = Finding("points", "warn", found, "empty clouds are rejected with too_few_points")
    return [
        points,
        _check_dropped("NaN share", notes.num_nan, total),
        _check_dropped("zero-point share", notes.num_zero, total),
    ]  # fmt: skip


def _check_dropped(name: str, num_dropped: int, total: int) -> Finding:
    share = num_dropped / total if total else 0.0
    if share <= _MANY:
        return Finding(name, "ok", f"{share:.1%}")
    advice = "points that carry nothing: look at the sensor's range and at its driver"
    return Finding(name, "error" if num_dropped == total else "warn", f"{share:.1%}", advice)


def _check_times(notes: CloudNotes) -> Finding:
    """Per-point times; they undo the motion within a sweep in scan_matching and loop_closure."""
    name, spans = "point times", [view.sweep_s for view in notes.views if view.sweep_s is not None]
    if not notes.time_fields:
        advice = "scan_matching undoes no motion within a sweep: record t, time or timestamp if the driver has it"
        return Finding(name, "ok", "none", advice)
    fields = ", ".join(sorted(notes.time_fields))
    if notes.num_timed < len(notes.num_points):
        unusable = f"unusable in {len(notes.num_points) - notes.num_timed} of {len(notes.num_points)} clouds"
        advice = "they are NaN or more than 2 s from the header's stamp: another clock or unit; they are left unused"
        return Finding(name, "warn", f"field {fields}, {unusable}", advice)
    span = float(np.median(spans))
    if span == 0.0:
        return Finding(name, "warn", f"field {fields}, the same for all points", "the driver fills in no times")
    found = f"field {fields}, a sweep lasts {span:.3f} s"
    if span <= _LONGEST_SWEEP_S:
        return Finding(name, "ok", found)
    advice = "longer than sensors take: several sweeps in a cloud, or a share of the sweep (0 to 1) instead of seconds?"
    return Finding(name, "warn", found, advice)


def _check_free(notes: CloudNotes) -> list[Finding]:
    num = int(np.median([view.num_free for view in notes.views]))
    return [Finding("free directions", "ok", f"{num} a cloud, from points at +inf")] if num else []


def _check_viewpoint(notes: CloudNotes) -> list[Finding]:
    """Does the sensor stand at the origin? Seen from elsewhere, surfaces lie behind each other."""
    crossed = float(np.quantile([view.crossed_ratio for view in notes.views], 0.75))
    found = f"{crossed:.1%} of the directions from the origin meet several surfaces"
    advice = explain_crossed(crossed)
    return [Finding("sensor at the origin", "warn" if advice else "ok", found, advice)]


def _check_preset(notes: CloudNotes) -> list[Finding]:
    choice = suggest_preset(notes)
    config = choice.config.preprocess
    reach = f"98 % of the points within {choice.outlook.reach_m:.3g} m" if choice.outlook else ""
    if choice.outlook is None or choice.outlook.reach_m >= FARTHEST_M:
        why = next(filter(None, (explain_ranges(view.points, _HERE, config) for view in notes.views)), "")
        found = reach or f"no point beyond {NEAREST_M:g} m"
        return [Finding("scale", "error", found, f"expected metres: {why or 'some points lie far outside'}")]
    other = f"; {choice.may_be} may fit as well" if choice.may_be else ""
    advice = f"start with --preset {choice.preset}, or auto, which looks at the first clouds{other}"
    found = f"{choice.preset}: {choice.why}"
    return [Finding("preset", "ok", found, advice), *_check_cut(notes, config), *_check_thinned(notes, config)]


def _check_cut(notes: CloudNotes, config: PreprocessConfig) -> list[Finding]:
    near, far = np.median([_outside(view.points, config) for view in notes.views], axis=0)
    if max(near, far) <= _CUT:
        return []
    found = f"{near:.0%} of the points nearer than {config.min_range_m:g} m, {far:.0%} beyond {config.max_range_m:g} m"
    advice = "the preset drops them: set preprocess.min_range_m and preprocess.max_range_m to the sensor"
    return [Finding("ranges", "warn", found, advice)]


def _outside(points: Array, config: PreprocessConfig) -> tuple[float, float]:
    ranges = np.linalg.norm(points, axis=1)
    return float((ranges < config.min_range_m).mean()), float((ranges > config.max_range_m).mean())


def _check_thinned(notes: CloudNotes, config: PreprocessConfig) -> list[Finding]:
    """What is left after range crop and voxel grid has to be enough for a registration, and more than a plane."""
    size = config.voxel_size_m
    left = [thin_on_voxel_grid(crop_range(view.points, _HERE, config), size) for view in notes.views]
    few = [view for view, points in zip(notes.views, left, strict=True) if len(points) < config.min_points]
    shapes = (explain_shape(points, _HERE, size) for points in left if len(points) >= config.min_points)
    flat = [told for told in shapes if told]
    findings = []
    if few:
        found = f"{_shown([*map(len, left)])} left on the preset's voxels of {size:g} m, {config.min_points} are needed"
        advice = explain_few_points(few[0].points, _HERE, config)
        findings.append(Finding("points left", _level(few, left), found, advice))
    if flat:
        what, _, advice = flat[0].partition(": ")
        found = f"in {len(flat)} of {len(left)} clouds {what}"
        findings.append(Finding("structure", _level(flat, left), found, advice))
    return findings


def _level(odd: Sequence[object], views: Sequence[object]) -> Level:
    return "error" if len(odd) == len(views) else "warn"


def _shown(counts: Sequence[int]) -> str:
    return f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
