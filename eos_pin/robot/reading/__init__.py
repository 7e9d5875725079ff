"""Files that describe robots, read and checked: URDF and MJCF."""
