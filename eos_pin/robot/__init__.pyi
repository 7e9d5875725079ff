from ._parts import Joint as Joint
from .library import available_robots as available_robots
from .loading import Payload as Payload
from .loading import Tool as Tool
from .loading import default_frame as default_frame
from .loading import leaf_frames as leaf_frames
from .loading import load_robot as load_robot
from .model import Robot as Robot
