"""The correspondences of a pair, each set matched when somebody asks for it."""

from __future__ import annotations

from typing import Protocol

from svc_ros.core.matches.descriptors import more_matches
from svc_ros.core.matches.features import compute_features
from svc_ros.core.matches.matching import match
from svc_ros.core.pair import Pair
from svc_ros.core.scan import Correspondences, Features


class Matcher(Protocol):
    """Where the correspondences of a pair come from."""

    def few(self) -> list[Correspondences]:
        """Of a part of the points; all where there are few of them."""

    def all(self) -> list[Correspondences]:
        """Of all points, a set of each descriptor."""

    @property
    def alone(self) -> bool:
        """Whether nothing but these correspondences may lead to a pose."""


class Given:
    """Correspondences computed elsewhere: they take the place of all that is found in the scans."""

    alone = True

    def __init__(self, correspondences: Correspondences) -> None:
        self._correspondences = correspondences

    def few(self) -> list[Correspondences]:
        """All of them."""
        return self.all()

    def all(self) -> list[Correspondences]:
        """As they were given."""
        return [self._correspondences]


class Described:
    """Correspondences by FPFH, and by further descriptors where any are configured."""

    alone = False

    def __init__(self, pair: Pair, known: tuple[Features | None, Features | None]) -> None:
        self._pair = pair
        self._all: list[Correspondences] | None = None
        with pair.watch.stage("features"):
            self._features = tuple(
                compute_features(scan, pair.config) if features is None else features
                for scan, features in zip((pair.source, pair.target), known, strict=True)
            )

    def few(self) -> list[Correspondences]:
        """Of about `matching.first_points` of either scan; all where neither has more, or that is 0."""
        first = self._pair.config.matching.first_points
        return [self._match(first)] if 0 < first < max(map(len, self._features)) else self.all()

    def all(self) -> list[Correspondences]:
        """Of all points: FPFH first, then each of `matching.more_descriptors`."""
        if self._all is None:
            self._all = [self._match(None), *self._match_otherwise()]
        return self._all

    def _match(self, num_points: int | None) -> Correspondences:
        source, target = self._features
        with self._pair.watch.stage("matching"):
            return match(source, target, self._pair.config.matching, num_points)

    def _match_otherwise(self) -> list[Correspondences]:
        pair = self._pair
        if not pair.config.matching.more_descriptors:
            return []
        with pair.watch.stage("more_matches"):
            found = more_matches(pair.source, pair.target, pair.config)
        pair.counts["more_correspondences"] = sum(map(len, found))
        return found
