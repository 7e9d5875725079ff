from .avoidance import Avoidance as Avoidance
from .clearance import Clearance as Clearance
from .clearance import ClosestPair as ClosestPair
from .clearance import Obstacle as Obstacle
from .manifold import SelfMotionManifold as SelfMotionManifold
from .manifold import self_motion_manifold as self_motion_manifold
