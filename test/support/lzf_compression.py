"""The other direction of LZF, for tests."""

from __future__ import annotations


def lzf_compress(data: bytes) -> bytes:
    """A slow greedy LZF: back references of 3 to 264 bytes, literal runs of up to 32."""
    out, literals, seen, i = bytearray(), bytearray(), dict[bytes, int](), 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            run = literals[start : start + 32]
            out.append(len(run) - 1)
            out.extend(run)
        literals.clear()

    while i < len(data):
        start, length = seen.get(data[i : i + 3], -1), 0
        if start >= 0 and i - start <= 8192:
            while length < 264 and i + length < len(data) and data[start + length] == data[i + length]:
                length += 1
        seen[data[i : i + 3]] = i
        if length < 3:
            literals.append(data[i])
            i += 1
            continue
        flush()
        distance, short = i - start - 1, min(length - 2, 7)
        out.append(short << 5 | distance >> 8)
        out.extend([length - 9] * (short == 7) + [distance & 255])
        i += length
    flush()
    return bytes(out)
