"""Decisions turned into a page for a browser."""
