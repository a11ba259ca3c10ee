"""Place search by map-closures, in an interpreter that has it: `python closures_peer.py IN.npz RESOLUTION MOST`.

IN.npz: points (P, 3) [m] of all local maps, one after the other, and ends (N,). Each is asked for among those before
it. Prints one JSON object: ids of the best of each, best first, and the times [ms]. Needs nothing of svc_ros.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
from map_closures.config import MapClosuresConfig
from map_closures.map_closures import MapClosures


def main() -> None:
    """Ask for every local map in turn."""
    stored, resolution, most = np.load(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
    search = MapClosures(MapClosuresConfig(density_map_resolution=resolution))
    found, times = [], []
    for number, points in enumerate(np.split(stored["points"], stored["ends"][:-1])):
        begun = time.perf_counter()
        closures = search.get_top_k_closures(number, points, most)
        times.append(1e3 * (time.perf_counter() - begun))
        best = sorted(closures, key=lambda closure: -closure.number_of_inliers)
        found.append([int(closure.source_id) for closure in best if closure.number_of_inliers > 0])
    print(json.dumps({"found": found, "ms": times}))


if __name__ == "__main__":
    main()
