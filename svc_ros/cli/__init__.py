"""The command line; the one place that maps errors to exit codes."""
