"""A run of a planar robot as an animated GIF, small enough for a page of text."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from eos_pin._arrays import number
from eos_pin._files import write_atomically
from eos_pin.errors import InputError
from eos_pin.plots._style import add_axes, style
from eos_pin.plots.keyframes import is_spatial, plot_key_frames
from eos_pin.robot.model import Robot
from eos_pin.simulation.result import Result

#: Age of the ghosts that show where the robot comes from [s].
GHOSTS = (0.45, 0.3, 0.15, 0.0)


def write_gif(
    path: str | Path,
    result: Result,
    robot: Robot,
    *,
    trace: Sequence[str] | None = None,
    start: float = 0.0,
    end: float | None = None,
    fps: float = 10.0,
    size: tuple[int, int] = (420, 320),
) -> Path:
    """Write part of a run as an animated GIF that plays in real time, over and over.

    Args:
        path: File to write.
        result: The run.
        robot: The plant, in a plane.
        trace: Frames whose last half second is drawn; by default that of the task.
        start: Time of the first frame [s].
        end: Time of the last frame [s]; by default the end of the run.
        fps: Frames per second, of which a GIF takes hundredths of seconds.
        size: Width and height in pixels.

    Raises:
        InputError: The robot leaves its plane.
        OutputError: The file cannot be written.
    """
    if is_spatial(robot, result):
        raise InputError(f"{robot.name!r} moves in space; a GIF shows planar robots, a replay shows any")
    end = float(result.t[-1]) if end is None else min(end, float(result.t[-1]))
    pause = round(100.0 / number(fps, "fps", above=0.0)) / 100.0
    frames: list[Image.Image] = []
    with style():
        figure = Figure((size[0] / 100.0, size[1] / 100.0), dpi=100, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        ax = add_axes(figure, 111)
        limits = _limits(robot, result, start, end)
        for t in np.arange(start, end - 0.5 * pause, pause):
            ax.clear()
            ages = np.maximum(t - np.array(GHOSTS), start)
            plot_key_frames(ax, result, robot, times=np.unique(ages), trace=trace, label_times=False)
            ax.legend_ = None  # it would cover the title, and changes nothing
            ax.set_aspect("equal", adjustable="box")
            ax.set(xlim=limits[0], ylim=limits[1], title=f"t = {t:.1f} s")
            canvas.draw()  # type: ignore[no-untyped-call]
            # One layout for all frames: nothing jumps, and finding it takes most of the time.
            figure.set_layout_engine("none")
            pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
            frames.append(Image.fromarray(pixels[:, :, :3].copy()))
    # One palette for all frames: what does not change between them then takes no space.
    palette = frames[len(frames) // 2].quantize(64, dither=Image.Dither.NONE)
    images = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    data = BytesIO()
    images[0].save(
        data, format="GIF", save_all=True, append_images=images[1:], duration=round(1000 * pause), loop=0, optimize=True
    )
    write_atomically(path, lambda file: file.write(data.getvalue()))
    return Path(path)


def _limits(robot: Robot, result: Result, start: float, end: float) -> list[tuple[float, float]]:
    """Ranges of x and y that hold the robot throughout."""
    rows = np.flatnonzero((result.t >= start) & (result.t <= end))[::5]
    names = [name for name in robot.frames if name != "universe"]
    points = np.array([[robot.placement(result.q[row], name).translation[:2] for name in names] for row in rows])
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    room = 0.06 * float((high - low).max())
    return [(float(a - room), float(b + room)) for a, b in zip(low, high, strict=True)]
