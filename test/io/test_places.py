"""Places that files are going to be written to are looked at before the work."""

from __future__ import annotations

import pytest

from svc_ros.core.errors import InputError
from svc_ros.io.places import check_place


def test_a_place_that_can_be_written_is_taken_and_left_as_it_is(tmp_path):
    check_place("--out", tmp_path / "new.g2o")
    assert list(tmp_path.iterdir()) == []
    old = tmp_path / "old.g2o"
    old.write_text("kept")
    check_place("--out", old)
    assert old.read_text() == "kept"


@pytest.mark.parametrize(
    ("path", "found", "cure"),
    [
        ("missing/a.g2o", "does not exist", "create it first"),
        (".", "found a folder", "name a file in it"),
        ("/proc/self/a.g2o", "expected /proc/self to be writable", "name another place"),
        ("/proc/version", "expected /proc/version to be writable", "name another place"),
    ],
)
def test_another_place_is_refused_with_what_was_found_and_what_to_do(tmp_path, path, found, cure):
    with pytest.raises(InputError, match=f"^graph_file .*{found}.*{cure}"):
        check_place("graph_file", tmp_path / path)
