"""Preset `auto`: which preset fits scans, by how far and how widely their sensor sees; and why.

Only what is seen counts, no name of a sensor. Whoever takes part gets the same preset: it is chosen from all scans
together. Where the borders come from: docs/tuning.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from svc_ros.core.config import AUTO, Config, preset
from svc_ros.core.parallel import in_parts
from svc_ros.core.scan import Array, Scan

__all__ = ["AUTO", "Choice", "Outlook", "choose_by_outlooks", "choose_preset", "look_out"]

INDOOR_REACH_M = 35.0  # in doubt indoors: that preset is right in a small yard too, the other one wrong in a room
CAMERA_REACH_M = 12.0
CAMERA_CONCENTRATION = 0.75  # a cone of 120 deg; half a turn has 0.64
_REACHED_SHARE = 0.98  # the farthest fiftieth is seen through doors and panes, or is noise
NEAREST_M = 0.3  # nearer points are of the carrier, or mark that there was no return
_PART = 2**18  # points
_SHOWN = {"voxel_size_m": "preprocess", "min_range_m": "preprocess", "max_range_m": "preprocess",
          "tolerance_m": "sight_view"}  # fmt: skip


@dataclass(frozen=True)
class Outlook:
    """What one scan shows of its sensor and its surroundings.

    reach_m: range [m] within which 98 % of the points lie; concentration: length of the mean viewing direction, 0: all
    around, 1: one way.
    """

    reach_m: float
    concentration: float


@dataclass(frozen=True)
class Choice:
    """The preset that fits. preset: its name; config: its values; why: one sentence; outlook: what it was chosen by,
    None where no scan has a point."""

    preset: str
    config: Config
    why: str
    outlook: Outlook | None = None

    @property
    def may_be(self) -> str:
        """The other LiDAR preset where the reach is within half of the border between both; else empty."""
        if self.outlook is None:
            return ""
        reach = self.outlook.reach_m
        near = max(reach, INDOOR_REACH_M) < 1.5 * min(reach, INDOOR_REACH_M)
        others = {"lidar_indoor": "lidar_outdoor", "lidar_outdoor": "lidar_indoor"}
        return others.get(self.preset, "") if near else ""

    def summary(self) -> Mapping[str, str | float]:
        """For records: name, reason, what was measured and the lengths that follow; lengths in metres."""
        measured = {} if self.outlook is None else vars(self.outlook)
        lengths = {name: float(getattr(getattr(self.config, group), name)) for name, group in _SHOWN.items()}
        return {"preset": self.preset, "why": self.why, **{k: round(v, 3) for k, v in measured.items()}, **lengths}


def choose_preset(scans: Sequence[Scan]) -> Choice:
    """The preset for scans that are to be registered with each other, in any frame and order.

    Take a few that are spread over a recording, or the two of a pair. Scans without points say nothing; where none has
    any, the choice is lidar_outdoor, and the registration says what is missing.
    """
    return choose_by_outlooks([found for scan in scans if (found := look_out(scan.points, scan.sensor_origin))])


def look_out(points: Array, sensor_origin: Array) -> Outlook | None:
    """Measure a scan's points (N, 3) [m], seen from sensor_origin (3,) [m]; None without points beyond 0.3 m."""
    ranges, direction = np.empty(len(points)), np.zeros(3)
    num = 0
    for part in in_parts(len(points), _PART):  # what is computed of a part stays in the cache, and small
        seen = points[part] - sensor_origin
        ranges_of_part = np.sqrt(np.einsum("ij,ij->i", seen, seen))
        far = ranges_of_part > NEAREST_M
        seen, ranges_of_part = seen[far], ranges_of_part[far]
        ranges[num : num + len(seen)] = ranges_of_part
        direction += (seen / ranges_of_part[:, None]).sum(0)
        num += len(seen)
    if num == 0:
        return None
    reach = float(np.quantile(ranges[:num], _REACHED_SHARE))
    return Outlook(reach, float(np.linalg.norm(direction / num)))


def choose_by_outlooks(outlooks: Sequence[Outlook]) -> Choice:
    """The same as `choose_preset`, by what was measured of each scan: by the median, of two by the nearer reach."""
    if not outlooks:
        return Choice("lidar_outdoor", preset("lidar_outdoor"), "no point to choose by")
    typical = Outlook(*(_lower_median([getattr(o, name) for o in outlooks]) for name in ("reach_m", "concentration")))
    reach = f"98 % of the points lie within {typical.reach_m:.1f} m"
    if typical.concentration > CAMERA_CONCENTRATION and typical.reach_m < CAMERA_REACH_M:
        name, why = "rgbd_indoor", f"{reach} (below {CAMERA_REACH_M:g} m) and one way, as a depth camera sees"
    elif typical.reach_m < INDOOR_REACH_M:
        name, why = "lidar_indoor", f"{reach} (below {INDOOR_REACH_M:g} m), as in a building or between near walls"
    else:
        name, why = "lidar_outdoor", f"{reach} (at least {INDOOR_REACH_M:g} m), as outdoors"
    return Choice(name, preset(name), why, typical)


def _lower_median(values: Sequence[float]) -> float:
    return sorted(values)[(len(values) - 1) // 2]
