"""Shortcomings of a run that ended: parts of tasks given up, limits and bands passed, joints elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array
from eos_pin.control.base import Controller
from eos_pin.control.objectives import Further
from eos_pin.simulation.result import TASK_DEFICIT, Result
from eos_pin.tasks.base import Task

#: A run that ends with joints this far from those they were to follow has not followed them [rad or m].
ELSEWHERE = 1e-2
#: A band counts as passed beyond this, as a part of it.
BAND = 1e-3


def with_shortcomings(
    run: Result, task: Task | None, passed: str, apart: Array | None, further: Sequence[Further | None] = (None,)
) -> Result:
    """The run with its shortcomings: part of a task given up, limits or bands passed, joints elsewhere.

    Args:
        run: The run.
        task: Its task.
        passed: Which limits were passed, in words; empty where none were.
        apart: Distances of the joints from those to follow, at every sample; None where none are followed.
        further: Further task at every sample; None where none is tracked.
    """
    if apart is not None:
        joint_distance = {"max": float(apart.max()), "end": float(apart[-1])}
        run = replace(run, info={**run.info, "joint_distance": joint_distance})
    beside = _beside(run, further)
    if beside:
        errors = np.array([row.error for row in further if row is not None])
        run = replace(run, info={**run.info, "further_task": beside}, further_error=errors)
    used = _used(task, run)
    if used is not None:
        parts = dict(zip(task.bands, used.max(axis=0).tolist(), strict=True)) if task else {}
        run = replace(run, info={**run.info, "tolerance_used": parts})
    if not run.ok:
        return run
    lost = run.deficit_rows
    why = {"task": "near a singularity of the task", "limit": "to keep the limits"}
    when = "; ".join(
        f"{why[kind]} for {met['seconds']:.3g} s, first at t = {met['first']:.4g} s"
        for kind, met in run.singularities.items()
        if kind in why
    )
    elsewhere, yielded = _elsewhere(apart), bool(beside and beside["given_up_seconds"])
    messages = [passed] * bool(passed) + [f"part of the task was given up {when}"] * bool(lost.any())
    if yielded:
        messages.append(
            f"part of the further task, {beside['kind']} of {beside['frame']}, was given up to keep the limits for "
            f"{beside['given_up_seconds']:.3g} s, first at t = {beside['first']:.4g} s"
        )
    beyond = np.zeros(len(run.t), dtype=bool) if used is None else np.any(used > 1.0 + BAND, axis=1)
    if beyond.any():
        widest = ", ".join(f"{name} {part:.3g} times" for name, part in parts.items() if part > 1.0 + BAND)
        messages.append(
            f"bands of the task were passed ({widest}) for {run._seconds(beyond):.3g} s, first at "
            f"t = {run.t[beyond][0]:.4g} s"
        )
    messages += [elsewhere] * bool(elsewhere)
    # While the controller settles that is to be expected; later the run has not done what it was to do.
    degraded = passed or elsewhere or (lost | beyond)[run.settled_row :].any() or (yielded and beside["settled"])
    return replace(run, status="degraded" if degraded else run.status, message=". Also, ".join(messages) or run.message)


def _used(task: Task | None, run: Result) -> Float[Array, "T B"] | None:
    """Part of each band that is in use; None where the task has none, or its targets are not known."""
    if task is None or not task.bands or not np.isfinite(run.z_ref).all():
        return None
    used: Float[Array, "T B"] = np.linalg.norm(task.used(run.z, run.z_ref), axis=2)
    return used


def _beside(run: Result, further: Sequence[Further | None]) -> dict[str, Any]:
    """Further task of a run in plain values: errors after transients, and where limits took part of it."""
    seen = [row for row in further if row is not None]
    if not seen:
        return {}
    error = np.array([row.error for row in seen])
    deficit = np.abs(np.array([row.deficit for row in seen]))
    lost: Array = (deficit > TASK_DEFICIT).any(axis=1)
    late, task = run.settled_row, seen[0].task
    return {
        "kind": task.kind or str(task),
        "frame": task.frame,
        "error_max": float(np.abs(error[late:]).max(initial=0.0)),
        "error_end": float(np.abs(error[-1]).max()),
        "given_up_seconds": run._seconds(lost),
        "first": float(run.t[lost][0]) if lost.any() else None,
        "settled": bool(lost[late:].any()),
    }


def _elsewhere(apart: Array | None) -> str:
    """Message about joints far from the planned ones at the end of a run; empty if they are near."""
    if apart is None or apart[-1] <= ELSEWHERE:
        return ""
    return (
        f"the joints ended {apart[-1]:.3g} rad or m away from those they were to follow, whatever the task did: they "
        "are on another component of the self-motion, still on their way back, or too slow"
    )


def not_measured(controller: Controller) -> str:
    """Sentence about figures that a run lacks because its controller has set no task or no reference."""
    missing = controller.unset
    if not missing:
        return ""
    return (
        f"no task error is known: {type(controller).__name__} has no attribute {' and no '.join(missing)}. Set "
        f"{' and '.join(missing)} in its constructor, to None where there is none"
    )
