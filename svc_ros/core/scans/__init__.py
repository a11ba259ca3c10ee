"""One scan before it meets another: thinned, oriented, levelled, seen from above."""
