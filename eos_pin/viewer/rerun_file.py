"""Motions as files of Rerun: the robot moving beside the curves of joints, task and self-motion."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array, Vector, checked
from eos_pin._files import write_atomically
from eos_pin.errors import MissingDependencyError, OutputError
from eos_pin.viewer._meshes import link_meshes, skeleton, solid_mesh
from eos_pin.viewer.scene import Scene

#: Name of the timeline.
TIME = "time"


@checked
def write_rerun(
    path: str | Path,
    scene: Scene,
    t: Vector,
    q: Float[np.ndarray, "k n"],
    curves: Mapping[str, Float[np.ndarray, " k"]] | None = None,
) -> Path:
    """Write a motion as a file that Rerun's viewer opens (.rrd).

    Args:
        path: The file.
        scene: Robot, paths and obstacles in view.
        t: Times [s].
        q: Joints at these times.
        curves: Numbers over time by their place in the file, such as `joints/elbow/q`.

    Returns:
        The file.

    Raises:
        MissingDependencyError: rerun-sdk is not installed.
        OutputError: The file cannot be written.
    """
    rerun, path = _imported(), Path(path)

    def write(file: Any) -> None:
        recording = rerun.RecordingStream("eos_pin", recording_id=scene.title or scene.robot.name)
        # It opens the file of this name itself; its bytes go through ours, which is renamed when it is whole.
        recording.save(file.name)
        _log_scene(rerun, recording, scene, t, q)
        index = rerun.TimeColumn(TIME, duration=t)
        for place, values in (curves or {}).items():
            recording.send_columns(place, [index], rerun.Scalars.columns(scalars=values))
        recording.flush()
        recording.disconnect()

    try:
        write_atomically(path, write)
    except RuntimeError as error:
        raise OutputError(f"cannot write {path}: {error}") from error
    return path


def _log_scene(rerun: ModuleType, recording: Any, scene: Scene, t: Vector, q: Array) -> None:
    """Meshes of the bodies once, and their poses over time."""
    visual = scene.robot.visual
    items = list(visual.geometryObjects) if visual is not None else []
    poses = np.array([scene.poses(*frame) for frame in zip(t.tolist(), q, strict=True)])
    index = rerun.TimeColumn(TIME, duration=t)
    places = ["robot", *(f"robot/{name}" for name in list(scene.robot.model.names)[1:])]
    places += [f"obstacles/{i}" for i in range(len(scene.obstacles))]
    for place, pose in zip(places[1:], poses.transpose(1, 0, 2), strict=True):
        columns = rerun.Transform3D.columns(translation=pose[:, :3], quaternion=pose[:, 3:])
        recording.send_columns(place, [index], columns)
    for k, item in enumerate(items or skeleton(scene.robot)):
        for i, mesh in enumerate(link_meshes(item)):
            own = None if item.overrideMaterial else mesh.color
            vertices = mesh.vertices @ item.placement.rotation.T + item.placement.translation
            shape = _mesh(rerun, vertices, mesh.faces, own or item.meshColor)
            recording.log(f"{places[item.parentJoint]}/shape_{k}_{i}", shape, static=True)
    for i, obstacle in enumerate(scene.obstacles):
        mesh = solid_mesh(obstacle.shape)
        shape = _mesh(rerun, mesh.vertices, mesh.faces, obstacle.color)
        recording.log(f"obstacles/{i}/shape", shape, static=True)
    for name, points in scene.paths.items():
        recording.log(f"paths/{name}", rerun.LineStrips3D([points]), static=True)


def _mesh(rerun: ModuleType, vertices: Array, faces: Array, color: Any) -> Any:
    rgba = (255 * np.asarray(color, dtype=float)).round().astype(np.uint8)
    return rerun.Mesh3D(vertex_positions=vertices, triangle_indices=faces, albedo_factor=rgba)


def _imported() -> ModuleType:
    try:
        import rerun
    except ImportError as error:
        raise MissingDependencyError("a file of Rerun", "rerun-sdk", "pip install 'eos-pin[rerun]'") from error
    return rerun
