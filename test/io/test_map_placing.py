"""Where maps go: nothing but a map is replaced, no failure loses one, what cannot work is refused before the work."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from svc_ros.core.errors import InputError
from svc_ros.io.maps.layout import FORMAT
from svc_ros.io.maps.placing import MapPlace, check_map_place


def write_map(folder: Path, version: int = 1) -> Path:
    """What is enough to be taken for a map."""
    folder.mkdir()
    (folder / "map.json").write_text(json.dumps({"format": FORMAT, "version": version}))
    (folder / "points.npy").write_text("")
    return folder


def version_of(folder: Path) -> int:
    return int(json.loads((folder / "map.json").read_text())["version"])


def put_new(out: Path) -> None:
    with MapPlace(out) as place:
        place.put(write_map(place.work / "new", 2))


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_new_and_empty_folders_and_maps_are_taken(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    write_map(tmp_path / "map")
    for name in ("empty", "map", "new", "in/new"):
        put_new(tmp_path / name)
        assert version_of(tmp_path / name) == 2
    assert names(tmp_path) == ["empty", "in", "map", "new"]


def test_only_a_map_is_replaced(tmp_path: Path) -> None:
    letters, tiles, notes = tmp_path / "letters", tmp_path / "tiles", write_map(tmp_path / "notes")
    letters.mkdir()
    tiles.mkdir()
    (letters / "letter.txt").write_text("dear")
    (tiles / "map.json").write_text('{"tiles": 3}')
    (notes / "sub").mkdir()
    (notes / "sub" / "bag.db3").write_text("data")
    for folder, entry in ((letters, "letter.txt"), (tiles, "map.json"), (notes, "sub")):
        with pytest.raises(InputError, match=f"or that of a map, found one with other files: {entry}"):
            put_new(folder)
    assert (notes / "sub" / "bag.db3").read_text() == "data"
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="found a file in its place"):
        put_new(tmp_path / "file")
    assert names(tmp_path) == ["file", "letters", "notes", "tiles"]


def test_links_are_followed(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    for link, folder in (("link", "real"), ("dangling", "nowhere")):
        put_new(tmp_path / link)
        assert (tmp_path / link).is_symlink()
        assert version_of(tmp_path / folder) == 2
    (tmp_path / "round").symlink_to(tmp_path / "round")
    with pytest.raises(InputError, match="round"):
        put_new(tmp_path / "round")


def test_what_no_folder_can_take_the_place_of_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"\.: expected .* found the folder that this runs in: name one in it"):
        check_map_place(Path("."))
    (tmp_path / "disk").mkdir()
    monkeypatch.setattr(Path, "is_mount", lambda path: path.name == "disk")
    with pytest.raises(InputError, match="found a mount point"):
        MapPlace(tmp_path / "disk")
    assert names(tmp_path) == ["disk"]


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_swap_that_fails_leaves_the_old_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException
) -> None:
    out, real = write_map(tmp_path / "map"), Path.rename

    def rename(path: Path, target: Path) -> Path:
        if path.name == "new":
            raise failure
        return real(path, target)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises((InputError, KeyboardInterrupt)) as raised:
        put_new(out)
    assert version_of(out) == 1
    if isinstance(failure, OSError):
        assert "No space left on device; the new map is whole: " in str(raised.value)
        assert version_of(Path(str(raised.value).rsplit(": ", 1)[1])) == 2
    else:
        assert names(tmp_path) == ["map"]


def test_neither_map_is_lost_where_the_old_one_cannot_come_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, real = write_map(tmp_path / "map"), Path.rename

    def rename(path: Path, target: Path) -> Path:
        if path != out:
            raise OSError(5, "Input/output error")
        return real(path, target)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(
        InputError, match=r"Input/output error; the new map is whole: .*new, the old one, too: .*replaced"
    ):
        put_new(out)
    (work,) = tmp_path.iterdir()
    assert [version_of(work / name) for name in ("new", "replaced")] == [2, 1]
