"""The command ``mrd``: all tools that need no ROS, under one name."""
