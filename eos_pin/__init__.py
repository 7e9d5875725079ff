"""Extended operational space control of redundant robots, on any URDF, with Pinocchio underneath."""

__version__ = "0.1.0"
