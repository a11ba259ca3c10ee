"""The hot loops, compiled by numba: no GIL, no state. Slow twins in test/."""
