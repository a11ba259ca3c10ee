"""The comparison of two trees' answers: what counts as another answer, and that nothing is left behind."""

from __future__ import annotations

import contextlib
import copy
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mini_data import write_dataset
from places import PROJECT_ROOT
from yardstick import PATIENCE_S

from svc_ros.io.datasets import read_dataset

FOLDER = PROJECT_ROOT / "benchmarks"
POSE = np.eye(4).tolist()
JOBS = [
    {"set": "street", "folder": "", "source": "a", "target": "b", "poses": None},
    {"set": "room", "folder": "", "source": "c", "target": "d", "poses": [POSE, POSE]},
]

pytestmark = pytest.mark.usefixtures("scripts")


@pytest.fixture
def same_answers(scripts):
    import same_answers

    return same_answers


def answers() -> list[dict]:
    """One to every question of JOBS."""
    asked = [(0, "register", None), (0, "register_reused", None), (1, "verify", 0), (1, "verify", 1)]
    return [
        {"job": job, "call": call, "pose": pose, "verdict": "accepted", "reason": "ok",
         "best_candidate": copy.deepcopy(POSE), "probability": 0.9} for job, call, pose in asked
    ]  # fmt: skip


def repository(folder: Path) -> Path:
    """A git repository whose file says `old` in the first commit and `new` in the second."""
    subprocess.run(["git", "init", "-q", str(folder)], check=True)
    for text in ("old", "new"):
        (folder / "file.txt").write_text(text)
        subprocess.run(["git", "add", "file.txt"], cwd=folder, check=True)
        by = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", *by, "commit", "-q", "-m", text], cwd=folder, check=True)
    return folder


def worktrees(folder: Path) -> int:
    done = subprocess.run(["git", "worktree", "list"], cwd=folder, capture_output=True, text=True, check=True)
    return len(done.stdout.splitlines())


def test_equal_answers_differ_nowhere(same_answers):
    found = same_answers.compare(JOBS, answers(), answers())
    assert found["items"] == 4
    assert found["by_call"] == {"register": 1, "register_reused": 1, "verify": 2}
    assert found["by_reason"] == {"ok": 4}
    assert {name: values["items"] for name, values in found["by_set"].items()} == {"street": 2, "room": 2}
    for values in (found, *found["by_set"].values()):
        assert {values[f"{what}_differ"] for what in ("verdicts", "reasons", "poses")} == {0}
        assert values["max_pose_difference"] == values["max_probability_difference"] == 0.0
    assert found["differ"] == []


def test_another_verdict_is_counted_in_its_set_and_told(same_answers):
    after = answers()
    after[2] |= {"verdict": "rejected", "reason": "low_overlap", "probability": 0.4}
    found = same_answers.compare(JOBS, answers(), after)
    assert (found["verdicts_differ"], found["reasons_differ"], found["poses_differ"]) == (1, 1, 0)
    assert (found["by_set"]["street"]["verdicts_differ"], found["by_set"]["room"]["verdicts_differ"]) == (0, 1)
    assert found["max_probability_difference"] == pytest.approx(0.5)
    (told,) = found["differ"]
    assert (told["set"], told["source"], told["target"], told["call"], told["pose"]) == ("room", "c", "d", "verify", 0)
    assert (told["before"]["verdict"], told["after"]["verdict"]) == ("accepted", "rejected")


@pytest.mark.parametrize(("row", "column"), [(0, 3), (1, 2)])
def test_poses_differ_beyond_the_bound_only(same_answers, row, column):
    after = answers()
    after[0]["best_candidate"][row][column] += 1e-5
    after[3]["best_candidate"][row][column] -= 1e-7
    found = same_answers.compare(JOBS, answers(), after)
    assert (found["verdicts_differ"], found["poses_differ"]) == (0, 1)
    assert found["max_pose_difference"] == pytest.approx(1e-5)
    assert found["by_set"]["room"]["max_pose_difference"] == pytest.approx(1e-7)
    assert [told["pose_difference"] for told in found["differ"]] == [pytest.approx(1e-5)]


def test_a_pose_or_probability_on_one_side_only_differs(same_answers):
    after = answers()
    after[0]["best_candidate"] = after[1]["probability"] = None
    found = same_answers.compare(JOBS, answers(), after)
    assert (found["poses_differ"], found["max_pose_difference"]) == (1, 0.0)
    assert found["max_probability_difference"] == 1.0
    assert [told["call"] for told in found["differ"]] == ["register", "register_reused"]
    assert same_answers.compare(JOBS, after, after)["differ"] == []


def test_a_missing_answer_is_an_error(same_answers):
    with pytest.raises(same_answers.NotComparableError, match="room: c -> d: verify of pose 1: no answer after"):
        same_answers.compare(JOBS, answers(), answers()[:-1])
    with pytest.raises(same_answers.NotComparableError, match="street: a -> b: register: no answer before"):
        same_answers.compare(JOBS, answers()[1:], answers())
    with pytest.raises(same_answers.NotComparableError):
        same_answers.compare(JOBS, [], [])


