"""docs/map.md tells files, fields and types of a map: each is held against the layout."""

from __future__ import annotations

import numpy as np
from pages import code, rows
from places import PROJECT_ROOT

from svc_ros.io.maps.layout import ARRAYS, file_name

PAGE = (PROJECT_ROOT / "docs" / "map.md").read_text("utf-8")


def shown(dtype: np.dtype, shape: tuple[int, ...] = ()) -> str:
    base, inner = dtype.subdtype or (dtype, shape)
    return f"{base} {inner}" if inner else str(base)


def test_files_have_these_rows():
    told = {code(name)[0]: kind for name, _, kind, _ in rows("map files", PAGE)}
    assert told == {
        file_name(name): "fields below" if dtype.names else shown(dtype, shape)
        for name, (dtype, shape) in ARRAYS.items()
    }


def test_fields_have_these_types():
    told = [(code(file)[0], code(field)[0], kind) for file, field, kind, _ in rows("map fields", PAGE)]
    assert told == [
        (file_name(name), field, shown(dtype.fields[field][0]))
        for name, (dtype, _) in ARRAYS.items()
        for field in dtype.names or ()
    ]
