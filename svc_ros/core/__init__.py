"""Numbers only: scans in, verdicts out. No ROS, no files, no logging set-up."""
