"""What a pose makes of what both sensors saw."""
