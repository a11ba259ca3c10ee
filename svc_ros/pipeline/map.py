"""A map that lasts: keyframes of earlier runs where they stood, read from a folder, found by place and by look."""

from __future__ import annotations

import dataclasses
import threading
from collections import OrderedDict
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from svc_ros.core.config import Config
from svc_ros.core.scan import Array, IndexArray
from svc_ros.io.maps.layout import MapGraph, Session
from svc_ros.io.maps.reading import MapFiles, check_preprocess
from svc_ros.io.maps.writing import MapWriter
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.place import PlaceLook
from svc_ros.pipeline.place_search import PlaceIndex

_MAX_KEPT = 64  # keyframes in memory, with what was computed of them


class Map:
    """Keyframes where they stood; safe for use from several threads, and a context that closes it.

    Scans stay on disk and are read when they are asked for; the last of them are kept. Where a keyframe
    stands is `T_map_scan`, and as a Keyframe's `T_odom_scan` it is that, too: the map is the frame of both.
    """

    def __init__(self, files: MapFiles) -> None:
        self._files = files
        self._kept: OrderedDict[int, Keyframe] = OrderedDict()
        self._lock = threading.Lock()
        self._index = PlaceIndex(files.looks)
        self._places = cKDTree(files.graph.poses[:, :3, 3])

    @classmethod
    def read(cls, folder: str | Path) -> Map:
        """Open a map. Raises InputError naming the file, what was expected and found, for a folder that is none, for
        one of another version, and for files that are missing, cut off or changed."""
        return cls(MapFiles(Path(folder)))

    def __len__(self) -> int:
        return len(self._files.graph.poses)

    @property
    def folder(self) -> Path:
        """Where its files are."""
        return self._files.folder

    @property
    def config(self) -> Config:
        """That the keyframes were made with; scans that are held against them need the same preprocessing."""
        return self._files.config

    @property
    def runs(self) -> list[Session]:
        """The runs that the map was made of, by number."""
        return self._files.sessions

    @property
    def graph(self) -> MapGraph:
        """Poses, covariances, and what they were optimised from."""
        return self._files.graph

    @property
    def poses(self) -> Array:
        """(N, 4, 4) [m], T_map_scan of every keyframe."""
        return self._files.graph.poses

    @property
    def covariances(self) -> Array:
        """(N, 6, 6) of the errors of the poses: x y z [m], then rotations about x y z [rad]."""
        return self._files.graph.covariances

    @property
    def stamps_ns(self) -> IndexArray:
        """(N,) stamps of the scans."""
        return self._files.stamps_ns

    @property
    def sessions(self) -> IndexArray:
        """(N,) numbers of the runs that the keyframes are of, from 0 on."""
        return self._files.session_of

    def check_fits(self, config: Config) -> None:
        """Raise InputError unless that configuration prepares scans as the map's own does."""
        check_preprocess(self.folder, config.preprocess, dataclasses.asdict(self.config.preprocess))

    def keyframe(self, index: int) -> Keyframe:
        """One keyframe. Raises InputError where its part of the files is broken."""
        with self._lock:
            keyframe = self._kept.pop(index, None)
            if keyframe is None:
                keyframe = Keyframe(self._files.scan(index), self.poses[index], self.config)
            self._kept[index] = keyframe
            if len(self._kept) > _MAX_KEPT:
                self._kept.popitem(last=False)
            return keyframe

    def near(self, T_map_scan: ArrayLike, radius_m: float, most: int) -> list[int]:
        """At most so many keyframes that stand within a radius of a pose (4, 4), the nearest first."""
        place = np.asarray(T_map_scan, np.float64)[:3, 3]
        found = np.sort(np.asarray(self._places.query_ball_point(place, radius_m), np.int64))
        distance = np.linalg.norm(self.poses[found, :3, 3] - place, axis=1)
        return [int(k) for k in found[np.argsort(distance, kind="stable")[:most]]]

    def similar(self, look: PlaceLook, most: int) -> list[tuple[int, float]]:
        """At most so many keyframes whose places look most like this one, and how alike in [0, 1], best first."""
        return self._index.most_alike(look, most)

    def copy_into(self, writer: MapWriter, first_session: int) -> None:
        """Write all keyframes into another map, as runs of numbers from `first_session` on."""
        for index in range(len(self)):
            with self._lock:
                scan = self._files.scan(index)
            writer.add(scan, self._files.looks[index], first_session + int(self.sessions[index]))

    def __enter__(self) -> Map:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the files back; keyframes that are held stay usable."""
        self._files.close()
