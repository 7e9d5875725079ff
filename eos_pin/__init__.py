"""Extended operational space control of redundant robots, on any URDF, with Pinocchio underneath.

The parts, from the ground up: a `Robot` (`load_robot`), a `Task` z = G(q), a `Chart` that makes (z, v) coordinates of
the robot, an `Atlas` of charts, a `Trajectory` to follow, an `EosController` that follows it, and `simulate` to run it.
"""

import lazy_loader

__version__ = "0.1.0"

# The public names are listed in `__init__.pyi`.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
