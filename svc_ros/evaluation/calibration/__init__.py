"""What to demand on one's own data."""
