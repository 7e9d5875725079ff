"""A good value of every parameter of the public functions, and an object of every public class."""

from __future__ import annotations

import importlib
import inspect
import re
import tempfile
from functools import cache
from pathlib import Path

import coal
import matplotlib as mpl
import numpy as np
import pinocchio as pin

import eos_pin
from eos_pin import experiments, planning, plots

mpl.use("Agg")
from matplotlib.figure import Figure

#: The package, and the rooms that have public names.
ROOMS = ("", *(f".{stub.parent.name}" for stub in sorted(Path(eos_pin.__file__).parent.glob("*/__init__.pyi"))))
#: Tuples and values that inner loops make; nobody calls their constructors, which look at nothing.
BUNDLES = {"Inverse", "Target", "TaskPoint", "ClosestPair", "ChartPoint", "JointPath", "IkSolution", "Plan", "Result"}
BUNDLES |= {"SelfMotionManifold", "Waypoints", "Joint", "Chart", "LimitUse", "Command", "Equilibrium"}
#: Contracts, whose methods are tried on the classes that keep them.
CONTRACTS = {"Task", "Trajectory", "Controller", "Objective", "NullSpaceLaw"}
#: A robot of two joints, of which the second follows the first.
FOLLOWER = """<robot name="follower"><link name="l0"/>{}{}
<joint name="a" type="revolute"><parent link="l0"/><child link="l1"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" velocity="1" effort="9"/></joint>
<joint name="f" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="1" effort="9"/><mimic joint="a" multiplier="0.5"/></joint></robot>""".format(
    *(
        f'<link name="l{k}"><inertial><mass value="1"/><origin xyz="0.2 0 0"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for k in (1, 2)
    )
)
#: Methods of every tuple.
OF_TUPLES = {"count", "index"}


@cache
def _made():
    """The parts of which the tables below are made."""
    robot = eos_pin.load_robot("ppr", gravity=(0.0, -9.81, 0.0))
    frame = eos_pin.default_frame(robot)
    task = eos_pin.PositionTask(robot, frame, "xy")
    q, dq = np.array([0.3, 0.2, 0.4]), np.array([0.1, -0.1, 0.2])
    z, J = task.linearize(q)
    hold, rows = eos_pin.Hold(z), ([-2.0] * 3, [2.0] * 3)
    controller = eos_pin.EosController(task, hold)
    obstacle = eos_pin.Obstacle(coal.Sphere(0.1), pin.SE3(np.eye(3), np.array([3.0, 3.0, 0.0])))
    return {
        "robot": robot,
        "frame": frame,
        "task": task,
        "q": q,
        "dq": dq,
        "z": z,
        "J": J,
        "hold": hold,
        "rows": rows,
        "controller": controller,
        "obstacle": obstacle,
        "clearance": eos_pin.Clearance(robot, [obstacle]),
        "chart": eos_pin.Chart.from_base(task, q),
        "circle": (circle := eos_pin.circle(z, 0.05, period=4.0)),
        "space": eos_pin.circle([0.0, 0.0, 0.0], 0.05, period=4.0),
        "plan": eos_pin.plan(task, circle, limits=rows),
        "manifold": eos_pin.self_motion_manifold(task, z, limits=rows, seeds=3),
        "upright": eos_pin.self_motion_manifold(
            eos_pin.PositionTask(robot.with_gravity([0.0, -9.81, 0.0]), frame, "xy"), z, limits=rows, seeds=3
        ),
        "result": eos_pin.simulate(robot, controller, q, duration=0.02),
        "atlas": eos_pin.Atlas(task),
        "trial": eos_pin.Trial.from_settings("ppr", duration=0.02),
        "scene": planning.Scene(capsules=[planning.sphere([3.0, 3.0, 0.0], 0.1)]),
        "rows of a sweep": eos_pin.sweep([eos_pin.Trial.from_settings("ppr", duration=0.02, kp=kp) for kp in (50, 90)]),
        "bodies": planning.Bodies.of(robot, {frame: planning.Capsule([0.0] * 3, [0.1, 0.0, 0.0], 0.05)}),
    }


