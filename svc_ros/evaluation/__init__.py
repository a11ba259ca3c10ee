"""Metrics and runners over labelled pairs."""
