"""Places that files are going to be written to."""

from __future__ import annotations

import tempfile
from pathlib import Path

from svc_ros.core.errors import InputError


def check_place(name: str, path: str | Path) -> None:
    """Refuse a file's place before the work starts, not after it; nothing is left there.

    name: the option or parameter that gave the path. Raises InputError: expected, found, and what to do.
    """
    place = Path(path).absolute()
    if place.is_dir():
        raise InputError(f"{name} {path}: expected a file, found a folder: name a file in it")
    if not place.parent.is_dir():
        folder = place.parent
        raise InputError(f"{name} {path}: expected a folder {folder}, found that it does not exist: create it first")
    try:
        if place.exists():
            place.open("ab").close()
        else:
            tempfile.TemporaryFile(dir=place.parent).close()
    except OSError as error:
        what = f"expected {place if place.exists() else place.parent} to be writable, found: {error.strerror}"
        raise InputError(f"{name} {path}: {what}; change its permissions, or name another place") from None
