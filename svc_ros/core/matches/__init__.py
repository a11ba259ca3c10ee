"""From scans to correspondences: descriptors and their nearest ones."""
