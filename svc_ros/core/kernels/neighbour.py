"""Hot loops that sort points into cells for the search of all neighbours, compiled by numba; no GIL, no state.

Cells stand in columns along z. The points of three cells above each other follow one another in memory, so that the
surroundings of a point are at most nine short runs. Twins in test/support/reference.py.
"""

from __future__ import annotations

from svc_ros.core.compiling import kernel

_jit = kernel()


@_jit
def fill_columns(columns, levels, column_low, column_first):  # type: ignore[no-untyped-def]
    """Extent of every column, from the column and level of each point, sorted by column, then level.

    column_low (C,): its lowest level; column_first (C + 1,): its first cell, the number of all cells at the end.
    """
    column_first[:] = 0
    for i in range(columns.shape[0]):
        c = columns[i]
        if i == 0 or columns[i - 1] != c:
            column_low[c] = levels[i]
        column_first[c + 1] = levels[i] - column_low[c] + 1
    for c in range(column_low.shape[0]):
        column_first[c + 1] += column_first[c]


@_jit
def fill_cells(columns, levels, column_low, column_first, starts):  # type: ignore[no-untyped-def]
    """starts (cells + 1,): first point of every cell."""
    starts[:] = 0
    for i in range(columns.shape[0]):
        starts[column_first[columns[i]] + levels[i] - column_low[columns[i]] + 1] += 1
    for cell in range(starts.shape[0] - 1):
        starts[cell + 1] += starts[cell]
