"""What a listener writes down is what a reader reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from livox_messages import fast_cdr

from svc_ros.core.errors import InputError
from svc_ros.io.clouds.livox import LIVOX_TYPE
from svc_ros.io.clouds.point_cloud2 import scan_from_cloud
from svc_ros.io.heard import Arrival, Endpoint, Heard, read_heard, write_heard


def test_round_trip(tmp_path: Path) -> None:
    endpoint = Endpoint("/driver", LIVOX_TYPE, "best effort", "volatile", 5)
    arrivals = (Arrival(12, 11, "livox", 3, 100, 7, 13), Arrival(22, 21, "", 0, 40))
    kept = {1: fast_cdr(np.ones((3, 3)), [0, 1, 2], 21), 0: b""}
    heard = Heard(
        "/points", 2.5, LIVOX_TYPE, (endpoint,), (endpoint, endpoint), arrivals, 4, ("/a",), 3, "here", "cure", kept
    )
    write_heard(tmp_path, heard)
    assert read_heard(tmp_path) == heard


def test_kept_messages_are_clouds_with_their_arrivals() -> None:
    arrivals = tuple(Arrival(k, k, "livox", 3, 100) for k in range(3))
    kept = {k: fast_cdr(np.full((3, 3), k), [0, 1, 2], k) for k in (2, 1)}
    clouds = list(Heard("/points", 1.0, LIVOX_TYPE, arrivals=arrivals, kept=kept).clouds())
    assert [arrival.received_ns for arrival, _ in clouds] == [1, 2]
    assert [scan_from_cloud(cloud).scan.points[0, 0] for _, cloud in clouds] == [1.0, 2.0]


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected the notes of a listener"):
        read_heard(tmp_path)
