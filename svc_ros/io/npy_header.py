"""What the header of a NumPy file says of the array after it."""

from __future__ import annotations

from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

NpyHeader = tuple[tuple[int, ...], bool, np.dtype[Any]]


def read_npy_header(stream: IO[bytes]) -> NpyHeader:
    """Shape, whether it is in Fortran's order, and type; the stream stands at the array then.

    Raises ValueError saying what is wrong, for what is no header and for versions of the format other than 1 and 2.
    """
    try:
        major, minor = npy.read_magic(stream)
        if major not in (1, 2):
            raise ValueError(f"expected version 1 or 2 of NumPy's format, found {major}.{minor}")
        return (npy.read_array_header_1_0 if major == 1 else npy.read_array_header_2_0)(stream)
    except (EOFError, SyntaxError, TokenError) as error:  # the header is read as Python's source
        raise ValueError(str(error)) from None
