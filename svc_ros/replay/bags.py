"""Several bags: which ones are meant, where each leaves its outputs, and what they say together."""

from __future__ import annotations

import dataclasses
import glob
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from svc_ros.core.errors import InputError
from svc_ros.io.bags.files import STORAGE_SUFFIXES, is_bag_folder
from svc_ros.replay.job import SUMMARY, ReplayJob
from svc_ros.replay.summary import combine, versions

_SUFFIXES = (".bag", ".active", *STORAGE_SUFFIXES)  # the last but these is what a ROS 1 recorder left


def expand_bags(patterns: Sequence[str]) -> list[Path]:
    """The bags that are named or match a pattern (*, ?, [...], ** for folders below), matches sorted, none twice.

    Of what a pattern matches, only what looks like a bag counts. Raises InputError for a name or pattern without one.
    """
    found: dict[Path, Path] = {}
    for pattern in patterns:
        matches = [Path(pattern)]
        if not Path(pattern).exists() and glob.has_magic(pattern):
            matches = [path for path in map(Path, sorted(glob.glob(pattern, recursive=True))) if _looks_like_bag(path)]
            if not matches:
                raise InputError(f"{pattern}: expected bags, found nothing that matches and is one")
        for path in matches:
            found.setdefault(path.resolve(), path)
    return list(found.values())


def _looks_like_bag(path: Path) -> bool:
    if path.is_dir():
        return is_bag_folder(path)
    # a file of a bag folder belongs to that bag
    return path.suffix in _SUFFIXES and not is_bag_folder(path.parent)


def jobs_of(bags: Sequence[Path], job: ReplayJob) -> list[ReplayJob]:
    """The job for every bag: one bag leaves its outputs in `job.out` itself, several in a folder each below it."""
    if len(bags) == 1:
        return [dataclasses.replace(job, bag=bags[0])]
    names = folder_names(bags)
    return [dataclasses.replace(job, bag=bag, out=job.out / name) for bag, name in zip(bags, names, strict=True)]


def folder_names(bags: Sequence[Path]) -> list[str]:
    """A name for each: that of the bag without suffix, with as many folders before it as tell all of them apart."""
    parts = [[*path.resolve().parts[1:-1], path.stem] for path in bags]
    for depth in range(1, max((len(part) for part in parts), default=0) + 1):
        names = ["_".join(part[-depth:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    twice = Counter(str(path) for path in bags).most_common(1)[0][0]
    raise InputError(f"{twice}: expected bags with different names, found it twice")


def write_common_summary(
    out: Path, jobs: Sequence[ReplayJob], summaries: Mapping[Path, Mapping[str, Any]], errors: Mapping[Path, str]
) -> dict[str, Any]:
    """Write what several bags say together into out/summary.json, and return it.

    summaries: of the bags that were replayed, by their output folders; errors: why others were not, in the same way;
    a bag with neither was not begun.
    """
    done = [summaries[job.out] for job in jobs if job.out in summaries]
    whole: dict[str, Any] = {
        "bags": [str(job.bag) for job in jobs],
        **combine(done),
        "num_failed": len(errors),
        "num_not_begun": len(jobs) - len(done) - len(errors),
        "versions": versions(),
        "runs": [_run(job, summaries.get(job.out), errors.get(job.out)) for job in jobs],
    }
    text = json.dumps(whole, indent=2, allow_nan=False) + "\n"
    try:
        (out / SUMMARY).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{out / SUMMARY}: cannot be written: {error.strerror}") from None
    return whole


def _run(job: ReplayJob, summary: Mapping[str, Any] | None, error: str | None) -> dict[str, Any]:
    names = ("num_scans", "num_decisions", "verdicts", "reasons", "real_time_factor", "false_loops", "chosen", "damage")
    known = {} if summary is None else {name: summary[name] for name in names if name in summary}
    state = "failed" if error is not None else "not begun" if summary is None else summary["state"]
    return {"bag": str(job.bag), "out": job.out.name, "state": state, **known, **({"error": error} if error else {})}
