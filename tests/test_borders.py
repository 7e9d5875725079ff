"""Every public function, constructor and method with what it cannot take: errors of this package come out, no others.

The names are read from the stubs and the parameters from the signatures. What becomes public is tried as soon as the
table of examples has its parameters.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import io
import re
import warnings
from functools import cache
from pathlib import Path

import coal
import matplotlib as mpl
import numpy as np
import pinocchio as pin
import pytest

import eos_pin
from eos_pin import experiments

mpl.use("Agg")

ROOMS = ("", ".charts", ".control", ".experiments", ".planning", ".robot", ".simulation", ".tasks", ".trajectories")
#: What only a backend would say.
FOREIGN = re.compile(
    r"Boost|ArgumentError|/pinocchio/|\.hxx|\.hpp|broadcast|not aligned|C\+\+ signature|has no attribute|__init__"
    r"|unsupported operand|positional argument|ufunc|matmul"
)
#: What may be given where it has no place.
BAD = {
    "None": None,
    "text": "x",
    "an object": object(),
    "a dictionary": {},
    "a complex number": 1j,
    "NaN": float("nan"),
    "infinity": float("inf"),
    "a negative number": -1.0,
    "an empty list": [],
    "an empty array": np.empty(0),
    "a matrix": np.ones((4, 2)),
    "three dimensions": np.ones((2, 2, 2)),
    "too many numbers": np.ones(57),
    "a list with NaN": [float("nan"), 0.0, 0.0],
    "an array with infinity": np.array([0.0, np.inf, 0.0]),
    "words": ["a", "b", "c"],
    "objects": [None, None, None],
    "rows of different lengths": [[0.0], [0.0, 1.0]],
}
#: Bundles of arrays, made in inner loops, which look at nothing; and what opens browsers or starts processes.
BUNDLES = {"Inverse", "Target", "TaskPoint", "ClosestPair", "ChartPoint", "JointPath", "IkSolution", "Plan", "Result"}
BUNDLES |= {"SelfMotionManifold", "Waypoints", "Joint", "Chart"}
APART = {"Viewer", "sweep", "trials", "write_html"}
#: Hooks, whose `data` is Pinocchio's, and methods of tuples.
HOOKS = {"compute_point", "compute_jacobian", "compute_drift", "count", "index", "add_user"}


@cache
def examples():
    """A good value of every parameter, by its name; and objects of the public classes."""
    robot = eos_pin.load_robot("ppr", gravity=(0.0, -9.81, 0.0))
    frame = eos_pin.default_frame(robot)
    task = eos_pin.PositionTask(robot, frame, "xy")
    q, dq = np.array([0.3, 0.2, 0.4]), np.array([0.1, -0.1, 0.2])
    z, J = task.linearize(q)
    chart, hold = eos_pin.Chart.from_base(task, q), eos_pin.Hold(z)
    controller = eos_pin.EosController(task, hold)
    limited = eos_pin.LimitedEosController(task, hold)
    rows = ([-2.0] * 3, [2.0] * 3)
    obstacle = eos_pin.Obstacle(coal.Sphere(0.1), pin.SE3(np.eye(3), np.array([3.0, 3.0, 0.0])))
    clearance = eos_pin.Clearance(robot, [obstacle])
    circle = eos_pin.circle(z, 0.05, period=4.0)
    space = eos_pin.circle([0.0, 0.0, 0.0], 0.05, period=4.0)
    plan = eos_pin.plan(task, circle, limits=rows)
    manifold = eos_pin.self_motion_manifold(task, z, limits=rows, seeds=3)
    result = eos_pin.simulate(robot, controller, q, duration=0.02)
    atlas = eos_pin.Atlas(task)
    force = eos_pin.TaskForce(task, lambda t: [0.0, 0.0])
    values = {"robot": robot, "plant": robot, "model": robot.model, "task": task, "frame": frame, "reference": hold}
    values |= {"q": q, "dq": dq, "ddq": dq, "tau": dq, "q0": q, "goal": q, "near": q, "values": q, "F": dq, "z": z}
    values |= {"z0": z, "z1": z, "value": z, "delta": 0.01 * z, "dz": z, "ddz": z, "u": np.zeros(2), "v": np.zeros(1)}
    values |= {"J": J, "chart": chart, "point": chart.point(q, dq), "clearance": clearance, "obstacles": [obstacle]}
    values |= {"controller": controller, "state": controller.start(0.0, q, dq), "t": 0.1, "threshold": 0.5, "n": 3}
    values |= {"r": 1, "tol": 1e-9, "result": result, "plan": plan, "period": 2.0, "duration": 0.02, "path": circle}
    values |= {"times": np.array([0.0, 0.5, 1.0]), "atlas": atlas, "influence_distance": 0.1, "radius": 0.05}
    values |= {"centre": [0.0] * 3, "center": [0.0] * 3, "stroke": [0.1, 0.0, 0.0], "start": [0.0] * 3, "share": 0.5}
    values |= {
        "end": [0.0, 0.0, 1.0],
        "points": np.eye(3),
        "poses": [pin.SE3.Identity()] * 3,
        "shape": coal.Sphere(0.1),
    }
    values |= {"rotations": [np.eye(3)] * 3, "placement": pin.SE3.Identity(), "spacing": 0.5, "count": 3}
    values |= {"s": np.array([0.1]), "arc": manifold.arcs[0], "criterion": np.sum, "force": lambda t: [0.0, 0.0]}
    values |= {"gravity": [0.0, -9.81, 0.0], "gradient": lambda q: q, "length": 0.01, "axes": "xy", "name": frame}
    objects = {
        "Atlas": atlas,
        "Chart": chart,
        "Clearance": clearance,
        "Obstacle": obstacle,
        "Plan": plan,
        "Robot": robot,
    }
    objects |= {"SelfMotionManifold": manifold, "Result": result, "TaskForce": force, "Friction": eos_pin.Friction()}
    objects |= {
        "ExtendedDynamics": eos_pin.ExtendedDynamics.from_state(robot, chart, q, dq),
        "EosController": controller,
    }
    objects |= {"TaskSpaceDynamics": eos_pin.TaskSpaceDynamics(robot, q, dq, task.at(q, dq)), "Harmonic": space}
    objects |= {"ControlLoop": eos_pin.ControlLoop(controller), "LimitedEosController": limited, "PositionTask": task}
    objects |= {"OperationalSpaceController": eos_pin.OperationalSpaceController(task, hold), "Damp": eos_pin.Damp()}
    objects |= {"OpenLoop": eos_pin.OpenLoop(lambda t: [0.0] * 3), "DampedNullSpace": eos_pin.DampedNullSpace()}
    objects |= {"DescendPotential": eos_pin.DescendPotential(lambda q: q), "Track": eos_pin.Track([0.0]), "Hold": hold}
    objects |= {"FollowJoints": eos_pin.FollowJoints(lambda t: (q, dq, dq)), "FollowPlan": eos_pin.FollowPlan(plan)}
    objects |= {"Posture": eos_pin.Posture(q), "PostureNullSpace": eos_pin.PostureNullSpace(q)}
    objects |= {"ReduceKineticEnergy": eos_pin.ReduceKineticEnergy(robot), "ComTask": eos_pin.ComTask(robot, "xy")}
    objects |= {"EnergyNullSpace": eos_pin.EnergyNullSpace(eos_pin.ReduceKineticEnergy(robot))}
    objects |= {"SumObjective": eos_pin.SumObjective([eos_pin.Damp(), eos_pin.Posture(q)])}
    objects |= {"FreeNullSpace": eos_pin.FreeNullSpace(), "Avoidance": eos_pin.Avoidance(clearance)}
    objects |= {"JointLimits": eos_pin.JointLimits.from_robot(robot, acceleration=9.0, velocity=2.0, torque=99.0)}
    objects |= {"PoseTrajectory": eos_pin.PoseTrajectory(position=space, orientation=np.eye(3))}
    objects |= {"StackedTrajectory": eos_pin.StackedTrajectory((space, space))}
    objects |= {"RunOptions": experiments.RunOptions(), "TaskOptions": experiments.TaskOptions()}
    return values, objects


def special(label):
    """Good values where a name means something else than elsewhere."""
    values, objects = examples()
    q, task, z = (values[name] for name in ("q", "task", "z"))
    rows = np.array([q, q])
    run = {"t": np.array([0.0, 1.0]), "q": rows, "dq": rows, "tau": rows}
    found = {
        "plan": {"path": [z, z + 0.02], "times": None, "start": None, "end": None, "limits": ([-2.0] * 3, [2.0] * 3)},
        "self_motion_manifold": {"seeds": 3, "tries": 20, "most": 50, "limits": ([-2.0] * 3, [2.0] * 3)},
        "load_robot": {"source": "ppr", "gravity": None},
        "task_from_description": {"description": task.describe()},
        "Clearance.along": {"t": [0.0, 1.0], "q": rows},
        "JointLimits.passed": run,
        "Atlas.follow": {"path": [z]},
        "Chart.acceleration": {"task": z, "self_motion": np.zeros(1)},
        "Chart.inverse": {"start": None},
        "Chart.B": {"start": None},
        "OpenLoop": {"tau": lambda t: [0.0] * 3},
        "FollowJoints": {"joints": lambda t: (q, q, q)},
        "SumObjective": {"parts": [eos_pin.Damp()]},
        "StackedTask": {"tasks": [task]},
        "StackedTrajectory": {"parts": (objects["Harmonic"], objects["Harmonic"])},
        "EnergyNullSpace": {"objective": objects["ReduceKineticEnergy"]},
        "JointLimits": dict.fromkeys(("lower", "upper", "velocity", "acceleration", "braking", "torque"), np.ones(3)),
        "TaskSpaceDynamics": {"task": task.at(q, q)},
        "Harmonic": {"center": z, "sines": np.ones((1, 2)), "cosines": np.ones((1, 2)), "period": 2.0},
        "Geodesic": {"points": np.array([z, z + 0.1, z])},
        "Payload": {"mass": 1.0},
        "PoseTrajectory": {"position": objects["Harmonic"], "orientation": np.eye(3)},
        "Trial": {"robot": experiments.RobotOptions("ppr")},
        "RobotOptions": {"robot": "ppr"},
        "TaskOptions": {"axes": ""},
        "circle": {"start": [0.0, 0.0, 0.0]},
        "Box": {"size": [1.0, 1.0, 1.0]},
        "Mesh": {"vertices": np.random.default_rng(0).normal(size=(8, 3))},
        "Avoidance.follow": {"times": [0.0, 0.1]},
        "Result.save": {"path": "run.npz"},
        "Result.to_csv": {"path": "run.csv"},
        "Plan.save": {"path": "p.plan"},
        "Plan.to_csv": {"path": "p.csv"},
        "Result.mean": {"values": values["result"].t},
    }.get(label, {})
    kind, _, method = label.partition(".")
    if method in ("broken_limits",):
        found = run
    if method == "task_acceleration" or (method == "asked"):
        found = {"point": task.at(q, q)}
    if method.startswith("frame_"):
        found = {"data": task._data, "frame": 2}
    if method == "compiled_law":
        found = {"drive": values["state"].drive}
    if kind == "LimitedEosController" and method:
        found = found | {"state": objects[kind].start(0.0, q, q)}
    if kind == "OpenLoop" and method:
        found = found | {"state": None}
    return found


def public():
    """Label and callable of everything that is public and that the examples fit."""
    _, objects = examples()
    seen = set()
    for room in ROOMS:
        module = importlib.import_module(f"eos_pin{room}")
        stub = Path(str(module.__file__)).with_suffix(".pyi").read_text()
        for name in re.findall(r"import \w+ as (\w+)", stub):
            thing = getattr(module, name)
            if id(thing) in seen or name in APART or (inspect.isclass(thing) and issubclass(thing, Exception)):
                continue
            seen.add(id(thing))
            if name not in BUNDLES and not inspect.isabstract(thing):
                yield name, thing
            for method in dir(objects.get(name)) if inspect.isclass(thing) and name in objects else ():
                static = inspect.getattr_static(thing, method, None)
                if (method.startswith("_") and method != "__call__") or method in HOOKS or static is None:
                    continue
                if isinstance(static, property) or not hasattr(static, "__get__") or type(static).__name__ == "Renamed":
                    continue
                if callable(found := getattr(objects[name], method)):
                    yield f"{name}.{method}", found


def arguments(label, function):
    """Parameters that are tried, and a good value of each that has no default; None if an example is missing."""
    values, _ = examples()
    own, good, names = special(label), {}, []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL, parameter.POSITIONAL_ONLY):
            continue
        name = parameter.name
        names.append(name)
        if name in own:
            good[name] = own[name]
        elif parameter.default is parameter.empty:
            if name not in values:
                return None
            good[name] = values[name]
    return names, good


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked")
def test_borders_let_only_errors_of_the_package_out(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    calls, faults, left = 0, [], []
    for label, function in public():
        with contextlib.suppress(ValueError):
            found = arguments(label, function)
            if found is None:
                left.append(label)
                continue
            names, good = found
            for name in names:
                for what, bad in BAD.items():
                    if name == "data":
                        continue
                    calls += 1
                    fault = tried(function, good | {name: bad})
                    if fault:
                        faults.append(f"{label}({name}={what}): {fault}")
    print(f"{calls} calls, {len(faults)} faults; without examples: {left}")
    assert calls > 15000
    assert not faults, "\n".join(faults)


def tried(function, keywords) -> str:
    """What came out that should not; empty if nothing did."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            function(**keywords)
    except eos_pin.EosError as error:
        return str(error)[:100] if FOREIGN.search(str(error)) else ""
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:60]}"
    return ""
