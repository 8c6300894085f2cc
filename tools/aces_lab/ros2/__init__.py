"""A robot or bus for ROS 2 programs, without ROS installed: `--ros2` of run, sim and sniff. Needs the extra `[ros2]`."""
