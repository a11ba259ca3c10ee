"""Does a speed-up change any answer? Every pair and every labelled pose by this tree and by an older commit.

    python benchmarks/same_answers.py --before GIT_REF [--limit N] [--data DIR] [--out DIR] [--workers N]

The commit is checked out into a folder of its own, which is removed at the end. Writes the section `same_answers` of
latest.json; ends with 1 if a verdict or a pose differs, with 2 if the two could not be compared. Without --before
nothing is compared.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lib.common import PROJECT_ROOT, Dataset, console, describe_run, parse_options, print_table, read_datasets
from lib.latest import record
from lib.pairs import choose, evenly
from rich.console import Console
from rich.progress import Progress

BOUND = 1e-6  # of any entry of a pose: metres, or entries of the rotation matrix
HEAD = ("set", "answers", "other verdict", "other reason", "other pose", "pose, at most", "probability, at most")
RUNNER = Path(__file__).parent / "lib" / "answers_of.py"
COMPARED = ("verdict", "reason", "best_candidate", "probability")
_ALL = sys.maxsize
Answer = Mapping[str, Any]


class NotComparableError(RuntimeError):
    """One of the two has no answers, or not to all questions."""


def main() -> int:
    """Ask both, compare, print, write."""
    options = parse_options("Compare the answers of this tree with those of a commit.", extend)
    if options.before is None:
        console.print("--before names the commit to compare with; nothing compared")
        return 0
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # by way of all that cleans up
    datasets = read_datasets(options.data)
    run, jobs = describe_run(datasets), [job for d in datasets for job in jobs_of(d, options.limit)]
    try:
        with checked_out(PROJECT_ROOT, options.before) as (tree, commit):
            before, after = ask([tree, PROJECT_ROOT], jobs, options.workers)
        found = compare(jobs, before, after)
    except NotComparableError as error:
        print(f"same_answers: {error}", file=sys.stderr)
        return 2
    show(found, f"this tree beside {options.before} ({commit[:12]})")
    values = {"before": {"ref": options.before, "commit": commit}, "limit": options.limit, "bound": BOUND, **found}
    record(options.out, "same_answers", run, {"same_answers": values})
    return int(found["verdicts_differ"] + found["poses_differ"] > 0)


def extend(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--before", metavar="GIT_REF", help="commit, tag or branch whose answers are expected")
    parser.add_argument("--limit", type=int, metavar="N", help="pairs, negatives and labelled pairs a set; all if none")


def jobs_of(dataset: Dataset, limit: int | None) -> list[dict[str, Any]]:
    """What `lib/answers_of.py` is asked about a set: its pairs, its negatives, its labelled poses, grey ones too."""
    limit = limit or _ALL
    asked: list[tuple[Any, Any]] = [(pair, None) for pair in choose(dataset, limit)]
    asked += [(p, [c.T_target_source.tolist() for c in p.candidates]) for p in evenly(dataset.candidates, limit)]
    return [
        {"set": dataset.name, "folder": str(dataset.root.resolve()), "source": pair.source, "target": pair.target,
         "poses": poses} for pair, poses in asked
    ]  # fmt: skip


@contextlib.contextmanager
def checked_out(root: Path, ref: str) -> Iterator[tuple[Path, str]]:
    """A folder with the tree of a commit, and the commit's hash; the folder is removed whatever happens.

    Raises NotComparableError where `root` is no checkout or the commit is unknown.
    """
    top = git(root, f"{root}: expected a git checkout", "rev-parse", "--show-toplevel")
    if Path(top).resolve() != root.resolve():
        raise NotComparableError(f"{root}: expected a git checkout of its own, found a folder of {top}")
    known = ("rev-parse", "--verify", "--quiet", "--end-of-options", f"{ref}^{{commit}}")
    commit = git(root, f"--before {ref}: no such commit in {root}", *known)
    with tempfile.TemporaryDirectory(prefix="same_answers_") as name:
        tree = Path(name).resolve() / "tree"
        try:
            git(root, f"{commit}: cannot be checked out", "worktree", "add", "--detach", "--quiet", str(tree), commit)
            yield tree, commit
        finally:
            command = ("git", "worktree", "remove", "--force", "--force", str(tree))
            subprocess.run(command, cwd=root, capture_output=True, check=False)


def git(root: Path, complaint: str, *words: str) -> str:
    """What git answers; NotComparableError with the complaint where it fails."""
    try:
        done = subprocess.run(("git", *words), cwd=root, capture_output=True, text=True, check=False)
    except OSError as error:
        raise NotComparableError(f"{complaint}: {error}") from None
    if done.returncode:
        raise NotComparableError(": ".join(filter(None, (complaint, " ".join(done.stderr.split())))))
    return done.stdout.strip()


def ask(trees: Sequence[Path], jobs: Sequence[Mapping[str, Any]], workers: int) -> list[list[Answer]]:
    """The answers of each tree; `workers` processes work at a time, each for one tree."""
    with tempfile.TemporaryDirectory(prefix="same_answers_") as name:
        folder = Path(name)
        (folder / "jobs.json").write_text(json.dumps(jobs), encoding="utf-8")
        parts = max(1, min(workers, len(jobs)))
        outputs = [[folder / f"{k}_{part}.jsonl" for part in range(parts)] for k in range(len(trees))]
        waiting = [
            ([sys.executable, str(RUNNER), str(tree), str(folder / "jobs.json"), str(part), str(parts)], output)
            for tree, of_tree in zip(trees, outputs, strict=True) for part, output in enumerate(of_tree)
        ]  # fmt: skip
        run_all(waiting, parts, len(trees) * sum(len(questions(job)) for job in jobs))
        return [[json.loads(line) for output in of_tree for line in lines_of(output)] for of_tree in outputs]


def questions(job: Mapping[str, Any]) -> list[tuple[str, int | None]]:
    """Calls and numbers of poses; a pair is registered twice, from raw points and from features made before."""
    if job["poses"] is None:
        return [("register", None), ("register_reused", None)]
    return [("verify", number) for number in range(len(job["poses"]))]


def run_all(commands: Sequence[tuple[list[str], Path]], at_a_time: int, total: int) -> None:
    """Run all commands, each printing into its file; where one fails or Ctrl-C is pressed the others end too."""
    waiting = list(commands)
    running: list[tuple[subprocess.Popen[bytes], Path]] = []
    environment = {**os.environ, **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")}
    with Progress(console=Console(stderr=True), transient=True) as progress, contextlib.ExitStack() as cleanup:
        bar = progress.add_task("answers", total=total)
        while waiting or running:
            while waiting and len(running) < at_a_time:
                command, output = waiting.pop(0)
                running.append((start(command, output, environment, cleanup), output))
            time.sleep(0.1)
            for process, output in [pair for pair in running if pair[0].poll() is not None]:
                running.remove((process, output))
                if process.returncode:
                    said = output.with_suffix(".log").read_text(encoding="utf-8", errors="replace").strip()
                    raise NotComparableError(f"{process.args!r}: ended with {process.returncode}\n{said}")
            progress.update(bar, completed=sum(len(lines_of(output)) for _, output in commands))


def start(
    command: list[str], output: Path, environment: Mapping[str, str], cleanup: contextlib.ExitStack
) -> subprocess.Popen[bytes]:
    """A process that is gone when the cleanup is done."""
    with output.open("wb") as out, output.with_suffix(".log").open("wb") as log:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=log, env=environment)
    cleanup.callback(process.wait)
    cleanup.callback(process.kill)
    return process


def lines_of(path: Path) -> list[str]:
    """Lines written so far."""
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []


def compare(jobs: Sequence[Mapping[str, Any]], before: Sequence[Answer], after: Sequence[Answer]) -> dict[str, Any]:
    """Counts and largest differences, of all answers and by set, and the answers that differ.

    Raises NotComparableError where a question has only one answer or none.
    """
    asked = {(k, *question): job for k, job in enumerate(jobs) for question in questions(job)}
    old, new = ({(a["job"], a["call"], a["pose"]): a for a in answers} for answers in (before, after))
    for key, job in asked.items():
        if not (key in old and key in new):
            side = "after" if key in old else "before"
            raise NotComparableError(f"{named({**job, 'call': key[1], 'pose': key[2]})}: no answer {side}")
    rows = [
        {"set": job["set"], "source": job["source"], "target": job["target"], "call": key[1], "pose": key[2],
         **difference(old[key], new[key])} for key, job in asked.items()
    ]  # fmt: skip
    by_set = {name: summarise([row for row in rows if row["set"] == name]) for name in {r["set"]: 0 for r in rows}}
    counts = {"by_call": dict(Counter(row["call"] for row in rows)),
              "by_reason": dict(Counter(row["after"]["reason"] for row in rows))}  # fmt: skip
    told = [{name: value for name, value in row.items() if name not in _FLAGS} for row in rows if differs(row)]
    return {**summarise(rows), **counts, "by_set": by_set, "differ": told}


_FLAGS = ("other_verdict", "other_reason", "other_pose")


def difference(before: Answer, after: Answer) -> dict[str, Any]:
    """Two answers to the same question. A pose on one side only differs, by no number; a probability by 1."""
    poses = before["best_candidate"], after["best_candidate"]
    by = None if None in poses else float(np.abs(np.subtract(*poses)).max())
    shares = before["probability"], after["probability"]
    one_share = float(shares[0] is not shares[1]) if None in shares else abs(shares[0] - shares[1])
    return {
        "other_verdict": before["verdict"] != after["verdict"],
        "other_reason": before["reason"] != after["reason"],
        "other_pose": poses != (None, None) if by is None else not by <= BOUND,
        "pose_difference": by, "probability_difference": one_share,
        "before": {name: before[name] for name in COMPARED}, "after": {name: after[name] for name in COMPARED},
    }  # fmt: skip


def differs(row: Mapping[str, Any]) -> bool:
    """Anything of the answer is another one, beyond the bound."""
    return any(row[name] for name in _FLAGS) or not row["probability_difference"] <= BOUND


def summarise(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """How many answers differ, and by how much at most."""
    return {
        "items": len(rows),
        "verdicts_differ": sum(row["other_verdict"] for row in rows),
        "reasons_differ": sum(row["other_reason"] for row in rows),
        "poses_differ": sum(row["other_pose"] for row in rows),
        "max_pose_difference": max((row["pose_difference"] or 0.0 for row in rows), default=0.0),
        "max_probability_difference": max((row["probability_difference"] for row in rows), default=0.0),
    }


def show(found: Mapping[str, Any], title: str) -> None:
    """A table, one row a set; the largest differences with their power of ten."""
    rows = [(name, *list(values.values())[:4], *(f"{v:.1e}" for v in list(values.values())[4:6]))
            for name, values in (*found["by_set"].items(), ("all", found))]  # fmt: skip
    print_table(title, HEAD, rows)
    for row in found["differ"]:
        verdicts = (f"{row[side]['verdict']} ({row[side]['reason']})" for side in ("before", "after"))
        one_sided = (row["before"]["best_candidate"] is None) != (row["after"]["best_candidate"] is None)
        by = "a pose of one only" if one_sided else f"pose by {row['pose_difference'] or 0.0:.1e}"
        by += f", probability by {row['probability_difference']:.1e}"
        console.print(f"{named(row)}: {' / '.join(verdicts)}, {by}", highlight=False, soft_wrap=True)


def named(row: Mapping[str, Any]) -> str:
    """Which question it is."""
    call = row["call"] if row["pose"] is None else f"{row['call']} of pose {row['pose']}"
    return f"{row['set']}: {row['source']} -> {row['target']}: {call}"


if __name__ == "__main__":
    sys.exit(main())
