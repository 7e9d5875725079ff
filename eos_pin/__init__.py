"""Extended operational space control of redundant robots, on any URDF, with Pinocchio underneath.

The parts, from the ground up: a `Robot` (`load_robot`), a `Task` z = G(q), a `Chart` that makes (z, v) coordinates of
the robot, an `Atlas` of charts, a `Trajectory` to follow, an `EosController` that follows it, and `simulate` to run it.
"""

import sys

__version__ = "0.2.0"

#: Names and modules of 0.1, and what each became; the changelog has the reasons.
_RENAMED = {
    "Together": "SumObjective",
    "Reached": "IkSolution",
    "Approach": "ClosestPair",
    "TaskSpaceController": "OperationalSpaceController",
    "simulate_eos": "simulate_extended",
    "BASELINES": "OperationalSpaceController with a NullSpaceLaw",
    "Inverses": "JointPath",
    "write_table": "eos_pin.experiments.sweeps.write_table",
    "task_from": "task_from_description",
    "control_torques": "a loop over controller.torque",
    "pseudoinverse": "numpy.linalg.pinv",
    "angles": "eos_pin.robot",
    "animation": "eos_pin.paper",
    "applicability": "eos_pin.experiments",
    "applications": "eos_pin.paper",
    "arrays": "eos_pin._arrays",
    "atlas": "eos_pin.charts",
    "avoidance": "eos_pin.planning",
    "baselines": "eos_pin.control",
    "bases": "eos_pin.charts",
    "batch": "eos_pin.charts",
    "change": "eos_pin.control",
    "checking": "eos_pin.robot",
    "claims": "eos_pin.paper",
    "clearance": "eos_pin.planning",
    "compiled": "eos_pin._kernels.dispatch",
    "describing": "eos_pin.cli",
    "controllers": "eos_pin.control",
    "drawing": "eos_pin.plots",
    "driving": "eos_pin.control",
    "dynamics": "eos_pin.charts",
    "encounters": "eos_pin.paper",
    "exhibits": "eos_pin.paper",
    "extent": "eos_pin.tasks",
    "figures": "eos_pin.paper",
    "files": "eos_pin._files",
    "frames": "eos_pin.tasks",
    "interrupts": "eos_pin.experiments",
    "keyframes": "eos_pin.plots",
    "kinematics": "eos_pin.simulation",
    "library": "eos_pin.robot",
    "limits": "eos_pin.control",
    "linear": "eos_pin.charts",
    "loading": "eos_pin.robot",
    "loop": "eos_pin.control",
    "margins": "eos_pin.simulation",
    "markup": "eos_pin.robot",
    "memories": "eos_pin.control",
    "meshes": "eos_pin.viewer",
    "mujoco_plant": "eos_pin.simulation",
    "newton": "eos_pin.charts",
    "notes": "eos_pin.robot",
    "objectives": "eos_pin.control",
    "options": "eos_pin.experiments",
    "orientations": "eos_pin.tasks",
    "overload": "eos_pin.control",
    "panels": "eos_pin.plots",
    "pathfiles": "eos_pin.experiments",
    "positions": "eos_pin.tasks",
    "postures": "eos_pin.robot",
    "presets": "eos_pin.experiments",
    "recording": "eos_pin.simulation",
    "report": "eos_pin.cli",
    "results": "eos_pin.simulation",
    "scene": "eos_pin.viewer",
    "server": "eos_pin.viewer",
    "shapes": "eos_pin.robot",
    "splines": "eos_pin.trajectories",
    "strength": "eos_pin.experiments",
    "sweeping": "eos_pin.cli",
    "sweeps": "eos_pin.experiments",
    "systems": "eos_pin.simulation",
    "tables": "eos_pin.cli",
    "targets": "eos_pin.trajectories",
    "terminal": "eos_pin.cli",
    "urdf": "eos_pin.robot",
    "waypoints": "eos_pin.trajectories",
    "workspace": "eos_pin.robot",
}


# The public names are listed in `__init__.pyi`, which is read when the first of them is used: the command line comes
# here before it can hear Ctrl-C.
_attached: list = []  # type: ignore[type-arg]


def __getattr__(name: str) -> object:
    if name in _RENAMED:
        raise ImportError(_renamed(name))
    if not _attached:
        import lazy_loader

        _attached.extend(lazy_loader.attach_stub(__name__, __file__))
    public, _, names = _attached
    return names if name == "__all__" else public(name)


def __dir__() -> list[str]:
    return [*__getattr__("__all__")]


def _renamed(name: str) -> str:
    return f"eos_pin.{name} was renamed in 0.2: use {_RENAMED[name]}"


class _OldModules:
    """Import hook that names the new place of a module of 0.1."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        old = name.removeprefix("eos_pin.")
        if name.startswith("eos_pin.") and old in _RENAMED:
            raise ModuleNotFoundError(_renamed(old), name=name)


sys.meta_path.append(_OldModules)  # type: ignore[arg-type]