@cache
def values():
    """A good value of every parameter, by its name."""
    made = _made()
    q, dq, z, robot, task = (made[name] for name in ("q", "dq", "z", "robot", "task"))
    axes = Figure().add_subplot()
    found = {name: made[name] for name in ("robot", "frame", "task", "q", "dq", "z", "J", "controller", "clearance")}
    found |= {name: made[name] for name in ("chart", "plan", "result", "atlas", "scene", "bodies")}
    found |= {"plant": robot, "model": robot.model, "reference": made["hold"], "ax": axes, "figure": axes.figure}
    found |= {"ddq": dq, "tau": dq, "q0": q, "goal": q, "near": q, "values": q, "F": dq, "joints": lambda t: (q, q, q)}
    found |= {"z0": z, "z1": z, "value": z, "delta": 0.01 * z, "dz": z, "ddz": z, "u": np.zeros(2), "v": np.zeros(1)}
    found |= {"point": made["chart"].point(q, dq), "obstacles": [made["obstacle"]], "others": 0.0}
    found |= {"state": made["controller"].start(0.0, q, dq), "t": 0.1, "threshold": 0.5, "n": 3, "step": 0.001}
    found |= {"r": 1, "tol": 1e-9, "period": 2.0, "duration": 0.02, "path": made["circle"], "length": 0.01}
    found |= {"times": np.array([0.0, 0.5, 1.0]), "influence_distance": 0.1, "radius": 0.05, "names": ["a", "b"]}
    found |= {"user": "a law without time", "change": dq}
    found |= {"centre": [0.0] * 3, "center": [0.0] * 3, "stroke": [0.1, 0.0, 0.0], "start": [0.0] * 3, "share": 0.5}
    found |= {"end": [0.0, 0.0, 1.0], "points": np.eye(3), "poses": [pin.SE3.Identity()] * 3, "shape": coal.Sphere(0.1)}
    found |= {"rotations": [np.eye(3)] * 3, "placement": pin.SE3.Identity(), "spacing": 0.5, "count": 3, "axes": "xy"}
    found |= {"s": np.array([0.1]), "arc": made["manifold"].arcs[0], "criterion": np.sum, "gradient": lambda q: q}
    found |= {"gravity": [0.0, -9.81, 0.0], "name": made["frame"], "force": lambda t: [0.0, 0.0], "kp": 2.0, "kd": 3.0}
    found |= {"target": eos_pin.Target(z, z, z), "control_period": 0.001, "combinations": np.eye(3)[:1], "wait": 0.0}
    found |= {"velocity": 1.0, "acceleration": 2.0, "jerk": 9.0, "trials": [made["trial"]], "data": task._data}
    found |= {"capsules": [(made["frame"], planning.Capsule([0.0] * 3, [0.1, 0.0, 0.0], 0.05))]}
    found |= {"results": {"a": made["result"]}}
    return found


