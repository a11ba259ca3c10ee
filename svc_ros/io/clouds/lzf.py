"""LZF, the compression inside PCD files of DATA binary_compressed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.compiling import kernel
from svc_ros.core.errors import UnsupportedCloudError

_MOST_EXPANSION = 88  # three bytes stand for 264 at most


def lzf_decompress(packed: NDArray[np.uint8], num_bytes: int) -> NDArray[np.uint8]:
    """Expand to exactly `num_bytes`; UnsupportedCloudError if the stream is cut, broken or of another length."""
    if num_bytes > _MOST_EXPANSION * len(packed):  # before memory is asked for
        raise UnsupportedCloudError(f"LZF: {len(packed)} compressed bytes cannot hold the expected {num_bytes}")
    out = np.empty(num_bytes, np.uint8)
    written = _expand(packed, out)
    if written != num_bytes:
        found = "a broken stream" if written < 0 else str(written)
        raise UnsupportedCloudError(f"LZF: expected {num_bytes} bytes from the compressed data, found {found}")
    return out


@kernel(error_model="python")
def _expand(packed: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Return the bytes written, -1 where the stream reaches beyond either array."""
    i, o = 0, 0
    while i < len(packed):
        control = int(packed[i])
        length = control + 1 if control < 32 else (control >> 5) + 2
        i += 1
        if control < 32:  # a run of literal bytes
            source = i
            i += length
            if i > len(packed) or o + length > len(out):
                return -1
            for k in range(length):
                out[o + k] = packed[source + k]
        else:  # a repetition of what was written before, which may overlap itself
            if length == 9 and i < len(packed):
                length += int(packed[i])
                i += 1
            if i >= len(packed):
                return -1
            source = o - ((control & 31) << 8) - int(packed[i]) - 1
            i += 1
            if source < 0 or o + length > len(out):
                return -1
            for k in range(length):
                out[o + k] = out[source + k]
        o += length
    return o
