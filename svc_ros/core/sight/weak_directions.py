"""Which ways of moving the agreeing surfaces hardly resist: shifts along a line, turns about one, with their names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from svc_ros.core.scan import Array, frozen_array

if TYPE_CHECKING:  # it brings numba, which the help of the command line does without
    from svc_ros.core.sight.observability import SurfaceContact

_NEARLY_PARALLEL = 0.985  # cosine of 10 deg: nearer to an axis it is called by the axis
_OF_TURNS = 0.25  # surfaces face the sensor that sees them, and so resist turns by less than shifts wherever it stands
_STRAY = 1e-3  # share of points that may face any way: what only they resist is free


class Motion(str, Enum):
    """The two ways in which a pose can be off."""

    SHIFT = "shift"
    TURN = "turn"


_AXES = {Motion.SHIFT: ("x", "y", "z"), Motion.TURN: ("roll", "pitch", "yaw")}
_WORDS = {Motion.SHIFT: "along", Motion.TURN: "about"}


@dataclass(frozen=True, eq=False)
class WeakDirection:
    """A shift along `vector` or a turn about it, (3,) unit in the target frame, of either sign.

    strength: of the way that the agreeing points would move, the share (of squares) that leads off the surfaces: 0
    where nothing resists; surfaces that face all ways evenly resist a shift by 1/3.
    """

    motion: Motion
    vector: Array
    strength: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "vector", frozen_array(self.vector, np.float64, "WeakDirection.vector", (3,)))

    @property
    def name(self) -> str:
        """x, y, z, roll, pitch or yaw if it is within 10 deg of that axis, else `along` or `about` and the vector."""
        longest = int(np.abs(self.vector).argmax())
        if abs(self.vector[longest]) >= _NEARLY_PARALLEL:
            return _AXES[self.motion][longest]
        return f"{_WORDS[self.motion]} {' '.join(f'{v + 0.0:.2f}' for v in self.vector.round(2))}"


def find_weak_directions(contact: SurfaceContact, limit: float) -> tuple[WeakDirection, ...]:
    """The shifts that the contact resists by less than `limit`, and the turns by less than a quarter of that.

    Shifts first, and of each kind those along axes, in their order.

    A shift is asked about with the scan's attitude held; a turn with its place free, so that it is the turn itself,
    about whatever line suits it best. Without a single agreeing point all six are weak.
    """
    information = contact.about_the_middle() / max(contact.num_points, 1)
    shifts, coupling = information[:3, :3], information[3:, :3]
    turns = information[3:, 3:] - coupling @ np.linalg.solve(shifts + _STRAY * np.eye(3), coupling.T)
    lever = contact.lever_m2 + 1e-9 * max(np.trace(contact.lever_m2), 1.0) * np.eye(3)  # of points on one line, too
    return (*_weak(Motion.SHIFT, shifts, np.eye(3), limit), *_weak(Motion.TURN, turns, lever, _OF_TURNS * limit))


def names_of(directions: Sequence[WeakDirection]) -> str:
    """Their names, separated by commas; empty for none."""
    return ", ".join(direction.name for direction in directions)


def _weak(motion: Motion, resistance: Array, way: Array, limit: float) -> list[WeakDirection]:
    """Of the motions v those with v' resistance v < limit * v' way v; both (3, 3), way positive definite."""
    to_way = np.linalg.inv(np.linalg.cholesky(way))
    shares, vectors = np.linalg.eigh(to_way @ resistance @ to_way.T)
    spanning = np.linalg.qr(to_way.T @ vectors[:, shares < limit])[0].T
    found = []
    for vector in _readable_basis(spanning, resistance):
        signed = vector * np.copysign(1.0, vector[np.abs(vector).argmax()])
        share = float(signed @ resistance @ signed / (signed @ way @ signed))
        found.append(WeakDirection(motion, signed, max(share, 0.0)))
    return found


def _readable_basis(spanning: Array, resistance: Array) -> list[Array]:
    """Unit vectors at right angles that span the same as the rows of `spanning` (D, 3).

    Coordinate axes as far as they lie in it: which of all directions of a floor noise makes the weakest tells nobody
    anything. What is left of it by its main directions.
    """
    left = spanning.T @ spanning
    along_axes = []
    for k in np.flatnonzero(np.diag(left) >= _NEARLY_PARALLEL**2):
        axis = left[:, k] / np.linalg.norm(left[:, k])
        along_axes.append(axis)
        left = left - np.outer(axis, axis)
    num_left = len(spanning) - len(along_axes)
    if num_left == 0:
        return along_axes
    rest = np.linalg.eigh(left)[1][:, 3 - num_left :]
    return [*along_axes, *(rest @ np.linalg.eigh(rest.T @ resistance @ rest)[1]).T]
