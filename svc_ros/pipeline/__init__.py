"""What a stream of scans needs, without ROS."""
