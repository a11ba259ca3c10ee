"""LZF streams: right ones, cut ones, and any noise."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from lzf_compression import lzf_compress

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.clouds.lzf import lzf_decompress


@pytest.mark.parametrize("data", [b"", b"a", b"abc" * 100, bytes(5000), np.random.default_rng(0).bytes(3000)])
def test_lzf_expands_what_was_compressed(data: bytes) -> None:
    packed = np.frombuffer(lzf_compress(data), np.uint8)
    assert lzf_decompress(packed, len(data)).tobytes() == data


def test_lzf_survives_any_short_stream() -> None:
    outcomes = set()
    streams = [*itertools.product(range(0, 256, 17), repeat=3), *itertools.product([0, 31, 32, 224], repeat=4)]
    for packed in streams:
        try:
            outcomes.add(len(lzf_decompress(np.array(packed, np.uint8), 2)))
        except UnsupportedCloudError:
            outcomes.add(-1)
    assert outcomes == {2, -1}


def test_lzf_of_another_length() -> None:
    packed = np.frombuffer(lzf_compress(b"hello hello hello"), np.uint8)
    for size in (0, 16, 18):
        with pytest.raises(UnsupportedCloudError, match=f"expected {size} bytes"):
            lzf_decompress(packed, size)
