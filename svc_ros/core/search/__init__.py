"""From correspondences, or the ground, to poses worth judging."""
