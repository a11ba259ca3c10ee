"""Fast point feature histograms (FPFH), one a point, of unit length (method section 5)."""

from __future__ import annotations

import numpy as np

from svc_ros.core.config import Config
from svc_ros.core.scan import Features, PreparedScan


def compute_features(prepared: PreparedScan, config: Config) -> Features:
    """Describe every prepared point by its FPFH (K, 33), L2-normalised; a point without neighbours gets zeros."""
    import open3d as o3d

    tensor = o3d.core.Tensor.from_numpy  # shares memory and asks for arrays that may be written to: hence the copies
    cloud = o3d.t.geometry.PointCloud(tensor(prepared.points.copy()))
    cloud.point.normals = tensor(prepared.normals.copy())
    # The tensor API takes half the time of the legacy one and releases the GIL.
    histogram = o3d.t.pipelines.registration.compute_fpfh_feature(
        cloud, max_nn=config.features.max_neighbours, radius=config.feature_radius_m
    ).numpy()
    histogram = np.nan_to_num(histogram.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    length = np.linalg.norm(histogram, axis=1, keepdims=True)
    descriptors = np.divide(histogram, length, out=np.zeros_like(histogram), where=length > 0)
    return Features(prepared, descriptors)
