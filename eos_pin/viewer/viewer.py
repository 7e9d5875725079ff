"""Views of a motion: a stand-alone HTML file, and a live view in the browser.

Both are the same page (`player.html`), drawn by meshcat's JavaScript. meshcat's own server is not used: it listens on
every network interface and is another process that may outlive the script.
"""

from __future__ import annotations

import base64
import gzip
import importlib.util
import time
import webbrowser
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import (
    Array,
    JointVector,
    Positive,
    Vector,
    VectorLike,
    checked,
    number,
    vector,
)
from eos_pin._files import write_atomically
from eos_pin.errors import MissingDependencyError
from eos_pin.viewer.curves import LiveCurves, described
from eos_pin.viewer.scene import Placed, Scene, packed, sampled

#: Kinds of message to a live page: one more frame of a run, or a whole motion instead of what the page has.
FRAME, MOTION = 0, 1
Self = TypeVar("Self", bound="Served")


@checked
def write_html(
    path: str | Path, scene: Scene, t: VectorLike, q: Float[np.ndarray, "k n"], *, fps: Positive = 30.0
) -> Path:
    """Write a motion as one HTML file that plays from disk, offline, in any current browser.

    Space plays and pauses, arrow keys step, R resets the camera; `#t=1.5&paused&speed=0.5` behind the file's address
    opens it at that instant. The page is not able to load anything from the network: it forbids itself to.

    Args:
        path: File to write; an existing one is replaced when the new one is complete.
        scene: The scene to show.
        t: Times [s], not decreasing.
        q: Joints at these times [rad or m].
        fps: Frames kept for each second; between them the page interpolates.

    Returns:
        The file's path.

    Raises:
        InputError: `t` and `q` do not fit each other or the robot.
        OutputError: The file cannot be written.
    """
    path = Path(path)
    html = page(scene.pack(*sampled(scene.robot, t, q, rate=fps)))
    write_atomically(path, lambda file: file.write(html.encode()))
    return path


class Served:
    """A page in any number of browsers on this machine, from a server that ends with this process.

    Attributes:
        url: Address to open in a browser.
    """

    def __init__(self, make: Callable[[str], str], port: int = 7000) -> None:
        """Start the server.

        Args:
            make: The page, for the connections that it may make.
            port: Port to listen on if it is free; otherwise the system chooses one.
        """
        # Serving needs tornado, which a script that only writes files should not wait for.
        from eos_pin.viewer._server import LOOPBACK, Server

        self._server = Server(port)
        self.url = self._server.url
        self._server.serve(make(f"ws://{LOOPBACK}:{self._server.port} ws://localhost:{self._server.port}"))

    @property
    def browsers(self) -> int:
        """Number of browsers that are connected."""
        return len(self._server.clients)

    @checked
    def open(self, *, wait: float = 10.0) -> bool:
        """Open the default browser and wait until it shows the scene.

        Args:
            wait: Longest time to wait [s].

        Returns:
            Whether a browser is there. If not, `url` can still be opened by hand.
        """
        return webbrowser.open(self.url) and self._server.seen.wait(wait)

    def close(self) -> None:
        """Stop the server; browsers keep the motion that they have."""
        self._server.close()

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class Viewer(Served):
    """Live view of a robot, in any number of browsers on this machine.

    The server is a thread of this process and listens on the loopback interface only: no other machine can connect, and
    nothing stays behind, however the process ends. Browsers may come, go and reload at any time; each gets the run from
    its start, to be scrubbed back and forth, also when the run is over. For example:

        with Viewer(scene, q) as viewer:
            viewer.open()
            for t, q in motion:
                viewer.show(t, q)

    Attributes:
        url: Address to open in a browser.
    """

    @checked
    def __init__(
        self,
        scene: Scene,
        q: VectorLike,
        *,
        t: float = 0.0,
        speed: float = 1.0,
        fps: float = 60.0,
        port: int = 7000,
        curves: LiveCurves | None = None,
    ) -> None:
        """Start the server.

        Args:
            scene: The scene to show.
            q: Joints at the start [rad or m].
            t: Time at the start [s].
            speed: Pace that `show` holds: 1 for real time; a large number for as fast as the caller is.
            fps: Frames sent at most in each second of the clock on the wall.
            port: Port to listen on if it is free; otherwise the system chooses one.
            curves: Curves that grow beside the picture; see `eos_pin.viewer.curves.live_curves`.
        """
        self._scene = scene
        self._speed, self._period = number(speed, "speed", above=0.0), 1.0 / number(fps, "fps", above=0.0)
        q, self._curves = vector(q, scene.robot.n, "q"), curves
        more = {"curves": described({"": (np.array([t]), curves.panels)})} if curves else None
        heading = {"title": scene.title or scene.robot.name, "caption": scene.caption}
        shown = packed(np.array([t]), [Placed(scene, q[None])], **heading, more=more)
        super().__init__(lambda connect: page(shown, connect=connect), port)
        self._time, self._due, self._sent = t, time.monotonic(), -np.inf

    @checked
    def show(self, t: float, q: JointVector) -> None:
        """Show the robot at time `t` [s]; waits while the run is ahead of the clock on the wall."""
        # A run that was slower than the clock goes on from where it is: it does not hurry to catch up.
        self._due = max(self._due + max(t - self._time, 0.0) / self._speed, time.monotonic() - self._period)
        self._time = t
        time.sleep(max(self._due - time.monotonic(), 0.0))
        if time.monotonic() - self._sent >= self._period:
            self._sent = time.monotonic()
            values = self._curves.read(t, q) if self._curves else ()
            self._server.send(_message(FRAME, np.array([t]), self._scene.poses(t, q), values))

    @checked
    def play(self, t: VectorLike, q: Float[np.ndarray, "k n"], *, fps: float = 30.0) -> None:
        """Hand a whole motion to the browsers, which play it by themselves; arguments as for `write_html`."""
        times, joints = sampled(self._scene.robot, t, q, rate=fps)
        poses = np.array([self._scene.poses(*frame) for frame in zip(times, joints, strict=True)])
        self._server.send(_message(MOTION, times, poses), final=True)


def _message(kind: int, times: Vector, poses: Array, values: Array | tuple[()] = ()) -> bytes:
    """Message for the page's `receive`: kind, number of frames, their times, poses, and values of curves."""
    return np.concatenate([[kind, times.size], times, poses.ravel(), values]).astype("<f4").tobytes()


def page(packed: bytes, *, connect: str = "'none'", scripts: Sequence[str] = ()) -> str:
    """The page that draws a packed scene.

    Args:
        packed: Result of `Scene.pack`.
        connect: Content security policy for connections; a file needs none.
        scripts: Scripts of a page that does more than to replay.
    """
    scripts = (script("curves.js"), *scripts)
    template = script("player.html")
    marks = {"connect": connect, "meshcat": _meshcat(), "scene": _text(packed), "scripts": "\n".join(scripts)}
    for mark, text in marks.items():
        template = template.replace(f"@{mark}@", text, 1)
    return template


def script(name: str) -> str:
    """A script of the page."""
    return files("eos_pin.viewer").joinpath(name).read_text(encoding="utf-8")


@cache
def _meshcat() -> str:
    """JavaScript of meshcat, found without importing its Python side and the servers that come with it."""
    found = importlib.util.find_spec("meshcat")
    if found is None or found.origin is None:
        raise MissingDependencyError("the viewer", "meshcat", "pip install meshcat")
    return _text(gzip.compress(Path(found.origin).with_name("viewer").joinpath("dist", "main.min.js").read_bytes(), 9))


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()
