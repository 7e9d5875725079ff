"""The command `eos-pin plan`: joints along a whole task path, or the reason why there are none."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from eos_pin._arrays import JointVector
from eos_pin._files import check_writable
from eos_pin.cli.output import (
    Output,
    SeededOutput,
    console,
    format_number,
    print_files,
    say_notes,
    show,
    stderr,
    title_of,
    write_json,
    write_outputs,
)
from eos_pin.cli.tables import KEY, speed_at_ends
from eos_pin.errors import InputError, PlanError
from eos_pin.experiments.options import RobotOptions, TaskOptions
from eos_pin.trajectories.corners import Corners

if TYPE_CHECKING:
    from eos_pin.planning.attempts import Progress as Report
    from eos_pin.planning.obstacles.bodies import Bodies, Clearances
    from eos_pin.planning.obstacles.scene import Scene
    from eos_pin.planning.plans import Plan
    from eos_pin.robot.model import Robot
    from eos_pin.tasks.base import Task
    from eos_pin.trajectories.base import Trajectory

#: Figures that the JSON has whatever happens.
FIGURES = (
    "closed", "waypoints", "reconfigurations", "task_error_max", "joint_step_max", "joint_motion", "limit_distance_min",
    "clearance_min", "switches", "seconds",
)  # fmt: skip


@dataclass(frozen=True)
class PlanPath:
    """Path of the task.

    Attributes:
        path: Figure eight, circle, line, or a file of way points whose first row names its columns: x, y, z [m]; qw,
            qx, qy, qz, or roll, pitch, yaw [rad]; t [s] if there are times. Without orientation it stays as it is at
            q0. Or the way points themselves, such as "0.4 0 0.5; 0.4 0.2 0.5".
        size: Half width or radius [m]; by default as large as the robot can follow at q0.
        centre: Centre of a circle or eight, one end of a line [m]; by default the path begins at q0.
        plane: Plane of the path, such as yz, or one axis for a line.
        period: Time of one round [s]; by default as short as half the velocity limits allow.
        closed: The joints return to where they began.
        corners: Way points on a smooth curve, on straight lines with rounded corners, or with a stop at each.
        blend: Distance from a way point at which a rounded corner leaves the line [m]; by default a tenth of the line.
    """

    path: str = "eight"
    size: float | None = None
    centre: tuple[float, float, float] | None = None
    plane: str | None = None
    period: float | None = None
    closed: bool = False
    corners: Corners = "smooth"
    blend: float | None = None

    def make(self, task: Task, q: JointVector) -> Trajectory:
        """The path: from a file, about a centre, or through the task point at q."""
        from eos_pin.experiments.defaults import fitting_path
        from eos_pin.trajectories.through import about, read_path
        from eos_pin.trajectories.waypoints import is_table

        if is_table(self.path):
            for name in ("size", "centre", "plane", "period"):
                if getattr(self, name) is not None:
                    raise InputError(f"--{name} does not apply: it belongs to the paths eight, circle and line")
            drawn: dict[str, Any] = {"closed": self.closed, "corners": self.corners, "blend": self.blend}
            return read_path(self.path, task, task.value(q), **drawn)
        if (self.corners, self.blend) != ("smooth", None):
            raise InputError(f"--corners {self.corners} does not apply: it belongs to way points")
        if self.path not in ("eight", "circle", "line"):
            known = "eight, circle, line, the name of a .csv file, or way points separated by semicolons"
            raise InputError(f"a path is {known}; got {self.path!r}")
        if self.centre is None:
            size, plane, period = self.size, self.plane, self.period
            return fitting_path(task, q, shape=self.path, size=size, plane=plane, period=period)  # type: ignore[arg-type]
        if self.size is None:
            raise InputError("a path with a --centre needs its --size")
        return about(task, task.value(q), self.path, self.centre, self.size, self.plane, self.period or 8.0)


@dataclass(frozen=True)
class Obstructed:
    """Obstacles and files to keep.

    Attributes:
        scene: YAML or JSON file with lists of solids at rest: boxes (centre, size, rotation w x y z), spheres (centre,
            radius), capsules (from, to, radius), meshes (file, centre, rotation, scale), in metres.
        self_collision: Keep the robot's links clear of each other.
        capsules: JSON file with the robot's capsules, in place of those fitted around its collision shapes: for each
            link from, to and radius, in the link's frame; `pairs_not_checked` lists pairs of links.
        clearance: Least distance [m].
        margin: Room that is kept from joint limits [rad or m].
        joint_step: Longest step of a joint from one way point to the next [rad or m].
        cost: Costs beside that of joint motion, each with its weight or 1, such as limits=0.5 torque=2: posture
            (near to --start, or to zero), limits, clearance, manipulability, torque (of gravity), energy (motion
            weighed by inertia).
        start: Joints to begin at, n numbers [rad or m].
        reconfigurations: Let the joints jump where no continuous motion exists, as few times as possible.
        allow_winding: Let joints without limits end each round of a closed path whole turns away from where they began.
        effort: How many times the search is refined before it gives up.
    """

    scene: Path | None = None
    self_collision: bool = False
    capsules: Path | None = None
    clearance: float = 0.0
    margin: float = 0.01
    joint_step: float | None = None
    cost: tuple[str, ...] = ()
    start: tuple[float, ...] = ()
    reconfigurations: bool = False
    allow_winding: bool = False
    effort: int = 3

    def check(self) -> None:
        """Refuse options that change nothing where there is nothing to keep clear of.

        Raises:
            InputError: One of them is given.
        """
        if self.scene is None and not self.self_collision:
            for name in ("clearance", "capsules"):
                if getattr(self, name):
                    reason = "there is nothing to be clear of; add --scene FILE or --self-collision"
                    raise InputError(f"--{name} {getattr(self, name)} does not apply: {reason}")

    def costs(self) -> dict[Any, float] | None:
        """Costs by name with their weights; None without."""
        made: dict[Any, float] = {}
        for text in self.cost:
            name, _, weight = text.partition("=")
            try:
                made[name] = float(weight) if weight else 1.0
            except ValueError:
                wanted = "names, or names with weights, such as limits=0.5"
                raise InputError(f"--cost takes {wanted}; got {text!r}") from None
        return made or None

    def bodies(self, robot: Robot) -> Bodies | None:
        """The robot's capsules; None where they are not needed or are to be fitted."""
        from eos_pin.planning.obstacles.bodies import Bodies
        from eos_pin.planning.obstacles.scene import Capsule

        if self.capsules is None:
            return None
        try:
            data = json.loads(self.capsules.read_text(encoding="utf-8"))
            links = data.get("capsules", data)
            pairs = data.get("pairs_not_checked", [])
            made = {
                str(link): Capsule(c["from"], c["to"], c["radius"], str(link))
                for link, c in links.items()
                if link != "pairs_not_checked"
            }
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot read the capsules {self.capsules}: {error}") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(
                f"{self.capsules} is not a file of capsules ({error}); for each link it needs "
                '"LINK": {"from": [x, y, z], "to": [x, y, z], "radius": r}'
            ) from error
        return Bodies.of(robot, made, pairs)


