"""Maps on disk (docs/map.md): a folder of arrays, one row a keyframe, point, cell or edge."""
