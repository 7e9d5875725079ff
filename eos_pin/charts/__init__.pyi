from ._newton import Inverse as Inverse
from .atlas import Atlas as Atlas
from .atlas import IkSolution as IkSolution
from .atlas import JointPath as JointPath
from .chart import Chart as Chart
from .chart import ChartPoint as ChartPoint
from .dynamics import ExtendedDynamics as ExtendedDynamics
from .dynamics import TaskSpaceDynamics as TaskSpaceDynamics
