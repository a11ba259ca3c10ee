"""LiDAR ray casting in built scenes with known poses."""
