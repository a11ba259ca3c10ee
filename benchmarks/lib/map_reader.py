"""Opens a map in a process of its own and uses it: what that takes, as one JSON object on stdout.

python -m lib.map_reader FOLDER SEARCHES VISITS
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from lib.resident import peak_mb, resident_mb
from svc_ros.core.registration import verify
from svc_ros.pipeline.map import Map

_MOST = 10  # places asked for in each search


def main() -> None:
    """Read, search, visit, tell."""
    folder, num_searches, num_visits = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    before = resident_mb()
    begun = time.perf_counter()
    known = Map.read(folder)
    read_s = time.perf_counter() - begun
    told: dict[str, Any] = {"keyframes": len(known), "read_s": read_s, "before_mb": before, "read_mb": resident_mb()}
    rng = np.random.default_rng(0)
    _use(known, 0)  # kernels are loaded
    times, processor_times = [], []
    for index in rng.integers(len(known), size=num_searches).tolist():
        look = known.keyframe(index).look
        begun, processor_begun = time.perf_counter(), time.process_time()
        known.similar(look, _MOST)
        processor_times.append(1e3 * (time.process_time() - processor_begun))
        times.append(1e3 * (time.perf_counter() - begun))
    for name, spent in (("search_ms", times), ("search_processor_ms", processor_times)):
        told |= {f"{name}_p{share}": float(np.percentile(spent, share)) for share in (50, 95)}
    told["searched_mb"] = resident_mb()
    for index in rng.integers(len(known), size=num_visits).tolist():
        _use(known, index)
    print(json.dumps({**told, "visited_mb": resident_mb(), "peak_mb": peak_mb()}))


def _use(known: Map, index: int) -> None:
    """What localisation does with a keyframe: descriptors, and a pose held against it."""
    keyframe = known.keyframe(index)
    assert len(keyframe.features)
    with keyframe.lent() as lent:
        verify(lent.scan, lent.scan, np.eye(4), known.config)


if __name__ == "__main__":
    main()
