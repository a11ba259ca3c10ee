"""Files as bad disks, broken transfers and full cards leave them, read one after the other in a process of its own.

What a reader does to its process (a crash, a hang, memory without end) is told with the seed that repeats it.
"""

from __future__ import annotations

import multiprocessing
import random
import resource
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from svc_ros.core.errors import SvcError

SECONDS_A_FILE = 60.0  # only gives up
_PAGE = resource.getpagesize()
_ODD_NUMBERS = [b"\x00" * 4, b"\xff" * 4, b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80", b"\x00\x00\xc0\x7f"]


def damaged(data: bytes, seed: int) -> bytes:
    """`data` with one to four kinds of damage; the same for the same seed."""
    rng = random.Random(seed)
    for _ in range(rng.randint(1, 4)):
        near_the_start = rng.random() < 0.5  # where headers are
        at = rng.randrange(min(len(data), 512) if near_the_start else len(data)) if data else 0
        length = rng.choice([1, 2, 4, 8, rng.randint(1, 64), rng.randint(1, max(1, len(data) // 4))])
        kind = rng.randrange(8)
        if kind == 0:
            data = data[:at]
        elif kind == 1:
            data = data[:at] + bytes(length) + data[at + length :]
        elif kind == 2:
            data = data[:at] + rng.randbytes(length) + data[at + length :]
        elif kind == 3:
            data = data[:at] + rng.randbytes(length) + data[at:]
        elif kind == 4:
            data = data[:at] + data[at + length :]
        elif kind == 5:
            data = data[:at] + data[at : at + length] + data[at:]
        elif kind == 6:
            data = data[:at] + rng.choice(_ODD_NUMBERS) + data[at + 4 :]
        else:  # another digit or letter where text is
            data = data[:at] + rng.choice(b"0123456789-.eE \nxyz").to_bytes(1, "little") + data[at + 1 :]
    return data


def read_damaged(
    read: Callable[[Path], object], sample: Path, folder: Path, seeds: range, most_bytes: int
) -> Counter[str]:
    """How many of the damaged copies of `sample` were `read` and how many `refused` by an SvcError that names them.

    `read`, a function of a module, is called with the path of each copy, in another process that may take `most_bytes`
    more memory than after it read the whole sample. AssertionError, with the seed, for any other error, a crash, a
    hang, or more memory.
    """
    # Not by a fork of this process: threads of libraries that have been at work here would be missing in it.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["svc_ros.io.bags", "svc_ros.io.clouds.files"])
    here, there = context.Pipe(duplex=False)
    reader = context.Process(target=_read_all, args=(read, sample, folder, seeds, most_bytes, there), daemon=True)
    reader.start()
    there.close()
    counts: Counter[str] = Counter()
    try:
        for seed in seeds:
            assert here.poll(SECONDS_A_FILE), f"{sample.name}, seed {seed}: not read in {SECONDS_A_FILE:.0f} s"
            try:
                outcome = here.recv()
            except EOFError:
                reader.join()
                raise AssertionError(f"{sample.name}, seed {seed}: the process ended with {reader.exitcode}") from None
            assert outcome in ("read", "refused"), f"{sample.name}, seed {seed}: {outcome}"
            counts[outcome] += 1
    finally:
        reader.kill()
        reader.join()
    return counts


def _read_all(
    read: Callable[[Path], object], sample: Path, folder: Path, seeds: range, most_bytes: int, results: Connection
) -> None:
    read(sample)
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * _PAGE
    resource.setrlimit(resource.RLIMIT_AS, (taken + most_bytes, resource.RLIM_INFINITY))
    whole = sample.read_bytes()
    path = folder / f"damaged{''.join(sample.suffixes)}"
    for seed in seeds:
        path.write_bytes(damaged(whole, seed))
        results.send(_outcome(read, path))


def _outcome(read: Callable[[Path], object], path: Path) -> str:
    try:
        read(path)
    except SvcError as error:
        return "refused" if path.name in str(error) else f"refused without its name: {error}"
    except BaseException as error:  # a panic of a library in Rust is no Exception
        return f"{type(error).__name__}: {error}"
    return "read"
