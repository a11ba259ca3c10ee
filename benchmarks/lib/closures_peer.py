"""Place search by map-closures, in an interpreter that has it: `python closures_peer.py IN.npz RESOLUTION SIZE MOST`.

IN.npz: points (P, 3) [m] of all scans, one after the other, ends (N,), poses (N, 4, 4), drives (N,) numbers. Local maps
are of the last SIZE scans of a drive, put together by the peer's own voxel map in the frame of the last one; each is
asked for among those before it. Prints one JSON object: ids of the best of each, best first, and the times of the
searches [ms]. Needs nothing of svc_ros.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
from map_closures.config import MapClosuresConfig
from map_closures.map_closures import MapClosures
from map_closures.voxel_map import VoxelMap

RANGE_M = 100.0  # of local maps, as the peer's own pipeline has it


def main() -> None:
    """Ask for every local map in turn."""
    stored, resolution, size, most = np.load(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    scans, poses, drives = np.split(stored["points"], stored["ends"][:-1]), stored["poses"], stored["drives"]
    search = MapClosures(MapClosuresConfig(density_map_resolution=resolution))
    found, times = [], []
    for number in range(len(scans)):
        local = VoxelMap(resolution, RANGE_M)
        for k in range(max(number - size + 1, 0), number + 1):
            if drives[k] == drives[number]:
                local.integrate_frame(scans[k], np.linalg.inv(poses[number]) @ poses[k])
        points = local.point_cloud()
        begun = time.perf_counter()
        closures = search.get_top_k_closures(number, points, most)
        times.append(1e3 * (time.perf_counter() - begun))
        best = sorted(closures, key=lambda closure: -closure.number_of_inliers)
        found.append([int(closure.source_id) for closure in best if closure.number_of_inliers > 0])
    print(json.dumps({"found": found, "ms": times}))


if __name__ == "__main__":
    main()
