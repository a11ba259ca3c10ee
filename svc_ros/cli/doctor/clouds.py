"""Checks of what is in the clouds of a bag, and the preset that fits them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from svc_ros.cli.doctor.finding import Finding, Level
from svc_ros.cli.doctor.notes import CloudNotes
from svc_ros.core.auto_preset import NEAREST_M, Choice, choose_by_outlooks
from svc_ros.core.config import PreprocessConfig
from svc_ros.core.scan import Array

_MANY = 0.5  # share of dropped points above which somebody should look
_CROSSED = 0.10  # scans seen from their own sensor have up to 0.05
_FARTHEST_M = 1000.0  # no sensor of these presets reaches farther
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
    return [
        Finding("points", "warn" if empty else "ok", f"{middle} a cloud ({low} to {high}), {empty} clouds empty",
                "empty clouds are rejected with too_few_points" if empty else ""),
        _check_dropped("NaN share", notes.num_nan, total),
        _check_dropped("zero-point share", notes.num_zero, total),
    ]  # fmt: skip


def _check_dropped(name: str, num_dropped: int, total: int) -> Finding:
    share = num_dropped / total if total else 0.0
    many = share > _MANY
    advice = "most points carry nothing: look at the sensor's range and at its driver" if many else ""
    return Finding(name, "warn" if many else "ok", f"{share:.1%}", advice)


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
    return Finding(name, "ok", f"field {fields}, a sweep lasts {span:.3f} s")


def _check_free(notes: CloudNotes) -> list[Finding]:
    num = int(np.median([view.num_free for view in notes.views]))
    return [Finding("free directions", "ok", f"{num} a cloud, from points at +inf")] if num else []


def _check_viewpoint(notes: CloudNotes) -> list[Finding]:
    """Does the sensor stand at the origin? Seen from elsewhere, surfaces lie behind each other."""
    crossed = float(np.quantile([view.crossed_share for view in notes.views], 0.75))
    found = f"{crossed:.1%} of the directions from the origin meet several surfaces"
    if crossed <= _CROSSED:
        return [Finding("sensor at the origin", "ok", found)]
    advice = (
        "sight lines would start in the wrong place: clouds in a map's frame (name the sensor's by --sensor-frame, "
        "sensor_frame or sensor_origin), of several sensors, or accumulated"
    )
    return [Finding("sensor at the origin", "warn", found, advice)]


def _check_preset(notes: CloudNotes) -> list[Finding]:
    choice = suggest_preset(notes)
    if choice.outlook is None:
        return [Finding("scale", "error", f"no point beyond {NEAREST_M:g} m", "expected metres")]
    reach = choice.outlook.reach_m
    if reach >= _FARTHEST_M:
        advice = "expected metres: millimetres, or a map's coordinates?"
        return [Finding("scale", "error", f"98 % of the points within {reach:.3g} m", advice)]
    config = choice.config.preprocess
    other = f"; {choice.may_be} may fit as well" if choice.may_be else ""
    advice = f"start with --preset {choice.preset}, or auto, which looks at the first clouds{other}"
    found = f"{choice.preset}: {choice.why}"
    return [Finding("preset", "ok", found, advice), *_check_cut(notes, config), *_check_voxels(notes, config)]


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


def _check_voxels(notes: CloudNotes, config: PreprocessConfig) -> list[Finding]:
    """What is left after range crop and voxel grid has to be enough for a registration."""
    left = [_num_voxels(view.points, config) for view in notes.views]
    few = sum(num < config.min_points for num in left)
    if not few:
        return []
    found = f"{_shown(left)} left on the preset's voxels of {config.voxel_size_m:g} m, {config.min_points} are needed"
    level: Level = "error" if few == len(left) else "warn"
    return [Finding("points left", level, found, "smaller preprocess.voxel_size_m, wider ranges, or another sensor")]


def _num_voxels(points: Array, config: PreprocessConfig) -> int:
    ranges = np.linalg.norm(points, axis=1)
    kept = points[(ranges >= config.min_range_m) & (ranges <= config.max_range_m)]
    return len(np.unique(np.floor(kept / config.voxel_size_m).astype(np.int64), axis=0))


def _shown(counts: Sequence[int]) -> str:
    return f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