@cache
def objects():
    """An object of every public class, by its class."""
    made = _made()
    names = ("robot", "task", "q", "dq", "z", "hold", "frame", "controller", "clearance", "plan", "space")
    robot, task, q, dq, z, hold, frame, controller, clearance, plan, space = (made[name] for name in names)
    panda = eos_pin.load_robot("panda", chain_to="panda_hand_tcp")
    hand, pose = "panda_hand_tcp", eos_pin.PoseTask(panda, "panda_hand_tcp")
    chart = made["chart"]
    listed = [made["atlas"], chart, clearance, made["obstacle"], plan, robot, made["manifold"], made["result"]]
    listed += planning.equilibria(made["upright"])[:1]
    listed += [eos_pin.TaskForce(task, lambda t: [0.0, 0.0]), eos_pin.Friction(), eos_pin.SensorNoise()]
    listed += [eos_pin.ExtendedDynamics.from_state(robot, chart, q, dq), controller, task, space, hold, made["trial"]]
    listed += [eos_pin.TaskSpaceDynamics(robot, q, dq, task.at(q, dq)), eos_pin.ControlLoop(controller)]
    listed += [eos_pin.LimitedEosController(task, hold), eos_pin.OperationalSpaceController(task, hold)]
    listed += [eos_pin.ImpedanceController(task, hold), eos_pin.ForceGoal({"x": 5.0}), eos_pin.Safety()]
    listed += [eos_pin.Damp(), eos_pin.OpenLoop(lambda t: [0.0] * 3), eos_pin.DampedNullSpace()]
    listed += [eos_pin.DescendPotential(lambda q: q), eos_pin.Track([0.0]), eos_pin.FollowPlan(plan)]
    listed += [eos_pin.FollowJoints(lambda t: (q, dq, dq)), eos_pin.Posture(q), eos_pin.PostureNullSpace(q)]
    energy = eos_pin.ReduceKineticEnergy(robot)
    listed += [eos_pin.TrackTask(task, hold)]
    listed += [energy, eos_pin.EnergyNullSpace(energy), eos_pin.SumObjective([eos_pin.Damp(), eos_pin.Posture(q)])]
    listed += [eos_pin.FreeNullSpace(), eos_pin.Avoidance(clearance), eos_pin.ComTask(robot, "xy")]
    listed += [eos_pin.JointLimits.from_robot(robot, acceleration=9.0, velocity=2.0, torque=99.0)]
    listed += [eos_pin.PoseTrajectory(position=space, orientation=np.eye(3)), eos_pin.StackedTrajectory((space, space))]
    limits = eos_pin.JointLimits.without_torques(robot, velocity=9.0, acceleration=99.0)
    loop = eos_pin.KinematicLoop(task, hold, control_period=0.001, limits=limits)
    listed += [loop, loop.step(0.0, q), eos_pin.SetPoint(task, z, velocity=1.0, acceleration=2.0, jerk=9.0)]
    listed += [
        eos_pin.JointMap(robot, [joint.name for joint in robot.joints]),
        *robot.joints[:1],
        eos_pin.Payload(1.0, frame),
    ]
    listed += [eos_pin.Tool(frame), eos_pin.MujocoPlant.from_robot(robot), made["bodies"], made["scene"]]
    listed += [planning.MotionLimits.of(robot), planning.limit_use(plan), planning.Box([3.0] * 3, [1.0] * 3)]
    listed += [planning.sphere([3.0] * 3, 0.1), planning.Mesh(3.0 + _corners())]
    listed += [experiments.RobotOptions("ppr"), experiments.TaskOptions(), experiments.PathOptions()]
    listed += [
        experiments.ControlOptions(),
        experiments.RunOptions(),
        clearance.closest_pairs(0.0, q)[0],
        chart.point(q, dq),
    ]
    listed += [task.at(q, dq), hold(0.0), chart.inverse(z, np.zeros(1)), made["atlas"].follow(q, [z])]
    listed += [
        eos_pin.inverse_kinematics(task, z, q),
        eos_pin.Geodesic(task, np.array([z, z + 0.1, z]), [0.0, 1.0, 2.0]),
    ]
    listed += [eos_pin.PositionTask(panda, hand), eos_pin.OrientationTask(panda, hand), pose]
    listed += [eos_pin.HeadingTask(robot, frame), eos_pin.JointTask(robot, [{robot.joints[0].name: 1.0}])]
    listed += [eos_pin.StackedTask([task, eos_pin.HeadingTask(robot, frame)]), eos_pin.AxisTask(panda, hand, "z")]
    listed += [
        eos_pin.PointAxisTask(panda, hand, (1.0, 2.0, -0.5)),
        eos_pin.DistanceTask(robot, frame, [2.0, 2.0, 0.0]),
    ]
    listed += [eos_pin.LookAtTask(panda, hand, (1.3, -0.4, 1.2), "x")]
    listed += [eos_pin.RelativePositionTask(panda, hand, "panda_link2")]
    tolerant, rest = eos_pin.ToleranceTask(pose, {"rz": 0.5}), np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.8])
    listed += [tolerant, eos_pin.KeepTolerance(eos_pin.Damp(), tolerant, tolerant.hold(rest))]
    listed += [eos_pin.load_robot(FOLLOWER, chain_to="l2")]
    listed += [eos_pin.RelativePoseTask(panda, hand, panda.model.frames[1].name)]
    listed += [eos_pin.Scene(robot), _waypoints(), eos_pin.Viewer(eos_pin.Scene(robot), q, port=0)]
    first = {}
    for thing in listed:
        first.setdefault(type(thing), thing)
    return first | {eos_pin.Harmonic: space}


