"""What a sensor saw of surface that a pose puts before it: confirmed, looked through, hidden, or not looked at.

A scan that is placed rightly shows surface which the other sensor either saw too, or could not see. Surface that it
looked through, because it measured something farther away in that direction, is denied: its share of all surface that
the sensor could see does not depend on the sensor's field of view, nor on the overlap or the range.
"""

from __future__ import annotations

import math

import numpy as np

from svc_ros.core.config import SightViewConfig
from svc_ros.core.kernels import cluster as cluster_kernels
from svc_ros.core.kernels import range_image as range_image_kernels
from svc_ros.core.scan import IndexArray, PreparedScan
from svc_ros.core.se3 import apply
from svc_ros.core.sight.evidence import SeenSurface
from svc_ros.core.sight.placement import Placement

_CLUSTER_VOXELS = 2.0  # edge of the cells that gather denied points: neighbours of one surface are a voxel apart


def look_through(observer: PreparedScan, placement: Placement, config: SightViewConfig) -> SeenSurface:
    """The other scan's surface, placed before the observer, held against the observer's range image.

    Where it did not look, nothing is said. Points on the observer's own surface are confirmed where both face the same
    way; of those on none are denied that stand before the least range around their direction by more than the margins
    for noise.
    """
    other, image = placement.other, observer.range_image
    if image is None:
        return SeenSurface(len(other), 0, np.zeros(0, np.int64), 0.0, 0, len(other))
    names = np.empty(len(other), np.int64)
    limits = (
        config.denied_margin * config.tolerance_m, config.denied_margin_per_range, config.same_side_cosine
    )  # fmt: skip
    num_confirmed, num_denied, num_hidden, num_unseen = range_image_kernels.look(
        placement.T_observer_other, other.points, other.normals, placement.nearest, observer.normals,
        observer.sensor_origin, limits, (image.near, image.far, image.tables), names,
    )  # fmt: skip
    denied = names[:num_denied]
    weighed = _weigh_clusters(observer, placement, denied, config)
    return SeenSurface(len(other), num_confirmed, denied, weighed, num_hidden, num_unseen)


def _weigh_clusters(observer: PreparedScan, placement: Placement, denied: IndexArray, config: SightViewConfig) -> float:
    """How many points are denied, those of a cluster counting by the angle over which the observer sees it.

    What moved between the scans is seen as small clusters, and so are edges and mixed pixels; a wall that is in the
    wrong place is a wide one.
    """
    if len(denied) == 0:
        return 0.0
    placed = apply(placement.T_observer_other, placement.other.points[denied]) - observer.sensor_origin
    labels = np.empty(len(denied), np.int64)
    cluster_kernels.label(placed, _CLUSTER_VOXELS * placement.other.voxel_size_m, labels)
    return float(cluster_kernels.sum_by_extent(placed, labels, math.radians(config.wide_cluster_deg)))
