"""LiDAR scans of built scenes with known poses: the package's own data, nothing to download."""
