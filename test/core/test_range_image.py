"""Range images: every kernel equal to its slow twin, and cells that fit the pattern of the sensor."""

from __future__ import annotations

import numpy as np
import pytest
import reference_images as reference
from assertions import assert_same_bits
from image_cases import CASES, MIN_RANGE, cells_of, directions_of, raster, seen

from svc_ros.core.errors import InputError
from svc_ros.core.kernels import range_image as range_image_kernels
from svc_ros.core.range_image import (
    _LEAST_HELD,
    RangeImage,
    _build,
    _tables,
    build_range_image,
    restore_range_image,
    rows_of,
)
from svc_ros.core.scans.preprocess import estimate_beam_spacing_deg

ORIGIN = np.zeros(3)
SIZES = [(0.4, 0.4), (0.945, 0.9), (2.1, 0.4), (2.5, 2.5), (50.0, 60.0)]


@pytest.mark.parametrize("size_deg", SIZES)
@pytest.mark.parametrize("case", CASES)
def test_directions_are_in_the_cells_of_their_angles(case, size_deg):
    tables, points = _tables(size_deg), seen(CASES[case])
    columns, starts = reference.layout(size_deg)
    assert tables[2].tolist() == columns.tolist()
    assert tables[3].tolist() == starts.tolist()
    cell, length = cells_of(points, tables)
    np.testing.assert_allclose(length, np.linalg.norm(points, axis=1))
    assert reference.cell_is_right(points, cell, size_deg).all() if len(points) else True
    assert ((cell >= 0) & (cell < columns.sum())).all()


@pytest.mark.parametrize("size_deg", SIZES)
def test_borders_are_met_to_a_few_hundredths_of_a_degree(size_deg):
    """The twin that allows for them would not notice a table that is far too coarse."""
    rng = np.random.default_rng(1)
    azimuth, elevation = rng.uniform(-180, 180, 20_000), np.degrees(np.arcsin(rng.uniform(-0.9, 0.9, 20_000)))
    columns, starts = reference.layout(size_deg)
    row = reference.row_of(elevation, size_deg[0], len(columns))
    expected = starts[row] + ((azimuth / 360.0 % 1.0) * columns[row]).astype(int)
    cell, _ = cells_of(directions_of(azimuth, elevation), _tables(size_deg))
    width = 360.0 / columns[row].mean()
    assert np.mean(cell != expected) < 0.04 / size_deg[0] + 0.04 / width


@pytest.mark.parametrize("size_deg", SIZES)
@pytest.mark.parametrize("case", CASES)
def test_cells_hold_the_least_and_the_greatest_range(case, size_deg):
    tables, points = _tables(size_deg), CASES[case]
    num = int(tables[2].sum())
    near, far = np.full(num, np.inf, np.float32), np.zeros(num, np.float32)
    range_image_kernels.fill(points, ORIGIN, MIN_RANGE, tables, near, far)
    with np.errstate(over="ignore"):
        expected = reference.fill(*cells_of(seen(points), tables), num)
    assert_same_bits(near, expected[0])
    assert_same_bits(far, expected[1])


@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 0.9, 1.0])
@pytest.mark.parametrize("size_deg", [(2.5, 2.5), (5.0, 1.5), (50.0, 60.0), (90.0, 180.0)])
def test_ranges_spread_over_nine_cells(size_deg, share):
    columns, starts = reference.layout(size_deg)
    rng = np.random.default_rng(round(100 * share))
    held = rng.random(columns.sum()) < share
    near = np.where(held, rng.uniform(1, 50, len(held)), np.inf).astype(np.float32)
    far = np.where(held, near * rng.uniform(1, 2, len(held)), 0.0).astype(np.float32)
    for least_held in (1, 4, 9):
        check_spread(near, far, columns, starts, least_held)


def check_spread(near, far, columns, starts, least_held) -> None:
    wide = np.empty_like(near), np.empty_like(far)
    counts = range_image_kernels.spread(
        near, far, columns.astype(np.int32), starts.astype(np.int32), least_held, *wide
    )  # fmt: skip
    *expected, num_held, num_dense, num_seen = reference.spread(near, far, columns, starts, least_held)
    assert counts == (num_held, num_dense, num_seen)
    assert_same_bits(wide[0], expected[0])
    assert_same_bits(wide[1], expected[1])


