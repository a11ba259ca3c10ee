from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svc_ros.core import se3
from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.report.links import Link, join_scans
from svc_ros.report.overview import LINK_COLOURS, draw_overview
from svc_ros.simulation.meshes import upright


def step(x: float, yaw: float = 0.0) -> np.ndarray:
    return upright(x, 0.0, 0.0, yaw)


def cloud(seed: int = 0, num_points: int = 3000) -> np.ndarray:
    return np.random.default_rng(seed).uniform((-20, -10, -2), (20, 10, 3), (num_points, 3))


def accepted(source: int, target: int, T: np.ndarray | None = None) -> Link:
    return Link(source, target, Verdict.ACCEPTED, step(2.0) if T is None else T)


def read_rgb(path: Path) -> np.ndarray:
    from matplotlib.image import imread

    return np.round(imread(path)[..., :3] * 255).astype(int)


def count_pixels(image: np.ndarray, colour: str, tolerance: int = 12) -> int:
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return int((np.abs(image - wanted).max(-1) <= tolerance).sum())


def test_accepted_links_chain_poses_in_both_directions() -> None:
    T10, T12 = step(2.0, 0.3), step(-1.0, 0.5)
    (part,) = join_scans(3, [accepted(1, 0, T10), accepted(1, 2, T12)])
    assert part.scan_idx.tolist() == [0, 1, 2]
    assert part.T_part_scan[1] == pytest.approx(T10)
    assert part.T_part_scan[2] == pytest.approx(T10 @ se3.invert(T12))


@pytest.mark.parametrize("verdict", [Verdict.REJECTED, Verdict.UNDECIDED, Verdict.DROPPED])
def test_any_other_link_breaks_the_chain(verdict: Verdict) -> None:
    parts = join_scans(4, [accepted(1, 0), Link(2, 1, verdict), accepted(3, 2)])
    assert [part.scan_idx.tolist() for part in parts] == [[0, 1], [2, 3]]
    assert all(np.array_equal(part.T_part_scan[0], np.eye(4)) for part in parts)


def test_a_scan_without_an_accepted_link_is_its_own_part() -> None:
    assert [part.scan_idx.tolist() for part in join_scans(3, [])] == [[0], [1], [2]]


def test_a_later_link_closes_a_gap() -> None:
    parts = join_scans(3, [Link(1, 0, Verdict.REJECTED), accepted(2, 1), accepted(2, 0)])
    assert [part.scan_idx.tolist() for part in parts] == [[0, 1, 2]]


def test_links_need_a_pose_exactly_if_accepted_and_scans_that_exist() -> None:
    with pytest.raises(InputError, match="belongs to an accepted verdict"):
        Link(1, 0, Verdict.REJECTED, np.eye(4))
    with pytest.raises(InputError, match="belongs to an accepted verdict"):
        Link(1, 0, Verdict.ACCEPTED)
    with pytest.raises(InputError, match="expected scans from 0 to 1"):
        join_scans(2, [accepted(2, 0)])


def test_a_result_becomes_a_link() -> None:
    result = RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP, best_candidate=step(1.0))
    link = Link.of(result, 4, 3)
    assert (link.source, link.target, link.verdict, link.T_target_source) == (4, 3, Verdict.REJECTED, None)


def test_the_picture_shows_points_and_every_verdict_in_its_colour(tmp_path: Path) -> None:
    links = [accepted(1, 0), Link(2, 1, Verdict.REJECTED), accepted(3, 2), Link(4, 3, Verdict.UNDECIDED)]
    draw_overview(tmp_path / "o.png", [cloud(k) for k in range(5)], links)
    image = read_rgb(tmp_path / "o.png")
    assert image.shape[1] == 1950
    assert image[:5].min() == 255  # white paper
    assert (image.min(-1) < 250).mean() > 0.01
    for verdict in (Verdict.ACCEPTED, Verdict.REJECTED, Verdict.UNDECIDED):
        assert count_pixels(image, LINK_COLOURS[verdict]) > 200


def test_a_run_without_rejections_has_no_red(tmp_path: Path) -> None:
    draw_overview(tmp_path / "o.png", [cloud(0), cloud(1)], [accepted(1, 0)])
    image = read_rgb(tmp_path / "o.png")
    assert count_pixels(image, LINK_COLOURS[Verdict.REJECTED]) == 0
    assert count_pixels(image, LINK_COLOURS[Verdict.ACCEPTED]) > 200


def test_walls_are_darker_than_ground(tmp_path: Path) -> None:
    flat = cloud() * [1.0, 1.0, 0.0]
    wall = cloud() * [1.0, 0.0, 2.0]
    for name, points in (("flat", flat), ("wall", wall)):
        draw_overview(tmp_path / f"{name}.png", [points], [])
    middles = [read_rgb(tmp_path / f"{name}.png")[200:-200].min(-1) for name in ("flat", "wall")]
    shades = [np.percentile(middle[middle < 250], 25) for middle in middles]
    assert shades[1] < shades[0] - 50


def test_the_same_input_gives_the_same_picture(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_overview(tmp_path / name, [cloud(0), cloud(1)], [accepted(1, 0)])
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_empty_clouds_and_no_links_can_be_drawn(tmp_path: Path) -> None:
    draw_overview(tmp_path / "o.png", [np.zeros((0, 3)), cloud()], [])
    assert (tmp_path / "o.png").stat().st_size > 5000


def test_broken_input_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least one scan"):
        draw_overview(tmp_path / "o.png", [], [])
    with pytest.raises(InputError, match=r"clouds\[1\]: expected shape N x 3"):
        draw_overview(tmp_path / "o.png", [cloud(), np.zeros((4, 2))], [])
    with pytest.raises(InputError, match="cannot be written"):
        draw_overview(tmp_path / "no" / "o.png", [cloud()], [])
