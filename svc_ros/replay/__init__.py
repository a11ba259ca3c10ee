"""Bags through the pipeline: opened, decided, written, summarised."""
