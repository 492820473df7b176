"""Bags of ROS 1 and ROS 2, read without ROS: camera, wheels and gyroscope as events in order of time."""

__all__: list[str] = []