@dataclass(frozen=True)
class PlanTiming:
    """The time of the motion.

    Attributes:
        timing: The path's own pace, or the fastest within the limits of velocity, acceleration and torque.
        acceleration: Largest accelerations of the joints, one number or n [rad/s² or m/s²].
        torque_limits: Keep the robot's torque limits.
    """

    timing: Literal["own", "fastest"] = "own"
    acceleration: tuple[float, ...] = ()
    torque_limits: bool = False

    @property
    def accelerations(self) -> float | list[float] | None:
        """Accelerations as `plan` takes them."""
        return self.acceleration[0] if len(self.acceleration) == 1 else [*self.acceleration] or None

    def apply(self, found: Plan) -> Plan:
        """The plan in the time that was asked for."""
        if self.timing == "own":
            return found
        from eos_pin.planning.limit_use import MotionLimits
        from eos_pin.planning.timing import fastest, measured

        limits = MotionLimits.of(found.robot, acceleration=self.accelerations, torque=self.torque_limits)
        return measured(fastest(found, limits), limits)


def plan(
    robot: RobotOptions,
    task: TaskOptions = TaskOptions(),
    path: PlanPath = PlanPath(),
    within: Obstructed = Obstructed(),
    time: PlanTiming = PlanTiming(),
    output: SeededOutput = SeededOutput(),
    save: Annotated[Path | None, tyro.conf.arg(name="plan")] = None,
) -> int:
    """Plan joints along a whole task path: continuous, within limits, clear of obstacles, closed on request.

    Exit code 0: planned; 1: refused, with the reason, or stopped; 2: bad input. Files go where --plan, --json, --csv,
    --html, --plot or --out say.

    Args:
        robot: The robot.
        task: Task of the robot.
        path: Path of the task.
        within: Obstacles and files to keep.
        time: The time of the motion.
        output: Results to keep.
        save: File for the plan (.npz), which `eos-pin track --plan` follows.

    For example:

      eos-pin plan panda --path circle --size 0.45 --centre 0 0 0.5 --closed --plan circle.npz
      eos-pin plan panda --path path.csv --task pose --scene boxes.yaml --self-collision --csv joints.csv
      eos-pin plan panda --path circle --size 0.3 --timing fastest --acceleration 10 --torque-limits --plan fast.npz
      eos-pin track panda --plan circle.npz
    """
    from eos_pin.planning.obstacles.scene import read_scene
    from eos_pin.planning.planner import plan as planned

    files = output.within(
        None, names={"json": "plan.json", "csv": "joints.csv", "html": "replay.html", "plot": "plan.png"}
    )
    check_writable(*([save] if save else []))
    within.check()
    if time.timing == "fastest" and path.period is not None:
        raise InputError(f"--period {path.period:g} does not apply: --timing fastest finds the time")
    machine = robot.load()
    say_notes(machine)
    goal, q = task.make(machine, kept=True)
    say_notes(goal)
    curve = path.make(goal, q)
    scene = read_scene(within.scene) if within.scene is not None else None
    bodies = within.bodies(machine)
    wanted = save or (files.out / "plan.npz" if files.out else None)
    timed = None if path.path.lower().endswith((".csv", ".tsv", ".txt")) else path.period is not None
    own = time.timing == "own"
    with _progress(f"{machine.name}, {task.task}") as report:
        try:
            found = planned(
                goal,
                curve,
                closed=path.closed,
                scene=scene,
                bodies=bodies,
                self_collision=within.self_collision,
                clearance=within.clearance,
                margin=within.margin,
                joint_step=within.joint_step,
                cost=within.costs(),
                start=within.start or None,
                reconfigurations=within.reconfigurations,
                allow_winding=within.allow_winding,
                keep_time=timed if own else False,
                acceleration=time.accelerations if own else None,
                torque=own and time.torque_limits,
                seed=output.seed,
                effort=within.effort,
                progress=report,
            )
            found = time.apply(found)
        except PlanError as error:
            report("", 1.0)
            return _refused(error, files, path.closed)
    console.print(_table(found))
    if found.info["message"]:
        stderr.print(found.info["message"], soft_wrap=True)
    print_files(_deliver(found, files, wanted, scene, _clearances(within, machine, bodies, scene)))
    return 0 if found.status == "planned" else 1


