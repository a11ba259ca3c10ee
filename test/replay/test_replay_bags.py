"""Several bags: which are meant, what their folders are called, what they say together."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from replay_cases import job

from svc_ros.core.errors import InputError
from svc_ros.replay.bags import expand_bags, folder_names, jobs_of, write_common_summary


def make_bags(folder: Path) -> None:
    for name in ("b", "a"):
        (folder / name).mkdir(parents=True)
        (folder / name / "metadata.yaml").write_text("")
        (folder / name / f"{name}.mcap").write_text("")
    for name in ("c.bag", "reference.txt"):
        (folder / name).write_text("")
    (folder / "empty").mkdir()


def test_patterns_give_bags_only_sorted_and_once(tmp_path: Path) -> None:
    make_bags(tmp_path)
    expected = [tmp_path / name for name in ("a", "b", "c.bag")]
    assert expand_bags([f"{tmp_path}/*"]) == expected
    assert expand_bags([str(tmp_path / "c.bag"), f"{tmp_path}/*"]) == [expected[2], *expected[:2]]
    assert expand_bags([f"{tmp_path}/[ab]"]) == expected[:2]
    assert expand_bags([f"{tmp_path}/**/c.bag"]) == [tmp_path / "c.bag"]
    (tmp_path / "again").symlink_to(tmp_path / "a")
    assert expand_bags([f"{tmp_path}/a*"]) == [tmp_path / "a"]


def test_a_file_of_a_bag_folder_is_taken_where_it_is_named(tmp_path: Path) -> None:
    make_bags(tmp_path)
    assert expand_bags([f"{tmp_path}/a/a.mcap"]) == [tmp_path / "a" / "a.mcap"]


def test_a_name_with_brackets_is_a_name_where_it_exists(tmp_path: Path) -> None:
    (tmp_path / "run[1].bag").write_text("")
    assert expand_bags([str(tmp_path / "run[1].bag")]) == [tmp_path / "run[1].bag"]


def test_nothing_that_matches_is_an_error(tmp_path: Path) -> None:
    make_bags(tmp_path)
    with pytest.raises(InputError, match=r"\*\.txt: expected bags, found nothing"):
        expand_bags([f"{tmp_path}/*.txt"])


@pytest.mark.parametrize(
    ("bags", "names"),
    [
        (["x/a", "x/b.bag"], ["a", "b"]),
        (["day1/bag", "day2/bag"], ["day1_bag", "day2_bag"]),
        (["site/day1/bag", "other/day1/bag", "site/day2/bag"], ["site_day1_bag", "other_day1_bag", "site_day2_bag"]),
    ],
)
def test_folders_are_called_like_the_bags(bags: list[str], names: list[str]) -> None:
    assert folder_names([Path(bag) for bag in bags]) == names


def test_the_same_bag_twice_has_no_two_names() -> None:
    with pytest.raises(InputError, match=r"x/a: expected bags with different names"):
        folder_names([Path("x/a"), Path("x/b"), Path("x/a")])


def test_one_bag_leaves_its_outputs_in_the_folder_itself(tmp_path: Path) -> None:
    whole = job(Path("ignored"), tmp_path)
    assert [j.out for j in jobs_of([Path("a.bag")], whole)] == [tmp_path]
    assert [(j.bag, j.out) for j in jobs_of([Path("a.bag"), Path("b")], whole)] == [
        (Path("a.bag"), tmp_path / "a"),
        (Path("b"), tmp_path / "b"),
    ]


def test_the_common_summary(tmp_path: Path) -> None:
    jobs = jobs_of([Path(name) for name in "abcd"], job(Path("ignored"), tmp_path))
    each = {
        "state": "complete", "num_scans": 4, "num_decisions": 3, "verdicts": {"accepted": 2, "rejected": 1},
        "reasons": {"ok": 2, "low_overlap": 1}, "recorded_s": 6.0, "wall_time_s": 2.0, "real_time_factor": 3.0,
        "reference": {"num_false_accepted": 1}, "false_loops": 1,
    }  # fmt: skip
    other = {**each, "wall_time_s": 1.0, "reasons": {"ok": 3}, "state": "interrupted"}
    summaries, errors = {tmp_path / "a": each, tmp_path / "b": other}, {tmp_path / "c": "c: it is truncated"}
    found = write_common_summary(tmp_path, jobs, summaries, errors)
    assert json.loads((tmp_path / "summary.json").read_text()) == found
    assert (found["num_bags"], found["num_scans"], found["num_decisions"]) == (2, 8, 6)
    assert found["verdicts"] == {"accepted": 4, "rejected": 2}
    assert found["reasons"] == {"ok": 5, "low_overlap": 1}
    assert found["real_time_factor"] == pytest.approx(4.0)
    assert (found["num_false_accepted"], found["false_loops"]) == (2, 2)
    assert found["interrupted"]
    assert (found["num_failed"], found["num_not_begun"]) == (1, 1)
    assert [(run["out"], run["state"]) for run in found["runs"]] == [
        ("a", "complete"), ("b", "interrupted"), ("c", "failed"), ("d", "not begun")
    ]  # fmt: skip
    assert found["runs"][2]["error"] == "c: it is truncated"
