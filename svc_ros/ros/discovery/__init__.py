"""What a launch file finds by itself where nobody says it: topics of clouds, and the robot's base."""
