from .avoidance import Avoidance as Avoidance
from .clearance import Clearance as Clearance
from .clearance import ClosestPair as ClosestPair
from .clearance import Obstacle as Obstacle
