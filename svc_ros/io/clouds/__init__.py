"""Scans from files and messages."""
