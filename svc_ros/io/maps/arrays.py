"""Arrays in .npy files of their own: written row by row, checked when opened, read part by part."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from svc_ros.core.errors import InputError
from svc_ros.io.npy_header import read_npy_header

Shape = tuple[int, ...]


class ArrayWriter:
    """Appends rows to a new .npy file. shape: of one row. `close` makes it a whole file; raises InputError."""

    def __init__(self, path: Path, dtype: np.dtype[Any], shape: Shape = ()) -> None:
        self._path, self._dtype, self._shape, self.num_rows = path, dtype, shape, 0
        try:
            self._file = path.open("wb")
            self._write_header()
        except OSError as error:
            raise _not_written(path, error) from None

    def append(self, rows: NDArray[Any]) -> None:
        """Write rows (n, *shape); what has another type is converted."""
        rows = np.ascontiguousarray(rows, self._dtype).reshape(-1, *self._shape)
        try:
            self._file.write(rows.tobytes())
        except OSError as error:
            raise _not_written(self._path, error) from None
        self.num_rows += len(rows)

    def close(self) -> None:
        """Write the number of rows; twice does no harm."""
        if self._file.closed:
            return
        try:
            with self._file:
                self._file.seek(0)
                self._write_header()
        except OSError as error:
            raise _not_written(self._path, error) from None

    def _write_header(self) -> None:
        """Always as long: NumPy leaves room for the largest number of rows."""
        shape = (self.num_rows, *self._shape)
        values = {"descr": npy.dtype_to_descr(self._dtype), "fortran_order": False, "shape": shape}
        npy.write_array_header_1_0(self._file, values)


class ArrayFile:
    """A .npy file that stays open, so that it is the same one even after another has taken its name.

    Raises InputError naming the file, what was expected and what was found: no such file, another format, another
    type, other rows than these, and fewer or more bytes than they take.
    """

    def __init__(self, path: Path, dtype: np.dtype[Any], shape: Shape, num_rows: int) -> None:
        self._path, self._dtype, self._shape = path, dtype, (num_rows, *shape)
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        try:
            self._check()
        except BaseException:
            self._file.close()
            raise

    def _check(self) -> None:
        path = self._path
        try:
            shape, fortran, dtype = read_npy_header(self._file)
        except ValueError as error:
            raise InputError(f"{path}: expected a .npy file, found another one: {error}") from None
        if (dtype, shape, fortran) != (self._dtype, self._shape, False):
            order = " in Fortran order" if fortran else ""
            raise InputError(
                f"{path}: expected {_shown(self._dtype)} of shape {self._shape}, found {_shown(dtype)} of shape "
                f"{shape}{order}"
            )
        self._begin = self._file.tell()
        expected, found = self._begin + int(np.prod(shape, dtype=np.int64)) * dtype.itemsize, self._file.seek(0, 2)
        if found != expected:
            raise InputError(f"{path}: expected {expected} bytes, found {found}")

    def mapped(self) -> NDArray[Any]:
        """All rows, read-only, in memory as far as they are looked at; takes a file handle for as long as it lives."""
        if 0 in self._shape:
            return np.zeros(self._shape, self._dtype)
        return np.asarray(np.memmap(self._file, self._dtype, "r", self._begin, self._shape))

    def rows(self, begin: int = 0, num: int | None = None) -> NDArray[Any]:
        """So many rows, all from `begin` on without a number, as an array of its own. For one thread at a time.

        Raises InputError where the file has become shorter since it was opened.
        """
        shape = (self._shape[0] - begin if num is None else num, *self._shape[1:])
        size, in_row = int(np.prod(shape, dtype=np.int64)), int(np.prod(shape[1:], dtype=np.int64))
        self._file.seek(self._begin + begin * in_row * self._dtype.itemsize)
        found = np.fromfile(self._file, self._dtype, size)
        if len(found) != size:
            raise InputError(f"{self._path}: expected rows up to {begin + shape[0]}, found an end before them")
        return found.reshape(shape)

    def close(self) -> None:
        """Give the file back; what is mapped stays."""
        self._file.close()


def _shown(dtype: np.dtype[Any]) -> str:
    return f"rows of {', '.join(dtype.names)}" if dtype.names else str(dtype)


def _not_written(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot be written: {error.strerror}")
