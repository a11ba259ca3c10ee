"""docs/map.md tells files, fields and types of a map: each is held against the layout."""

from __future__ import annotations

import json

import numpy as np
from pages import code, rows
from places import PROJECT_ROOT

from svc_ros.io.maps.layout import ARRAYS, file_name

SIZES = (
    "keyframes", "points", "size_mb", "read_s", "search_ms_p50", "search_ms_p95", "search_processor_ms_p50",
    "search_processor_ms_p95", "before_mb", "read_mb", "searched_mb", "visited_mb", "optimise_s",
)  # fmt: skip
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


def test_sizes_are_those_that_were_measured():
    found = json.loads((PROJECT_ROOT / "benchmarks" / "results" / "map-size.json").read_text("utf-8"))
    told = [row[1] for row in rows("map size", PAGE)]
    assert told == [f"{found[name]:.2f}" if found[name] < 1.0 else f"{found[name]:.0f}" for name in SIZES]


def test_recalls_are_those_that_were_measured():
    results = json.loads((PROJECT_ROOT / "benchmarks" / "results" / "place-search.json").read_text("utf-8"))["results"]
    measured = [
        [name, label, *(f"{row[f'recall at {k}']:.2f}" for k in (1, 5, 10)), f"{row['ms a scan']:.1f}"]
        for name, result in results.items()
        for label, row in result["rows"].items()
    ]
    assert rows("place search", PAGE) == measured
