from .continuous import simulate as simulate
from .continuous import simulate_extended as simulate_extended
from .disturbances import Friction as Friction
from .disturbances import SensorNoise as SensorNoise
from .disturbances import TaskForce as TaskForce
from .mujoco import MujocoPlant as MujocoPlant
from .result import Result as Result
from .sampled import simulate_sampled as simulate_sampled
