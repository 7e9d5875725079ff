"""Extended operational space control of redundant robots, on any URDF, with Pinocchio underneath.

The parts, from the ground up: a `Robot` (`load_robot`), a `Task` z = G(q), a `Chart` that makes (z, v) coordinates of
the robot, an `Atlas` of charts, a `Trajectory` to follow, an `EosController` that follows it, and `simulate` to run it.
"""

from eos_pin.atlas import Atlas, JointPath
from eos_pin.avoidance import Avoidance
from eos_pin.baselines import (
    BASELINES,
    DampedNullSpace,
    EnergyNullSpace,
    FreeNullSpace,
    PostureNullSpace,
    TaskSpaceController,
)
from eos_pin.charts import Chart, ChartPoint
from eos_pin.clearance import Approach, Clearance, Obstacle
from eos_pin.controllers import Controller, EosController, OpenLoop
from eos_pin.dynamics import ExtendedDynamics, TaskSpaceDynamics, pseudoinverse
from eos_pin.errors import (
    ChartError,
    EosError,
    InputError,
    InverseError,
    OutputError,
    ResultError,
    RobotError,
    SingularError,
    StateError,
    UnknownNameError,
    ViewerError,
)
from eos_pin.library import available_robots
from eos_pin.limits import JointLimits, LimitedEosController
from eos_pin.loading import Payload, Tool, default_frame, leaf_frames, load_robot
from eos_pin.loop import ControlLoop
from eos_pin.mujoco_plant import MujocoPlant
from eos_pin.newton import Inverse
from eos_pin.objectives import (
    Damp,
    DescendPotential,
    Objective,
    Posture,
    ReduceKineticEnergy,
    Together,
    Track,
)
from eos_pin.orientations import HeadingTask, OrientationTask, PoseTask
from eos_pin.positions import ComTask, PositionTask, RelativePositionTask
from eos_pin.results import Result
from eos_pin.robot import Joint, Robot
from eos_pin.simulation import SensorNoise, simulate, simulate_eos, simulate_sampled
from eos_pin.systems import Friction, TaskForce
from eos_pin.tasks import StackedTask, Task, TaskPoint, task_from
from eos_pin.trajectories import (
    Geodesic,
    Harmonic,
    Hold,
    StackedTrajectory,
    Target,
    Trajectory,
    circle,
    cubic_spline,
    figure_eight,
    line,
    minimum_jerk,
    spline_from_csv,
)

__version__ = "0.1.0"

__all__ = [
    "BASELINES",
    "Approach",
    "Atlas",
    "Avoidance",
    "Chart",
    "ChartError",
    "ChartPoint",
    "Clearance",
    "ComTask",
    "ControlLoop",
    "Controller",
    "Damp",
    "DampedNullSpace",
    "DescendPotential",
    "EnergyNullSpace",
    "EosController",
    "EosError",
    "ExtendedDynamics",
    "FreeNullSpace",
    "Friction",
    "Geodesic",
    "Harmonic",
    "HeadingTask",
    "Hold",
    "InputError",
    "Inverse",
    "InverseError",
    "Joint",
    "JointLimits",
    "JointPath",
    "LimitedEosController",
    "MujocoPlant",
    "Objective",
    "Obstacle",
    "OpenLoop",
    "OrientationTask",
    "OutputError",
    "Payload",
    "PoseTask",
    "PositionTask",
    "Posture",
    "PostureNullSpace",
    "ReduceKineticEnergy",
    "RelativePositionTask",
    "Result",
    "ResultError",
    "Robot",
    "RobotError",
    "SensorNoise",
    "SingularError",
    "StackedTask",
    "StackedTrajectory",
    "StateError",
    "Target",
    "Task",
    "TaskForce",
    "TaskPoint",
    "TaskSpaceController",
    "TaskSpaceDynamics",
    "Together",
    "Tool",
    "Track",
    "Trajectory",
    "UnknownNameError",
    "ViewerError",
    "available_robots",
    "circle",
    "cubic_spline",
    "default_frame",
    "figure_eight",
    "leaf_frames",
    "line",
    "load_robot",
    "minimum_jerk",
    "pseudoinverse",
    "simulate",
    "simulate_eos",
    "simulate_sampled",
    "spline_from_csv",
    "task_from",
]
