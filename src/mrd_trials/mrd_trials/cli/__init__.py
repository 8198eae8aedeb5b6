"""Command-line tools without ROS."""
