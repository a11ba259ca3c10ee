"""Tables of the pages: cells are text, columns of numbers stand to the right."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Row = Sequence[str]


def table(head: Row, rows: Iterable[Row]) -> str:
    """A Markdown table."""
    rows = list(rows)
    right = ["---:" if all(_is_number(row[k]) for row in rows) else "---" for k in range(len(head))]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, right, *rows))


def share(value: float | None) -> str:
    """Three decimals, nothing for None."""
    return "" if value is None else f"{value:.3f}"


def whole(value: float | None) -> str:
    """No decimals, nothing for None."""
    return "" if value is None else f"{value:.0f}"


def _is_number(cell: str) -> bool:
    return cell.replace(" of ", "").replace(" to ", "").strip("+-.0123456789 ") == "" and "-" not in cell[1:2]