def _waypoints():
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "points.csv"
        path.write_text("t,x,y\n0,0,0\n1,0.1,0\n")
        return eos_pin.read_waypoints(path)


def _corners():
    return np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)])


@cache
def special(label):
    """Good values where a name means something else than elsewhere."""
    made = _made()
    q, z, task, frame = (made[name] for name in ("q", "z", "task", "frame"))
    rows, limits, space = np.array([q, q]), {"limits": made["rows"]}, made["space"]
    run = {"t": np.array([0.0, 1.0]), "q": rows, "dq": rows, "tau": rows}
    moved = {"times": None, "start": None, "end": None}
    found = {
        "plan": {"path": [z, z + 0.02], **moved, **limits},
        "fastest": {"path": [z, z + 0.02], **moved, **limits},
        "self_motion_manifold": {"seeds": 3, "tries": 20, "most": 50, **limits},
        "equilibria": {"manifold": made["upright"], "starts": [], "seed": 0},
        "load_robot": {"source": "ppr", "gravity": None},
        "task_from_description": {"description": task.describe()},
        "Clearance.along": {"t": [0.0, 1.0], "q": rows},
        "JointLimits.passed": run,
        "Atlas.follow": {"path": [z]},
        "Atlas.holds": {"chart": made["chart"]},
        "Chart.acceleration": {"task": z, "self_motion": np.zeros(1)},
        "Chart.acceleration_and_basis": {"task": z, "self_motion": np.zeros(1)},
        "Chart.inverse": {"start": None},
        "Chart.B": {"start": None},
        "OpenLoop": {"tau": lambda t: [0.0] * 3},
        "SumObjective": {"parts": [eos_pin.Damp()]},
        "StackedTask": {"tasks": [task]},
        "StackedTrajectory": {"parts": (space, space)},
        "EnergyNullSpace": {"objective": eos_pin.ReduceKineticEnergy(made["robot"])},
        "JointLimits": dict.fromkeys(("lower", "upper", "velocity", "acceleration", "braking", "torque"), np.ones(3)),
        "MotionLimits": dict.fromkeys(("velocity", "acceleration", "torque"), np.ones(3)),
        "TaskSpaceDynamics": {"task": task.at(q, q)},
        "Harmonic": {"center": z, "sines": np.ones((1, 2)), "cosines": np.ones((1, 2)), "period": 2.0},
        "Geodesic": {"points": np.array([z, z + 0.1, z])},
        "Payload": {"mass": 1.0},
        "PoseTrajectory": {"position": space, "orientation": np.eye(3)},
        "Trial": {"robot": experiments.RobotOptions("ppr")},
        "Trial.from_settings": {"robot": "ppr"},
        "RobotOptions": {"robot": "ppr"},
        "TaskOptions": {"axes": ""},
        "TaskOptions.chosen": {"kind": "position"},
        "circle": {"start": [0.0, 0.0, 0.0]},
        "Box": {"size": [1.0, 1.0, 1.0]},
        "Mesh": {"vertices": _corners()},
        "Avoidance.follow": {"times": [0.0, 0.1]},
        "Result.save": {"path": "run.npz"},
        "Result.to_csv": {"path": "run.csv"},
        "Plan.save": {"path": "p.plan"},
        "Plan.to_csv": {"path": "p.csv"},
        "Result.mean": {"values": made["result"].t},
        "Bodies.of": {"capsules": {frame: planning.Capsule([0.0] * 3, [0.1, 0.0, 0.0], 0.05)}},
        "KinematicLoop": {"limits": eos_pin.JointLimits.without_torques(made["robot"], velocity=9.0, acceleration=9.0)},
        "simulate_kinematic": {"loop": objects()[eos_pin.KinematicLoop]},
        "KeepTolerance": {
            "law": eos_pin.Damp(),
            "task": (tolerant := objects()[eos_pin.ToleranceTask]),
            "reference": tolerant.hold(np.full(7, 0.3)),
        },
        "ToleranceTask": {"whole": task, "tolerance": {"y": 0.1}},
        "JointTask": {"combinations": [{made["robot"].joints[0].name: 1.0}]},
        "ForceGoal": {"forces": {"x": 5.0}},
        "ImpedanceController.led": {"part": "elbow"},
        "JointMap": {"names": [joint.name for joint in made["robot"].joints]},
        "viewer.write_html": {"path": "motion.html", "scene": eos_pin.Scene(made["robot"]), "t": [0.0, 1.0], "q": rows},
        "viewer.write_replay": {"path": "run.html", "runs": made["result"]},
        "viewer.Scene.pack": {"t": np.array([0.0, 1.0]), "q": rows},
        "viewer.Viewer": {"scene": eos_pin.Scene(made["robot"]), "port": 0},
        "viewer.Viewer.play": {"t": [0.0, 1.0], "q": rows},
        "plots.sweep": {"rows": made["rows of a sweep"], "over": ["kp"]},
        "plots.save": {"path": "figure.png"},
    }.get(label, {})
    kind, _, method = label.rpartition(".")
    thing = next((thing for cls, thing in objects().items() if name_of(cls) == kind), None)
    if method == "broken_limits":
        found = run
    if method == "joint_distances":
        found = {"t": run["t"], "q": rows}
    if method in ("task_acceleration", "asked"):
        found = {"point": task.at(q, q)}
    if isinstance(thing, eos_pin.Task):
        z0 = thing.value(np.full(thing.robot.n, 0.3))
        step, joints = np.full(thing.m, 0.01), np.full(thing.robot.n, 0.3)
        found = {"q": joints, "dq": joints, "z": z0, "z0": z0, "z1": z0, "value": z0, "delta": step, "dz": step}
        found |= {"target": eos_pin.Target(z0, step, step), "data": thing._data, "frame": 2, "z_bar": z0}
        if method == "used":
            found = {"z": z0[None], "targets": z0[None]}
    if method == "compiled_law":
        found = {"drive": values()["state"].drive}
    if kind in ("LimitedEosController", "ImpedanceController"):
        found = found | {"state": thing.start(0.0, q, q)}
    if kind == "OpenLoop":
        found |= {"state": None}
    return found


