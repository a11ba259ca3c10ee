"""Where a map goes: refused before the work if it cannot go there, and swapped so that no failure loses one."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path
from types import TracebackType

from svc_ros.core.errors import InputError
from svc_ros.io.maps.layout import ARRAYS, CONFIG, DESCRIPTION, FORMAT, file_name

_FILES = {DESCRIPTION, CONFIG, *(file_name(array) for array in ARRAYS)}


def check_map_place(out: Path) -> Path:
    """The folder that is meant, with all links followed.

    Raises InputError unless a map can be written there: a new folder, an empty one, or that of a map and nothing else,
    which is neither a mount point nor the folder that the process works in: these cannot be exchanged for another one.
    """
    try:
        place = out.resolve()
        is_folder, exists = place.is_dir(), place.exists()
        entries = sorted(entry.name for entry in place.iterdir()) if is_folder else []
    except (OSError, RuntimeError) as error:  # a link that leads to itself is one or the other
        raise InputError(f"{out}: cannot be read: {error}") from None
    if exists and not is_folder:
        raise InputError(f"{out}: expected a folder, found a file in its place")
    foreign = [name for name in entries if name not in _FILES]
    if foreign or (entries and not _is_description(place / DESCRIPTION)):
        raise InputError(
            f"{out}: expected a new folder, an empty one, or that of a map, found one with other files: "
            f"{(foreign or entries)[0]}"
        )
    if place == Path.cwd() or (is_folder and place.is_mount()):
        found = "the folder that this runs in" if place == Path.cwd() else "a mount point"
        raise InputError(f"{out}: expected a folder that a map can take the place of, found {found}: name one in it")
    return place


class MapPlace:
    """A folder `work` beside the place of a map, gone afterwards. For `with`; InputError as check_map_place."""

    def __init__(self, out: Path) -> None:
        self._out, self._place, self._holds_a_map = out, check_map_place(out), False
        try:
            self._place.parent.mkdir(parents=True, exist_ok=True)
            self.work = Path(tempfile.mkdtemp(prefix=f".{self._place.name}.", dir=self._place.parent))
        except OSError as error:
            raise InputError(f"{out}: cannot be written: {error.strerror}") from None

    def __enter__(self) -> MapPlace:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        if not self._holds_a_map:
            shutil.rmtree(self.work, ignore_errors=True)

    def put(self, folder: Path) -> None:
        """Move a whole map out of `work` to its place; a map that is there leaves it.

        Where that fails the old one stays or comes back, and InputError says where the new one is.
        """
        replaced = self.work / "replaced"
        self._holds_a_map = True
        try:
            check_map_place(self._out)  # hours have passed
            if self._place.exists():
                self._place.rename(replaced)
            folder.rename(self._place)
        except BaseException as error:
            kept = f"the new map is whole: {folder}"
            if replaced.exists() and not self._place.exists():
                try:
                    replaced.rename(self._place)
                except OSError:
                    kept += f", the old one, too: {replaced}"
            if not isinstance(error, (OSError, InputError)):
                self._holds_a_map = replaced.exists() and not self._place.exists()
                raise
            reason = error.strerror if isinstance(error, OSError) else error
            raise InputError(f"{self._out}: cannot be written: {reason}; {kept}") from None
        self._holds_a_map = False


def _is_description(path: Path) -> bool:
    """Of a map, of whatever version."""
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(found, dict) and found.get("format") == FORMAT
