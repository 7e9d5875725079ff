"""`eos-pin selfmotion`: the self-motion at a task point as a mechanical system of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from eos_pin.cli.output import (
    SeededOutput,
    console,
    format_number,
    grid,
    print_files,
    say_notes,
    stderr,
    title_of,
    write_json,
)
from eos_pin.errors import InputError
from eos_pin.experiments.options import RobotOptions, TaskOptions

# What the command needs beyond its options is imported where it is used, so that `eos-pin --help` is quick.
if TYPE_CHECKING:
    from eos_pin.planning.manifolds.equilibria import Crossing, Equilibrium


#: Words for the columns of the table.
KEY = (
    "Arc lengths along a component of the self-motion manifold are in rad or m. Beside a stable posture small motions "
    "swing at a frequency, beside an unstable one they grow by a rate."
)


def selfmotion(
    robot: RobotOptions,
    task: TaskOptions = TaskOptions(),
    output: SeededOutput = SeededOutput(),
    at: tuple[float, ...] = (),
) -> int:
    """Find equilibria of the self-motion under gravity while the task is held, their frequencies, and ways between.

    The task is held by forces on the task alone, and the joints are otherwise free. With one redundant joint all
    equilibria are found; with more those that searches from many postures end at.

    Args:
        robot: The robot.
        task: Task of the robot.
        output: Results to keep.
        at: Task point; by default that at q0. As many numbers as `eos-pin ik --to` takes.

    For example:

      eos-pin selfmotion panda --task pose
      eos-pin selfmotion xarm7 --task pose --at 0.4 0.1 0.3 --plot potential.png
      eos-pin selfmotion planar_chain_10 --gravity 0 -9.81 0
    """
    from eos_pin.experiments.path_files import task_point
    from eos_pin.planning.manifolds.equilibria import crossings, equilibria
    from eos_pin.planning.manifolds.manifold import self_motion_manifold

    output.within(None, names={})
    output.without("csv", "bag", "rerun", "html", "view", reason="nothing moves here")
    machine = robot.load()
    say_notes(machine)
    goal, q = task.make(machine)
    say_notes(goal)
    if output.plot and machine.n - goal.m != 1:
        raise InputError(
            f"--plot {output.plot} does not apply: the figure has the potential along a curve, of one redundant joint; "
            f"here are {machine.n - goal.m}; leave it out"
        )
    z = task_point(goal, at, q) if at else goal.value(q)
    manifold = self_motion_manifold(goal, z, starts=[] if at else [q], seed=output.seed)
    found = equilibria(manifold, starts=[] if at else [q], seed=output.seed)
    ways = crossings(manifold, found)
    names = {"json": "selfmotion.json"} | ({"plot": "potential.png"} if manifold.components else {})
    files = output.within(None, names=names)
    title = f"{title_of(machine, goal)}: equilibria of the self-motion under gravity"
    columns = ("number", "component", "arc length", "energy [J]", "at rest it is", "small motions", "joint limits")
    console.print(grid(title, columns, [_row(k, each) for k, each in enumerate(found)], KEY))
    if ways:
        rows = [
            (
                f"{way.start} to {way.end}, over {way.top}",
                f"{way.energy:.4g}",
                "kept" if way.within_limits else "passed",
            )
            for way in ways
        ]
        console.print(grid("Ways over the top", ("way", "energy needed [J]", "joint limits"), rows))
    if not found:
        stderr.print(
            "No equilibrium was found: the search begins at postures that are within limits; try another --seed."
        )
    written = []
    if files.json:
        written.append(write_json(files.json, _figures(found, ways)))
    if files.plot:
        from eos_pin.plots import pages
        from eos_pin.plots.potential import potential

        written.append(pages.save(potential(manifold, found), files.plot))
    print_files(written)
    return 0


def _row(k: int, each: Equilibrium) -> tuple[Any, ...]:
    parts = []
    if len(each.frequencies):
        parts.append(f"{', '.join(format_number(f) for f in each.frequencies)} Hz")
    if len(each.growth):
        parts.append(f"grow by {', '.join(format_number(g) for g in each.growth)} /s")
    place = (each.component, f"{each.s:.4f}") if each.component >= 0 else ("-", "-")
    kind = "stable" if each.stable else "unstable"
    return (k, *place, f"{each.potential:.4g}", kind, "; ".join(parts), "kept" if each.within_limits else "passed")


def _figures(found: tuple[Equilibrium, ...], ways: tuple[Crossing, ...]) -> dict[str, Any]:
    """Contents of the JSON."""
    names = (
        "q",
        "component",
        "s",
        "potential",
        "stable",
        "within_limits",
        "eigenvalues",
        "frequencies",
        "growth",
        "modes",
    )
    return {
        "equilibria": [{name: getattr(each, name) for name in names} for each in found],
        "crossings": [way._asdict() for way in ways],
    }
