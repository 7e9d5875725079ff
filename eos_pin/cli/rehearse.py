"""`eos-pin rehearse`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from eos_pin._files import check_writable
from eos_pin.cli.output import console, grid, print_files, say_notes, stderr, warn_of_gravity, write_json
from eos_pin.errors import InputError
from eos_pin.experiments.options import ControlOptions, PathOptions, RobotOptions, TaskOptions, check_options

# What the commands need beyond their options is imported where it is used, so that `eos-pin --help` is quick.
if TYPE_CHECKING:
    from eos_pin.control.hardware.runner import RunReport


@dataclass(frozen=True)
class RealTime:
    """Options of the loop.

    Attributes:
        control_rate: Periods per second [Hz].
        soft_start: Time in which the torque goes over from that of gravity to the controller's [s].
        torque_rate: Most that a torque changes in a second [N m/s or N/s].
        speed: Speed along the path; 1 is its own.
        watchdog: Time without a command after which the robot is stopped [s].
        priority: Priority of the loop among the real-time threads of the machine, from 1 to 99; it takes the right to.
        model_error: Largest relative error of masses, centres of mass and inertias in the controller's model.
        log: File for the log (.csv); by default runs/ROBOT-TASK/log.csv.
        json: File for the figures, machine-readable.
        seed: Seed of the model error.
    """

    control_rate: float = 1000.0
    soft_start: float = 0.2
    torque_rate: float | None = None
    speed: float = 1.0
    watchdog: float = 0.1
    priority: int = 0
    model_error: float = 0.0
    log: Path | None = None
    json: Path | None = None
    seed: int = 0


def rehearse(
    robot: RobotOptions,
    task: TaskOptions = TaskOptions(),
    path: PathOptions = PathOptions(),
    control: ControlOptions = ControlOptions(),
    loop: RealTime = RealTime(),
) -> int:
    """Run the loop of a real robot against MuJoCo, in real time; print deadlines that were missed and the latency.

    The code is that which drives a robot: a start at rest with a soft torque, a path that gathers speed, a graceful
    stop, a watchdog, and a log that outlives the process. Ctrl-C is a graceful stop, twice is an emergency stop.

    Args:
        robot: The robot.
        task: Task of the robot.
        path: Path of the task.
        control: Controller and its gains.
        loop: How the loop runs.

    For example:

      eos-pin rehearse panda --duration 60
      eos-pin rehearse panda --task pose --controller eos-limited --log log.csv
    """
    from eos_pin._arrays import number
    from eos_pin.control.hardware.log import RunLog
    from eos_pin.control.hardware.runner import Runner
    from eos_pin.control.kinematic import KinematicLoop
    from eos_pin.control.loop import ControlLoop
    from eos_pin.experiments.commanded import commanded_loop
    from eos_pin.simulation.mujoco import MujocoPlant
    from eos_pin.simulation.rehearsal import MujocoConnection
    from eos_pin.trajectories.pace import Clock, PacedPath

    check_options(task, path, control)
    if control.command != "torque" and (loop.torque_rate is not None or loop.soft_start != RealTime.soft_start):
        raise InputError("--soft-start and --torque-rate do not apply: no torques are commanded; leave them out")
    if loop.seed and not loop.model_error:
        raise InputError(f"--seed {loop.seed} does not apply: nothing is random; add --model-error")
    period = 1.0 / number(loop.control_rate, "the rate", above=0.0)
    file = loop.log or Path("runs") / f"{Path(robot.robot).stem}-{task.task}" / "log.csv"
    check_writable(*filter(None, (file, loop.json)))
    machine = robot.load()
    say_notes(machine)
    goal, q = task.make(machine, led=True)
    further = task.make_further(machine, q)
    reference = path.make(goal, q)
    say_notes(reference)
    clock: Clock | None = None
    driver: ControlLoop | KinematicLoop
    if control.command == "torque":
        warn_of_gravity(machine, q)
        clock = Clock(speed=0.0)
        further = further and (further[0], PacedPath(further[1], clock))
        controller = control.make(goal, PacedPath(reference, clock), q, period, further=further)
        driver = ControlLoop(controller, soft_start=loop.soft_start, torque_rate=loop.torque_rate)
    else:
        driver = commanded_loop(control, goal, reference, q, period=period, further=further)
    e = loop.model_error
    plant = machine.perturbed(mass=e, com=e, inertia=e, seed=loop.seed) if e else machine
    connection = MujocoConnection(MujocoPlant.from_robot(plant), q, command=control.command, control_period=period)
    log = RunLog(file, machine.joint_names, control.command)
    runner = Runner(connection, driver, clock=clock, log=log, watchdog=loop.watchdog, priority=loop.priority)
    runner.set_speed(loop.speed)
    duration = path.length(reference)
    stderr.print(f"{machine.name}, {task.task}: {duration:g} s in real time; Ctrl-C stops it", markup=False)
    report = runner.run(duration)
    console.print(grid(f"{machine.name}: rehearsal", ("what", "figure"), _lines(report)))
    files = [file]
    if loop.json is not None:
        files.append(write_json(loop.json, asdict(report)))
    print_files(files)
    return 0 if report.ok else 1


def _lines(report: RunReport) -> list[tuple[str, object]]:
    """Lines of the table."""
    status = f"{report.status}: {report.message}" if report.message else report.status
    return [
        ("status", status),
        ("time, s", report.seconds),
        ("states read", report.samples),
        ("states refused", report.refused),
        ("deadlines missed", report.missed),
        ("latency, median, ms", 1e3 * report.latency_median),
        ("latency, one in 1,000 is longer, ms", 1e3 * report.latency_p999),
        ("latency, worst, ms", 1e3 * report.latency_max),
    ]
