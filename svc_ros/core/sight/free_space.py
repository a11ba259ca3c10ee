"""Free space: a beam that met nothing within the sensor's range says that there is nothing along it.

Where the other scan, placed by a pose, has surface along such a beam, the pose is contradicted. A single missing
return tells nothing (it may be lost, or just beside an edge): only directions with no return around them count.
"""

from __future__ import annotations

import numpy as np

from svc_ros.core.config import SightViewConfig
from svc_ros.core.kernels import sight as sight_kernels
from svc_ros.core.scan import PreparedScan
from svc_ros.core.scans.neighbours import DirectionGrid
from svc_ros.core.sight.placement import Placement

_MAX_CONE_DEG = 1.0  # cap of the beam's half angle: so far around a free direction nothing was met


def count_free_blocked(observer: PreparedScan, placement: Placement, config: SightViewConfig) -> int:
    """Free directions of the observer along which a placed point stands that lies on nothing of its surface.

    Only points count that the sensor would surely have seen: farther than its own nearest point, nearer than
    `free_reach_m` times the root of the cosine of the incidence, as the light that comes back falls with both.
    """
    if len(observer.free_directions) == 0:
        return 0
    grid, nearest_m = _free_grid(observer)
    radius, sine = config.beam_radius_voxels * observer.voxel_size_m, np.sin(np.radians(_MAX_CONE_DEG))
    limits = np.array(
        [radius, sine, nearest_m, config.free_reach_m, np.tan(np.radians(config.max_incidence_deg))]
    )  # fmt: skip
    met = np.zeros(len(grid.order), bool)
    sight_kernels.find_free_blocked(
        placement.T_observer_other, placement.other.points, placement.other.normals, placement.nearest,
        observer.sensor_origin, limits, grid.tables, met,
    )  # fmt: skip
    return int(met.sum())


def _free_grid(observer: PreparedScan) -> tuple[DirectionGrid, float]:
    """The observer's free directions by cell, and the range of its nearest point [m]; found once a scan."""
    if "free_grid" not in observer.memo:
        grid = DirectionGrid.build(observer.free_directions, observer.free_directions)
        ranges = np.linalg.norm(observer.points - observer.sensor_origin, axis=1)
        observer.memo["free_grid"] = (grid, float(ranges.min(initial=np.inf)))
    found: tuple[DirectionGrid, float] = observer.memo["free_grid"]
    return found