def _refused(error: PlanError, files: Output, closed: bool) -> int:
    """Report the reason of a refusal, on the terminal and in the JSON."""
    status = "interrupted" if error.stopped else "refused"
    stderr.print(f"[bold]{status}:[/] ", end="")
    stderr.print(str(error), markup=False, soft_wrap=True)
    if files.json is not None:
        info = dict.fromkeys(FIGURES) | {"closed": closed, "waypoint": error.waypoint, "reached": error.reached}
        info |= error.info
        print_files([write_json(files.json, {"status": status, "message": str(error)} | info)])
    return 1


def _clearances(within: Obstructed, robot: Robot, bodies: Bodies | None, scene: Scene | None) -> Clearances | None:
    """Distances that count; None where nothing is to be kept clear of."""
    from eos_pin.planning.obstacles.bodies import Bodies, Clearances
    from eos_pin.planning.obstacles.scene import Scene

    if scene is None and not within.self_collision:
        return None
    bodies = bodies or Bodies.fitted(robot)
    return Clearances(bodies if within.self_collision else Bodies(robot, bodies.capsules, ()), scene or Scene())


def _deliver(
    found: Plan, files: Output, wanted: Path | None, scene: Scene | None, clearances: Clearances | None
) -> list[Path]:
    written = []
    if wanted is not None:
        written.append(found.save(wanted))
    if files.json is not None:
        written.append(write_json(files.json, found.info))
    if files.csv is not None:
        written.append(found.to_csv(files.csv, derivatives=False))
    if files.bag is not None:
        written.append(found.to_bag(files.bag))
    return written + _draw(found, files, scene, clearances)


