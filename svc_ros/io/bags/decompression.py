"""What bags are compressed with, undone without believing how much a damaged file says that it holds."""

from __future__ import annotations

import bz2
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
NONE = ("", "none")
_STEP = 1 << 20
_DECODERS: dict[str, Callable[[], Any]] = {
    "zstd": zstd.ZstdDecompressor,
    "lz4": lz4.frame.LZ4FrameDecompressor,
    "bz2": bz2.BZ2Decompressor,
}
COMPRESSIONS = frozenset({*NONE, *_DECODERS})


def decompress(data: bytes, compression: str, most: int) -> bytes:
    """What `data` hold, at most `most` bytes; less where they end early. ValueError where they are damaged.

    Memory grows with what there really is, not with `most`.
    """
    if compression in NONE:
        return data[:most]
    parts, left = [], most
    try:
        decoder = _DECODERS[compression]()
        while left > 0:
            piece = decoder.decompress(data, max_length=min(left, _STEP))
            parts.append(piece)
            left -= len(piece)
            data = b""
            if decoder.eof:
                if not decoder.unused_data:
                    break
                data, decoder = decoder.unused_data, _DECODERS[compression]()
            elif not piece and decoder.needs_input:
                break
    except Exception as error:  # each library has its own
        raise ValueError(f"what it holds is no {compression}") from error
    return b"".join(parts)


def unpack_file(packed: Path, unpacked: Path) -> bool:
    """Write what a zstd file holds, as far as it is intact; False where that is not all."""
    decoder: Any = zstd.ZstdDecompressor()
    with packed.open("rb") as source, unpacked.open("wb") as target:
        while True:
            if decoder.eof:
                data = decoder.unused_data or source.read(_STEP)
                if not data:
                    return True
                decoder = zstd.ZstdDecompressor()
            else:
                data = source.read(_STEP) if decoder.needs_input else b""
                if not data and decoder.needs_input:
                    return False
            try:
                target.write(decoder.decompress(data, max_length=_STEP))
            except (zstd.ZstdError, MemoryError):
                return False