def name_of(thing):
    """Name of something public; with its room where another room has one of the same name."""
    room = thing.__module__.split(".")[1]
    return f"{room}.{thing.__name__}" if room in ("plots", "viewer") else thing.__name__


def public():
    """Every public function and class, in the order of the rooms."""
    found = {}
    for room in ROOMS:
        module = importlib.import_module(f"eos_pin{room}")
        stub = Path(str(module.__file__)).with_suffix(".pyi").read_text()
        for name in re.findall(r"import \w+ as (\w+)", stub):
            thing = getattr(module, name)
            if not (inspect.isclass(thing) and issubclass(thing, Exception)):
                found[id(thing)] = thing
    return list(found.values())


def callables():
    """Label and callable of everything public: functions, constructors, and methods where a class defines them."""
    seen = set()
    for thing in public():
        label = name_of(thing)
        if thing.__name__ not in BUNDLES | CONTRACTS:
            yield label, thing
        if not inspect.isclass(thing) or thing.__name__ in CONTRACTS:
            continue
        example = objects()[thing]
        for method in dir(thing):
            static = inspect.getattr_static(thing, method)
            if (method.startswith("_") and method != "__call__") or method in OF_TUPLES or id(static) in seen:
                continue
            if isinstance(static, property) or not hasattr(static, "__get__") or type(static).__name__ == "Renamed":
                continue
            if callable(found := getattr(example, method)):
                seen.add(id(static))
                yield f"{label}.{method}", found


def arguments(label, function):
    """Parameters that are tried, and a good value of each that has no default."""
    own, good, names = special(label), {}, []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL, parameter.POSITIONAL_ONLY):
            continue
        name = parameter.name
        names.append(name)
        if name in own:
            good[name] = own[name]
        elif parameter.default is parameter.empty:
            good[name] = values()[name]
    return names, good


