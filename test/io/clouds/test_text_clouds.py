"""Clouds as text: whatever is between the values and before the points, and each way of being broken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scan_file_checks import POINTS, assert_read, assert_refused, write

from svc_ros.io.clouds.files import read_scan
from svc_ros.io.clouds.text import points_from_text


def rows(form: str, decimal: str = ".") -> str:
    """A line a point; `form` has three %s, or {i} for the number of the point."""
    texts = [[f"{value:g}".replace(".", decimal) for value in point] for point in POINTS.tolist()]
    return "".join(form.format(i=k) % tuple(values) for k, values in enumerate(texts))


REVERSED = "".join(f"7 {z:g} {y:g} {x:g}\n" for x, y, z in POINTS.tolist())
READ = {
    "blanks": rows("%s %s %s\n"),
    "columns of text": rows("  %10s %10s %10s  \n"),
    "tabs": rows("%s\t%s\t%s\n"),
    "commas": rows("%s,%s,%s\n"),
    "commas and blanks": rows("%s, %s, %s\n"),
    "semicolons": rows("%s;%s;%s\n"),
    "a mix": rows("%s ,\t%s ; %s\n"),
    "Windows": rows("%s %s %s\r\n"),
    "old Mac": rows("%s %s %s\r"),
    "no last line end": rows("%s %s %s\n").rstrip(),
    "blank lines": "\n\n" + rows("%s %s %s\n\n"),
    "more columns": rows("%s %s %s 255 0 1e-3\n"),
    "comments": "# made by hand\n// 2024\n" + rows("%s %s %s\n") + "# end\n",
    "names": "x,y,z\n" + rows("%s,%s,%s\n"),
    "names in quotes": '"x","y","z","class name"\n' + rows('%s,%s,%s,"oak tree"\n'),
    "names in any order": "intensity Z Y X\n" + REVERSED,
    "names in a comment": "# intensity z y x\n" + REVERSED,
    "a remark on some of the columns": "# x y z\n" + rows("%s %s %s 1 2\n"),
    "names after a byte order mark": "\ufeffX;Y;Z\r\n" + rows("%s;%s;%s\r\n"),
    "CloudCompare": "//X Y Z R G B\n4\n" + rows("%s %s %s 1 2 3\n"),
    "CloudCompare with commas": "//X,Y,Z,Scalar field\n" + rows("%s,%s,%s,7\n"),
    "ParaView": '"i","Points:0","Points:1","Points:2"\n' + rows("{i},%s,%s,%s\n"),
    "a row index": ",x,y,z\n" + rows("{i},%s,%s,%s\n"),
    "units": "x [m],y [m],z [m]\n" + rows("%s,%s,%s\n"),
    "times as text": "time,x,y,z\n" + rows("2024-01-01 10:00:00,%s,%s,%s\n"),
    "Leica": "4\n" + rows("%s %s %s -1200 1 2 3\n"),
    "decimal commas": rows("%s;%s;%s\n", ","),
    "decimal commas and names": "x;y;z\n" + rows("%s;%s;%s\n", ","),
    "decimal commas and tabs": rows("%s\t%s\t%s\n", ","),
    "Excel": "sep=;\nx;y;z\n" + rows("%s;%s;%s\n"),
    "no numbers": rows("%s %s %s\n") + "nan nan nan\ninf 0 0\n-Infinity NaN 1\n",
    "empty values": rows("%s,%s,%s,\n") + "1,,3,4\n",
    "text that is no ASCII": "x,y,z,name\n" + rows("%s,%s,%s,Bäume\n"),
}


@pytest.mark.parametrize("name", READ)
def test_text(tmp_path: Path, name: str) -> None:
    assert_read(write(tmp_path / "scan.csv", READ[name]))


@pytest.mark.parametrize("suffix", [".xyz", ".TXT", ".asc", ".csv", ".pts"])
def test_suffixes_promise_nothing_of_the_separator(tmp_path: Path, suffix: str) -> None:
    for name in ("blanks", "semicolons", "CloudCompare", "Leica"):
        assert_read(write(tmp_path / f"scan{suffix}", READ[name]))


LINES = rows("%s %s %s\n")
REFUSED: dict[str, tuple[str | bytes, str]] = {
    "nothing": ("\n\n", "lines of numbers, found none"),
    "prose": ("this is\nno cloud\n", "one field 'x', found 0 in: this, is"),
    "short line": (LINES + "\n1 2\n", "3 values a point, found 2 at line 6"),
    "long line": ("x y z\n" + LINES + "1 2 3 4\n", "3 values a point, found 4 at line 6"),
    "a word": (LINES + "# more\n1 two 3\n", "found text: 'two' at line 6"),
    "two columns": ("1 2\n3 4\n", "at least three values a point, found 2 at line 1"),
    "other names": ("a,b,c\n" + rows("%s,%s,%s\n"), "one field 'x', found 0 in: a, b, c"),
    "more names than values": ("x y z i\n" + LINES, "4 values a point (x, y, z, i), found 3 at line 2"),
    "names twice": ("x y z X Y Z\n" + rows("%s %s %s 1 2 3\n"), "one field 'x', found 2"),
    "millimetres": ("x (mm),y (mm),z (mm)\n" + rows("%s,%s,%s\n"), "expected metres, found x in 'mm'"),
    "millimetres in a comment": ("# x[mm] y[mm] z[mm]\n" + LINES, "expected metres, found x in 'mm'"),
    "a trajectory": (rows("1700000000.5 %s %s %s 0 0 0 1\n"), "found values beyond 1e+07; name them"),
    "line numbers": (rows("{i} %s %s %s\n"), "found the number of the line; name them"),
    "commas of both kinds": ("1,5,2,5,3,5\n" * 3, "found 6 whole numbers a line, which can be both"),
    "fewer than told": ("5\n" + LINES, "expected 5 lines of points, found 4"),
    "a grid": ("ncols 4\nnrows 2\n1 2 3 4\n5 6 7 8\n", "at least three values"),
    "a molecule": ("4\nwater\n" + rows("C %s %s %s\n"), "one field 'x'"),
    "UTF-16": (LINES.encode("utf-16"), "found UTF-16"),
    "a picture": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "bytes that are no text"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_text_that_is_no_cloud(tmp_path: Path, name: str) -> None:
    content, cause = REFUSED[name]
    assert_refused(write(tmp_path / "scan.txt", content), "expected", cause)


def test_columns_that_are_named_win_over_a_line_of_names(tmp_path: Path) -> None:
    for head in ("", "a b c d\n", "x y z i\n"):
        path = write(tmp_path / "scan.txt", head + REVERSED)
        np.testing.assert_array_equal(read_scan(path, "i,z,y,x").points, POINTS)


def test_names_tell_other_lines_of_numbers(tmp_path: Path) -> None:
    path = write(tmp_path / "scan.txt", rows("{i} %s %s %s\n"))
    np.testing.assert_array_equal(read_scan(path, "number x y z").points, POINTS)


def test_many_lines_keep_their_values() -> None:
    points = np.round(np.random.default_rng(0).normal(size=(20_000, 3)) * 100, 4)
    text = "x,y,z,i\n" + "".join(f"{x:.4f},{y:.4f},{z:.4f},7\n" for x, y, z in points.tolist())
    np.testing.assert_array_equal(np.stack(points_from_text(text.encode(), None).xyz, axis=1), points)