def _draw(found: Plan, files: Output, solids: Scene | None, clearances: Clearances | None) -> list[Path]:
    """Write the figure, the replay and the file for Rerun that are asked for."""
    from eos_pin.plots.pages import save
    from eos_pin.plots.plan import picture
    from eos_pin.simulation._recorder import joint_run
    from eos_pin.trajectories.through import sampled
    from eos_pin.viewer.solids import obstacles_of

    written = [] if files.plot is None else [save(picture(found, clearances), files.plot)]
    if files.html is not None or files.rerun is not None or files.view:
        times, q, dq, ddq = found.table(min(2000, 4 * len(found.times)) / (found.end - found.start))
        z = sampled(found.path, times)
        result = joint_run(found.task, times - found.start, q, z, dq=dq, ddq=ddq, period=found.period)
        told: dict[str, Any] = {"obstacles": obstacles_of(solids), "title": f"{found.robot.name}: plan"}
        written += write_outputs(Output(html=files.html, rerun=files.rerun), result, found.robot, **told)
        if files.view:
            show({"": result}, {"": found.robot}, **told)
    return written


def _table(found: Plan) -> Any:
    from rich.table import Table

    info = found.info
    table = Table(title=title_of(found.robot, found.task), show_header=False)
    table.add_row("status", info["status"])
    table.add_row(
        "path", f"{'closed' if info['closed'] else 'open'}, {info['waypoints']} way points, {info['duration']:.4g} s"
    )
    table.add_row("reconfigurations", str(info["reconfigurations"]))
    for name, turns in info["winding"].items():
        table.add_row(f"whole turns of {name} each round", str(turns))
    table.add_row("task error, at any time", f"{format_number(info['task_error_max'])} m or rad")
    table.add_row("largest step of a joint", f"{format_number(info['joint_step_max'])} rad or m")
    table.add_row("joint motion", f"{format_number(info['joint_motion'])} rad")
    table.add_row("least distance from a limit", f"{format_number(info['limit_distance_min'])} rad or m")
    if info["clearance_min"] is not None:
        table.add_row("least clearance", f"{format_number(info['clearance_min'])} m")
    for name, part in info.get("tolerance_used", {}).items():
        table.add_row(f"largest part of the tolerance {name}", f"{part:.4g}")
    for what in ("velocity", "acceleration", "torque"):
        part = info.get(f"{what}_part_max")
        if part is not None:
            table.add_row(f"largest part of a limit of {what}", f"{part:.4g}")
    table.add_row("chart switches at margin 0.5", str(info["switches"]))
    if not found.closed:
        table.add_row("joint speed at the ends", speed_at_ends(found(found.start).dq, found(found.end).dq))
    table.add_row("planning time", f"{info['seconds']:.2f} s")
    table.caption, table.caption_justify = KEY, "left"
    return table


@contextmanager
def _progress(title: str) -> Iterator[Report]:
    """Progress bar on the terminal."""
    columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeElapsedColumn()
    with Progress(*columns, console=stderr, transient=True) as progress:
        bar = progress.add_task(title, total=1.0)
        yield lambda what, part: progress.update(bar, description=f"{title}: {what}", completed=part)