def test_a_commit_is_checked_out_and_removed(same_answers, tmp_path):
    root = repository(tmp_path)
    with same_answers.checked_out(root, "HEAD~1") as (tree, commit):
        assert (tree / "file.txt").read_text() == "old"
        assert commit == same_answers.git(root, "", "rev-parse", "HEAD~1")
        assert worktrees(root) == 2
    assert not tree.parent.exists()
    assert worktrees(root) == 1
    assert (root / "file.txt").read_text() == "new"


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_the_checkout_is_removed_after_an_error(same_answers, tmp_path, error):
    root, trees = repository(tmp_path), []

    def fail() -> None:
        with same_answers.checked_out(root, "HEAD") as (tree, _):
            (tree / "compiled.nbi").write_text("not of git")
            trees.append(tree)
            raise error

    with pytest.raises(error):
        fail()
    assert not trees[0].parent.exists()
    assert worktrees(root) == 1


def test_unknown_commits_and_folders_without_git_are_told(same_answers, tmp_path):
    root = repository(tmp_path / "project")
    for ref in ("nowhere", "--all"):
        with pytest.raises(same_answers.NotComparableError, match=f"--before {ref}: no such commit"):
            same_answers.checked_out(root, ref).__enter__()
    (root / "inside").mkdir()
    for folder in (tmp_path, root / "inside"):
        with pytest.raises(same_answers.NotComparableError, match="expected a git checkout"):
            same_answers.checked_out(folder, "HEAD").__enter__()


def test_a_process_that_fails_ends_the_others_and_is_quoted(same_answers, tmp_path):
    start = time.monotonic()
    commands = [
        ([sys.executable, "-c", "import time; print(1, flush=True); time.sleep(2000)"], tmp_path / "0.jsonl"),
        ([sys.executable, "-c", "import sys; sys.exit('no such scan')"], tmp_path / "1.jsonl"),
    ]
    with pytest.raises(same_answers.NotComparableError, match="ended with 1\nno such scan"):
        same_answers.run_all(commands, 2, 2)
    assert time.monotonic() - start < PATIENCE_S


def test_a_tree_without_the_package_is_refused(same_answers, tmp_path):
    with pytest.raises(same_answers.NotComparableError, match=f"expected svc_ros of {tmp_path}, found"):
        same_answers.ask([tmp_path], JOBS, 1)


def test_every_pair_negative_and_labelled_pose_is_asked(same_answers, tmp_path):
    dataset = read_dataset(write_dataset(tmp_path / "room"))
    jobs = same_answers.jobs_of(dataset, None)
    assert [(job["source"], len(job["poses"] or [])) for job in jobs] == [
        ("scans/1.bin", 0), ("scans/2.bin", 0), ("scans/few.bin", 0), ("scans/few.bin", 0), ("scans/1.bin", 3),
    ]  # fmt: skip
    assert len(same_answers.jobs_of(dataset, 1)) == 3


@pytest.mark.slow
def test_from_the_command_line_to_the_section(same_answers, monkeypatch, tmp_path, capsys):
    """Both trees are this one; then the answers of the second are changed."""
    asked, kept = same_answers.ask, []

    def ask(*arguments):
        kept.extend(asked(*arguments))
        return kept

    monkeypatch.setattr(same_answers, "ask", ask)
    write_dataset(tmp_path / "room")
    monkeypatch.setattr(same_answers, "checked_out", lambda *_: contextlib.nullcontext((PROJECT_ROOT, "abc")))
    options = ["--before", "last", "--data", str(tmp_path), "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["same_answers", *options])
    monkeypatch.setattr(same_answers.signal, "signal", lambda *_: None)
    assert same_answers.main() == 0
    found = json.loads((tmp_path / "out" / "latest.json").read_text())
    section = found["same_answers"]
    assert section["before"] == {"ref": "last", "commit": "abc"}
    assert section["by_call"] == {"register": 4, "register_reused": 4, "verify": 3}
    assert section["by_set"]["room"]["items"] == section["items"] == 11
    assert {"ok", "too_few_points"} <= section["by_reason"].keys()
    assert section["commit"] == found["runs"]["same_answers"]["commit"]

    other = [answer | {"verdict": "rejected"} for answer in kept[1]]
    monkeypatch.setattr(same_answers, "ask", lambda *_: (kept[0], other))
    assert same_answers.main() == 1
    assert "accepted (ok) / rejected (ok)" in capsys.readouterr().out


def test_what_cannot_be_compared_ends_with_two(same_answers, monkeypatch, tmp_path, capsys):
    write_dataset(tmp_path / "room")
    monkeypatch.setattr(same_answers, "PROJECT_ROOT", tmp_path)
    monkeypatch.setattr(same_answers.signal, "signal", lambda *_: None)
    options = ["--before", "HEAD", "--data", str(tmp_path), "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["same_answers", *options])
    assert same_answers.main() == 2
    assert "expected a git checkout" in capsys.readouterr().err
    monkeypatch.setattr(sys, "argv", ["same_answers", *options[2:]])
    assert same_answers.main() == 0
    assert not (tmp_path / "out" / "latest.json").exists()


@pytest.mark.slow
def test_a_real_pair_is_registered_and_its_poses_judged(same_answers, shared_data):
    dataset = read_dataset(shared_data / "pairs" / "rgbd_redkitchen")
    jobs = same_answers.jobs_of(dataset, 1)
    jobs[1]["poses"] = jobs[1]["poses"][:3]
    once, again = same_answers.ask([PROJECT_ROOT, PROJECT_ROOT], jobs, 2)
    assert [(answer["call"], answer["pose"]) for answer in sorted(once, key=lambda answer: answer["job"])] == [
        ("register", None), ("register_reused", None), ("verify", 0), ("verify", 1), ("verify", 2),
    ]  # fmt: skip
    assert any(answer["best_candidate"] is not None for answer in once)
    assert same_answers.compare(jobs, once, again)["differ"] == []