def callbacks():
    """Uses of functions and classes of a caller: what they are, and a call of each with a function in their place."""
    made = _made()
    robot, task, q, dq, z, circle = (made[name] for name in ("robot", "task", "q", "dq", "z", "circle"))
    hold, limits, short = made["hold"], made["rows"], {"duration": 0.02}
    gentle = eos_pin.JointLimits.without_torques(robot, velocity=9.0, acceleration=99.0)

    def run(controller):
        eos_pin.simulate(robot, controller, q, **short)
        eos_pin.simulate_sampled(robot, controller, q, control_period=0.002, **short)
        eos_pin.ControlLoop(controller).step(0.0, q, dq)

    def run_objective(objective):
        run(eos_pin.EosController(task, hold, objective))
        eos_pin.LimitedEosController(task, hold, objective).start(0.0, q, dq)
        eos_pin.KinematicLoop(task, hold, objective, control_period=0.001, limits=gentle).step(0.0, q)

    def run_task(own):
        own.value(q), own.linearize(q), own.at(q, dq)
        eos_pin.inverse_kinematics(own, own.value(q), q)
        run(eos_pin.EosController(own, own.hold(q)))
        eos_pin.plan(own, [own.value(q), z + 0.02], limits=limits)

    def run_reference(reference):
        run(eos_pin.EosController(task, reference))
        eos_pin.KinematicLoop(task, reference, control_period=0.001, limits=gentle).step(0.0, q)
        eos_pin.plan(task, reference, limits=limits)

    def override(base, name):
        return lambda f: type("Own", (base,), {name: lambda self, *args: f(*args)})

    yield "tau of OpenLoop", lambda f: run(eos_pin.OpenLoop(f))
    yield "joints of FollowJoints", lambda f: run_objective(eos_pin.FollowJoints(f))
    yield "gradient of DescendPotential", lambda f: run_objective(eos_pin.DescendPotential(f))
    push = lambda f: eos_pin.TaskForce(task, f)  # noqa: E731
    yield "force", lambda f: eos_pin.simulate(robot, made["controller"], q, task_force=push(f), **short)
    yield "cost", lambda f: eos_pin.plan(task, circle, limits=limits, cost=f)
    yield "progress", lambda f: eos_pin.plan(task, circle, limits=limits, progress=f)
    yield "observer of a run", lambda f: eos_pin.simulate(robot, made["controller"], q, observer=f, **short)
    yield "observer of a sweep", lambda f: eos_pin.sweep([made["trial"]], observer=f)
    yield "criterion", lambda f: made["manifold"].best(f)
    yield "v of a path", lambda f: made["atlas"].follow(q, [z, z + 0.01], v=f)
    yield "placement", lambda f: eos_pin.Obstacle(coal.Sphere(0.1), f).at(0.0)
    plot = (Figure().add_subplot(), made["result"], robot)
    yield "discs", lambda f: plots.plot_key_frames(*plot, obstacles=f)
    for hook in ("compute_point", "compute_jacobian", "compute_drift", "minus", "plus", "tracking_acceleration"):
        own = override(eos_pin.PositionTask, hook)
        yield f"Task.{hook}", lambda f, own=own: run_task(own(f)(robot, made["frame"], "xy"))
    for method in ("start", "torque", "validity", "update", "step", "evaluate", "task_deficit", "holding_torque"):
        own = override(type(made["controller"]), method)
        yield f"Controller.{method}", lambda f, own=own: run(own(f)(task, hold))
    own_torque = override(eos_pin.Controller, "torque")
    yield "own Controller", lambda f: run(own_torque(f)())
    for method in ("acceleration", "target", "target_on", "held_law", "sampled_targets", "joint_distances"):
        own = override(eos_pin.Track, method)
        yield f"Objective.{method}", lambda f, own=own: run_objective(own(f)())
    own_null = override(eos_pin.NullSpaceLaw, "torque")
    yield "NullSpaceLaw", lambda f: run(eos_pin.OperationalSpaceController(task, hold, own_null(f)()))
    own_path = override(eos_pin.Trajectory, "__call__")
    yield "Trajectory", lambda f: run_reference(own_path(f)())
    late = lambda f: own_path(lambda t: hold(t) if t == 0.0 else f(t))()  # noqa: E731
    yield "Trajectory, later", lambda f: run_reference(late(f))
    nan = eos_pin.Target(z * np.nan, z, z)
    yield "Trajectory, its numbers", lambda f: run_reference(late(lambda t: nan if f(t) is None else f(t)))