@pytest.mark.parametrize("num_rows", [0, 1, 2, 3])
def test_images_of_few_rows_spread(num_rows):
    """Without a row above and below nothing is known: its beams may have been lost."""
    columns = np.array([7, 9, 8])[:num_rows]
    starts = np.cumsum(columns) - columns
    near = np.arange(1.0, columns.sum() + 1.0, dtype=np.float32)
    check_spread(near, near, columns, starts, 4)
    wide = np.empty_like(near), np.empty_like(near)
    range_image_kernels.spread(near, near, columns.astype(np.int32), starts.astype(np.int32), 4, *wide)
    assert (wide[1] > 0).sum() == (9 if num_rows == 3 else 0)  # of three rows the middle one


# Images


def whole_twin(points: np.ndarray, size_deg: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Least and greatest range of every cell of the sphere; the dense and the seen share of those with a point."""
    columns, starts = reference.layout(size_deg)
    near, far = reference.fill(*cells_of(seen(points), _tables(size_deg)), columns.sum())
    wide_near, wide_far, num_held, *nums = reference.spread(near, far, columns, starts, _LEAST_HELD)
    return wide_near, wide_far, *(num / max(num_held, 1) for num in nums)


def looked_up(image: RangeImage, directions: np.ndarray) -> np.ndarray:
    """Least and greatest range in each direction (N, 2), -1 where the sensor did not look."""
    cell, _ = cells_of(directions, image.tables)
    return np.column_stack([np.append(values, -1)[cell] for values in (image.near, image.far)])


@pytest.mark.parametrize("size_deg", [(2.1, 1.3), (50.0, 60.0)])
@pytest.mark.parametrize("case", [name for name in CASES if name != "beyond_float32"])
def test_an_image_of_the_used_rows_says_what_one_of_the_whole_sphere_says(case, size_deg):
    image = _build(CASES[case], ORIGIN, MIN_RANGE, size_deg)
    near, far, *shares = whole_twin(CASES[case], size_deg)
    rng = np.random.default_rng(0)
    directions = np.vstack([rng.normal(size=(3000, 3)), seen(CASES[case])[:3000], CASES["axes"]])
    whole = RangeImage(near, far, _tables(size_deg), size_deg, *shares)
    np.testing.assert_array_equal(looked_up(image, directions), looked_up(whole, directions))
    assert [image.dense_ratio, image.seen_ratio] == shares
    assert (image.near > 0).sum() == (near > 0).sum()


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("spacing_deg", [0.0, 0.3, 2.0, 30.0])
def test_every_scan_has_an_image(case, spacing_deg):
    image = build_range_image(CASES[case], ORIGIN, MIN_RANGE, spacing_deg)
    assert len(image.near) == len(image.far) == image.tables[2].sum()
    assert all(0.4 <= size <= 2.5 for size in image.size_deg)
    known = image.far > 0
    assert ((image.near > 0) == known).all()
    assert (image.near <= image.far).all()
    assert (image.far[~known] == -1).all()


@pytest.mark.parametrize(
    "case", ["none", "one", "at_the_sensor", "nearer_than_allowed", "one_ring", "one_cell", "axes"]
)
def test_too_little_to_know_anything(case):
    image = build_range_image(CASES[case], ORIGIN, MIN_RANGE, 0.5)
    assert (image.far == -1).all()
    assert (looked_up(image, np.random.default_rng(0).normal(size=(500, 3))) == -1).all()


def test_rings_that_jitter_are_looked_at_all_the_same():
    """Their beam spacing looks much smaller than it is: cells grow until rows above and below hold returns."""
    rng = np.random.default_rng(5)
    azimuth, elevation = np.meshgrid(np.arange(0.0, 360.0, 0.5), np.linspace(-40.0, 40.0, 40))
    azimuth, elevation = (np.repeat(a.ravel(), 10) for a in (azimuth, elevation))
    points = 8.0 * directions_of(azimuth, elevation) + rng.normal(0.0, 0.01, (len(azimuth), 3))
    image = build_range_image(points, np.zeros(3), MIN_RANGE, estimate_beam_spacing_deg(points, np.zeros(3)))
    assert image.seen_ratio > 0.6
    assert image.size_deg[0] > 1.0


def test_the_order_of_the_points_does_not_matter():
    rng = np.random.default_rng(2)
    for case in ("everywhere", "spinning", "depth_camera"):
        one, other = (
            build_range_image(points, ORIGIN, MIN_RANGE, 0.7) for points in (CASES[case], rng.permutation(CASES[case]))
        )
        assert one.size_deg == other.size_deg
        assert_same_bits(one.near, other.near)
        assert_same_bits(one.far, other.far)


def test_directions_are_those_from_the_sensor():
    """In sixty-fourths of a metre, so that moving loses no bit."""
    points, origin = np.round(CASES["everywhere"] * 64) / 64, np.array([130.0, -70.0, 12.0])
    here = build_range_image(points, ORIGIN, MIN_RANGE, 0.7)
    there = build_range_image(points + origin, origin, MIN_RANGE, 0.7)
    assert_same_bits(here.near, there.near)
    assert_same_bits(here.far, there.far)


@pytest.mark.parametrize(
    ("steps_deg", "high", "wide"),
    [
        ((0.9, 1.0), True, True),  # a raster that is sparser than its beams seem
        ((0.2, 0.2), False, False),
        ((0.35, 0.35), False, False),
        ((0.2, 0.9), True, False),
        ((0.9, 0.2), False, True),
    ],
)
def test_cells_grow_for_a_sparse_pattern_and_stay_for_a_dense_one(steps_deg, high, wide):
    points = 10.0 * raster(np.arange(-40, 40, steps_deg[0]), np.arange(-20, 20, steps_deg[1]))
    image = build_range_image(points, ORIGIN, MIN_RANGE, 0.3)
    assert image.dense_ratio >= 0.9
    assert max(image.size_deg) <= 1.5 * max(*steps_deg, 0.4)
    if not (high or wide):
        assert image.size_deg == (0.4, 0.4)
    elif high != wide:  # a wider or a higher cell: whichever helps
        assert max(image.size_deg) > 0.4
    else:
        assert min(image.size_deg) > 0.4 or max(image.size_deg) > 0.9


@pytest.mark.parametrize(("spacing_deg", "height"), [(0.0, 0.4), (0.3, 0.4), (1.0, 1.05), (2.0, 2.1), (9.0, 2.5)])
def test_cells_are_a_little_higher_than_beams_are_apart(spacing_deg, height):
    points = 10.0 * raster(np.arange(-180, 180, 0.1), np.arange(-15, 15, min(max(spacing_deg, 0.1), 2.0)))
    image = build_range_image(points, ORIGIN, MIN_RANGE, spacing_deg)
    assert image.size_deg == pytest.approx((height, 0.4))


def test_all_that_a_raster_looked_at_is_known_but_its_rim():
    azimuth, elevation = np.arange(-30, 30, 0.25), np.arange(-12, 12, 0.25)
    image = build_range_image(10.0 * raster(azimuth, elevation), ORIGIN, MIN_RANGE, 0.25)
    inside, beside = raster(azimuth[4:-4] + 0.1, elevation[4:-4] + 0.1), raster(azimuth, np.array([-14.0, 14.0, 60.0]))
    np.testing.assert_allclose(looked_up(image, inside), 10.0, rtol=1e-6)
    assert (looked_up(image, beside) == -1).all()


@pytest.mark.parametrize("size_deg", SIZES)
@pytest.mark.parametrize("case", CASES)
def test_an_image_of_which_the_cells_were_kept_is_the_same(case, size_deg):
    image = _build(CASES[case], ORIGIN, MIN_RANGE, size_deg)
    shares = image.dense_ratio, image.seen_ratio
    again = restore_range_image(image.near.copy(), image.far.copy(), size_deg, rows_of(image), shares)
    for table, expected in zip((*again.tables, again.near), (*image.tables, image.near), strict=True):
        assert_same_bits(table, expected)
    assert (again.size_deg, again.dense_ratio, again.seen_ratio) == (size_deg, *shares)
    with pytest.raises(InputError, match=r"range image: expected \d+ cells"):
        restore_range_image(np.append(image.near, -1), np.append(image.far, -1), size_deg, rows_of(image), shares)


def test_surfaces_behind_each_other_are_not_seen_from_one_place():
    rng = np.random.default_rng(4)
    directions = directions_of(rng.uniform(-180, 180, 40_000), rng.uniform(-30, 30, 40_000))
    near, far = 5.0 * directions[:20_000], 12.0 * directions[20_000:]

    def crossed(points):
        return build_range_image(points, ORIGIN, MIN_RANGE, 0.5).crossed_ratio

    assert crossed(near) == 0.0
    assert crossed(near * rng.uniform(1.0, 1.4, (20_000, 1))) == 0.0
    assert crossed(np.vstack([near, far])) > 0.3
    assert crossed(np.vstack([near[:40], far[:40]])) == 0.0, "too few directions tell nothing"
