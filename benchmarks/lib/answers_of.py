"""The answers of one tree of svc_ros, in a process of its own: python benchmarks/lib/answers_of.py TREE JOBS PART PARTS

TREE is the folder that holds the package to ask, of this commit or of an older one; so nothing is used here but what
older ones have too. JOBS is a JSON file: a list of {"folder", "source", "target", "poses"}, where `poses` is null for
a pair to register, or the poses (4, 4) to verify. Every PARTS-th job is done, from job number PART on. Prints one line
of JSON for each answer.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

_SCANS = 16  # kept prepared, of each kind


def main() -> None:
    """Load the package from the tree and from nowhere else, and do the jobs."""
    tree, jobs = Path(sys.argv[1]).resolve(), json.loads(Path(sys.argv[2]).read_text(encoding="utf-8"))
    part, parts = map(int, sys.argv[3:])
    sys.path.insert(0, str(tree))
    import svc_ros

    if Path(str(svc_ros.__file__)).resolve() != tree / "svc_ros" / "__init__.py":
        sys.exit(f"expected svc_ros of {tree}, found {svc_ros.__file__}")
    for number in range(part, len(jobs), parts):
        for answer in answers_to(jobs[number]):
            print(json.dumps({"job": number, **answer}), flush=True)


def answers_to(job: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """To a pair to register: one of its raw points, one of features made before. Else one to each pose."""
    from svc_ros.core.registration import verify
    from svc_ros.pipeline.decide import register_pair

    folder, source, target = job["folder"], job["source"], job["target"]
    scans, config = (read(folder, source), read(folder, target)), opened(folder)[1]

    def register_reused() -> Any:
        return register_pair(described(folder, source), described(folder, target), config)

    def judge(pose: Any) -> Any:
        return verify(prepared(folder, source), prepared(folder, target), pose, config)

    if job["poses"] is None:
        yield {"call": "register", "pose": None, **plain(register_pair(scans[0], scans[1], config))}
        yield {"call": "register_reused", "pose": None, **plain(decided(register_reused, config))}
    for number, pose in enumerate(job["poses"] or ()):
        yield {"call": "verify", "pose": number, **plain(decided(partial(judge, pose), config))}


def decided(work: Callable[[], Any], config: Any) -> Any:
    """The result, also where a scan has too few points to be prepared; any other error ends the run."""
    from svc_ros.core.errors import TooFewPointsError
    from svc_ros.pipeline.decide import refused

    try:
        return work()
    except TooFewPointsError as error:
        return refused(error, config)


def plain(result: Any) -> dict[str, Any]:
    """What is compared of a result."""
    pose, probability = result.best_candidate, result.probability
    return {
        "verdict": result.verdict.value,
        "reason": result.reason.value,
        "best_candidate": None if pose is None else pose.tolist(),
        "probability": None if probability is None else float(probability),
    }


@lru_cache(maxsize=1)
def opened(folder: str) -> tuple[Any, Any]:
    """A data set, and its preset within its range limits."""
    from svc_ros.core.config import preset, with_values
    from svc_ros.io.datasets import read_dataset

    dataset = read_dataset(folder)
    limits = {"preprocess.min_range_m": dataset.min_range_m, "preprocess.max_range_m": dataset.max_range_m}
    return dataset, with_values(preset(dataset.preset), limits)


@lru_cache(maxsize=_SCANS)
def read(folder: str, path: str) -> Any:
    """A scan with its raw points."""
    return opened(folder)[0].read_scan(path)


@lru_cache(maxsize=_SCANS)
def prepared(folder: str, path: str) -> Any:
    """A scan as `verify` takes it; raises TooFewPointsError."""
    from svc_ros.core.registration import prepare

    return prepare(read(folder, path), opened(folder)[1])


@lru_cache(maxsize=_SCANS)
def described(folder: str, path: str) -> Any:
    """A scan with its features; raises TooFewPointsError."""
    from svc_ros.core.registration import extract_features

    return extract_features(read(folder, path), opened(folder)[1])


if __name__ == "__main__":
    main()
