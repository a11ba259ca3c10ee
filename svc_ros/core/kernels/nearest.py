"""Hot loops of the nearest-neighbour search within a fixed radius, compiled by numba; no GIL, no state.

Cells no smaller than the radius stand in columns along z. Every column holds the points of the columns around it too,
so that a query reads one run of memory; LANES points lie side by side, so that they are compared at once. Twins in
test/support/reference.py.
"""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel

LANES, LEVELS = 16, 2  # LEVELS: cells that are as high, together, as the radius
_SHIFT = 4  # log2(LANES)
_STEPS = 2.0**25  # squared distances are compared in so many steps of the squared radius

_jit = kernel()


@_jit
def fill_levels(points, shape, columns, levels, spans):  # type: ignore[no-untyped-def]
    """Column of the padded grid and level of every point, and the extent of every column; returns the cells' number.

    shape: as in find_nearest; columns, levels (N,); spans (C + 1, 2): first cell of each column (the number of all
    cells at the end), lowest level of its points and of those around it.
    """
    padded = int(shape[5]) + 2
    num_columns = spans.shape[0] - 1
    high = np.full(num_columns, -(1 << 30), np.int32)
    spans[:, 1] = 1 << 30
    for i in range(points.shape[0]):
        a, b = int((points[i, 0] - shape[0]) / shape[3]), int((points[i, 1] - shape[1]) / shape[3])
        columns[i], levels[i] = (a + 1) * padded + b + 1, int((points[i, 2] - shape[2]) / shape[6])
        for row in range(-padded, padded + 1, padded):
            for column in range(columns[i] + row - 1, columns[i] + row + 2):
                spans[column, 1] = min(spans[column, 1], levels[i])
                high[column] = max(high[column], levels[i])
    total = 0
    for column in range(num_columns):
        spans[column, 0] = total
        total += max(high[column] - spans[column, 1] + 1, 0)
    spans[num_columns, 0] = total
    return total


@_jit
def fill_blocks(points, shape, columns, levels, spans, starts, blocks, names):  # type: ignore[no-untyped-def]
    """starts (cells + 1,): first entry of every cell; blocks (B, 3, LANES), names (B, LANES): nine entries a point.

    columns, levels, spans: from fill_levels; blocks are filled up by what they hold already.
    """
    padded = int(shape[5]) + 2
    starts[:] = 0
    for i in range(points.shape[0]):
        for row in range(-padded, padded + 1, padded):
            for column in range(columns[i] + row - 1, columns[i] + row + 2):
                starts[spans[column, 0] + levels[i] - spans[column, 1] + 1] += 1
    for cell in range(starts.shape[0] - 1):
        starts[cell + 1] += starts[cell]
    for i in range(points.shape[0]):
        for row in range(-padded, padded + 1, padded):
            for column in range(columns[i] + row - 1, columns[i] + row + 2):
                cell = spans[column, 0] + levels[i] - spans[column, 1]
                block, lane = starts[cell] >> _SHIFT, starts[cell] & (LANES - 1)
                starts[cell] += 1
                names[block, lane] = i
                for axis in range(3):
                    blocks[block, axis, lane] = points[i, axis] - shape[axis]
    for cell in range(starts.shape[0] - 1, 0, -1):
        starts[cell] = starts[cell - 1]
    starts[0] = 0


@_jit
def find_nearest(queries, radius, shape, spans, starts, blocks, names, nearest):  # type: ignore[no-untyped-def]
    """nearest (M,): name of the point nearest to each query and nearer than the radius, or -1.

    shape: (x, y, z of the grid's corner, edge of a column, columns along x, columns along y, height of a cell), the
    edge not below the radius. Distances are told apart to the thousandth part of the radius, or better.
    """
    num_x, padded = shape[4] + 2.0, int(shape[5]) + 2
    across, up = 1.0 / shape[3], 1.0 / shape[6]
    scale, farthest, limit = np.float32(_STEPS / (radius * radius)), np.float32(2.0 * _STEPS), int(_STEPS)
    for m in range(queries.shape[0]):
        nearest[m] = -1
        px, py, pz = queries[m, 0] - shape[0], queries[m, 1] - shape[1], queries[m, 2] - shape[2]
        u, v = px * across + 1.0, py * across + 1.0
        if not (0.0 <= u < num_x and 0.0 <= v < padded and abs(pz) * up < 1e9):
            continue
        column = int(u) * padded + int(v)
        first, low = spans[column, 0], spans[column, 1]
        cells = spans[column + 1, 0] - first
        if cells == 0:
            continue
        from_cell = max(int(np.floor((pz - radius) * up)) - low, 0)
        to_cell = min(int(np.floor((pz + radius) * up)) - low, cells - 1)
        if from_cell > to_cell:
            continue
        begin, end = starts[first + from_cell], starts[first + to_cell + 1]
        x, y, z = np.float32(px), np.float32(py), np.float32(pz)
        best, where = np.int32(2**31 - 1), 0
        for block in range(begin >> _SHIFT, (end + LANES - 1) >> _SHIFT):
            least = np.int32(2**31 - 1)
            for lane in range(LANES):  # the lane stands in the last bits, so that the smallest number tells it
                dx, dy, dz = blocks[block, 0, lane] - x, blocks[block, 1, lane] - y, blocks[block, 2, lane] - z
                steps = np.int32(min((dx * dx + dy * dy + dz * dz) * scale, farthest))
                least = np.int32(min(least, np.int32((steps << np.int32(_SHIFT)) | np.int32(lane))))
            nearer = (least >> _SHIFT) < (best >> _SHIFT)
            where, best = block if nearer else where, least if nearer else best
        if best >> _SHIFT < limit:
            nearest[m] = names[where, best & (LANES - 1)]
