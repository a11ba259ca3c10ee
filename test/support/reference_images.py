"""Slow twins of range images and of clusters in plain numpy and scipy: angles, no tables; all cells, no used rows."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

# The tables' steps: what a direction's elevation and azimuth may be off by before a cell is looked up with them.
STEP_DEG, TURN_STEP = 0.03, 0.03 / 360.0
UNSEEN, CONFIRMED, DENIED, HIDDEN, NEITHER = range(5)


def layout(size_deg: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Cells of every row (R,), from the lower pole to the upper, and the first cell of each, (R,)."""
    height, width = np.radians(size_deg)
    middles = (np.arange(int(np.ceil(np.pi / height))) + 0.5) * height - 0.5 * np.pi
    columns = np.maximum(np.round(2.0 * np.pi * np.cos(middles) / width), 4).astype(int)
    return columns, np.concatenate(([0], np.cumsum(columns)[:-1]))


def row_of(elevation_deg: np.ndarray, height_deg: float, num_rows: int) -> np.ndarray:
    """Row of each elevation."""
    return np.clip((elevation_deg + 90.0) // height_deg, 0, num_rows - 1).astype(int)


def cell_is_right(directions: np.ndarray, cell: np.ndarray, size_deg: tuple[float, float]) -> np.ndarray:
    """Whether each direction (N, 3) lies in its cell (N,), or as near to its border as the tables' steps."""
    columns, starts = layout(size_deg)
    row = np.searchsorted(starts, cell, side="right") - 1
    elevation = np.degrees(np.arctan2(directions[:, 2], np.hypot(directions[:, 0], directions[:, 1])))
    lowest, highest = (row_of(elevation + way * STEP_DEG, size_deg[0], len(columns)) for way in (-1, 1))
    turn = np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * np.pi)
    beyond_middle = (turn * columns[row] - (cell - starts[row]) - 0.5) / columns[row]
    off_middle = np.abs(beyond_middle - np.round(beyond_middle))  # in turns, whichever way is shorter
    upright = np.hypot(directions[:, 0], directions[:, 1]) == 0  # any column will do
    beside = off_middle <= 0.5 / columns[row] + TURN_STEP
    return (lowest <= row) & (row <= highest) & (upright | beside)


def fill(cell: np.ndarray, ranges: np.ndarray, num: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest range of every cell, float32; infinity and 0 where no point is."""
    near, far = np.full(num, np.inf), np.zeros(num)
    np.minimum.at(near, cell, ranges)
    np.maximum.at(far, cell, ranges)
    return near.astype(np.float32), far.astype(np.float32)


def around(row: int, col: int, columns: np.ndarray, starts: np.ndarray) -> list[list[int]]:
    """The cells around one, itself included: three of its own row, three of each row above and below that is there."""
    found = []
    for other in (row - 1, row, row + 1):
        if 0 <= other < len(columns):
            k = ((2 * col + 1) * int(columns[other])) // (2 * int(columns[row]))  # over the middle of the cell
            found.append([int(starts[other]) + (k + step) % int(columns[other]) for step in (-1, 0, 1)])
    return found


def spread(
    near: np.ndarray, far: np.ndarray, columns: np.ndarray, starts: np.ndarray, least_held: int
) -> tuple[np.ndarray, np.ndarray, int, int, int]:
    """Least and greatest range around every cell, -1 where too few hold a point or a row has none; how many of the
    cells with a point there are, have enough others, are not -1."""
    wide_near, wide_far, num_held, num_dense, num_seen = np.full_like(near, -1), np.full_like(far, -1), 0, 0, 0
    for row, num in enumerate(columns):
        for col in range(num):
            cell, rows = int(starts[row]) + col, around(row, col, columns, starts)
            held = [[k for k in cells if far[k] > 0] for cells in rows]
            all_held = [k for cells in held for k in cells]
            dense = len(all_held) >= least_held
            num_held, num_dense = num_held + (far[cell] > 0), num_dense + (dense and far[cell] > 0)
            if dense and len(rows) == 3 and all(held):
                wide_near[cell], wide_far[cell] = near[all_held].min(), far[all_held].max()
                num_seen += far[cell] > 0
    return wide_near, wide_far, int(num_held), int(num_dense), int(num_seen)


def look(
    placed: np.ndarray, cosine: np.ndarray, cell: np.ndarray, image: tuple[np.ndarray, np.ndarray],
    limits: tuple[float, float, float],
) -> np.ndarray:  # fmt: skip
    """What an observer at 0, 0, 0 saw of each placed point (M, 3): one of the names above, (M,).

    cosine: (M,) of the angle to the normal of the observer's point that each lies on, NaN where it lies on none; cell:
    (M,), -1 where the image has none; limits: as the kernel's.
    """
    near, far = (np.append(values.astype(float), -1.0)[cell] for values in image)
    ranges = np.linalg.norm(placed, axis=1)
    alone = np.isnan(cosine)
    before = near - ranges > limits[0] + limits[1] * ranges
    on_own = np.where(cosine > limits[2], CONFIRMED, NEITHER)
    off_own = np.where(before, DENIED, np.where(ranges > far, HIDDEN, NEITHER))
    return np.where(far <= 0, UNSEEN, np.where(alone, off_own, on_own))


def clusters(points: np.ndarray, edge: float) -> np.ndarray:
    """The first point of the cluster of each point (N, 3): components of the graph of cells that touch."""
    if len(points) == 0:
        return np.zeros(0, int)
    cells, of_point = np.unique(np.floor((points - points[0]) / edge), axis=0, return_inverse=True)
    touching = cKDTree(cells).query_pairs(1.5, p=np.inf, output_type="ndarray")
    graph = coo_matrix((np.ones(len(touching)), touching.T), shape=(len(cells),) * 2)
    component = connected_components(graph, directed=False)[1][of_point.ravel()]
    first = np.full(component.max() + 1, len(points))
    np.minimum.at(first, component, np.arange(len(points)))
    return first[component]


def sum_by_extent(points: np.ndarray, labels: np.ndarray, whole_angle: float) -> float:
    """Points of every cluster times the share of the whole angle that its box fills at its mean distance, at most 1."""
    total = 0.0
    for name in np.unique(labels):
        members = points[labels == name]
        diagonal = np.linalg.norm(np.ptp(members, axis=0))
        mean = max(np.linalg.norm(members, axis=1).mean(), 1e-9 / len(members))
        total += len(members) * min(1.0, diagonal / mean / whole_angle)
    return total
