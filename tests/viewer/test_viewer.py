"""What is packed for the viewer, the file it writes, and the server behind its live view."""

from __future__ import annotations

import asyncio
import base64
import gzip
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from eos_pin.errors import InputError, OutputError, UnknownNameError, ViewerError
from eos_pin.planning.obstacles.scene import Mesh
from eos_pin.planning.obstacles.scene import Scene as Solids
from eos_pin.robot.loading import load_robot
from eos_pin.robot.model import Robot
from eos_pin.viewer._meshes import skeleton, solid_mesh
from eos_pin.viewer.scene import Obstacle, Scene, sampled
from eos_pin.viewer.solids import obstacles_of
from eos_pin.viewer.viewer import Viewer, write_html

REST = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.8])


def unpack(packed: bytes) -> dict[str, Any]:
    """What the page does with a packed scene."""
    data = gzip.decompress(packed)
    length = int.from_bytes(data[:4], "little")

    def restore(value: dict[str, Any]) -> Any:
        if "kind" not in value:
            return value
        return np.frombuffer(data, f"<{value['kind']}", value["count"], 4 + length + value["start"])

    return json.loads(data[4 : 4 + length], object_hook=restore)


def corners(part: dict[str, Any]) -> np.ndarray:
    """Vertices of a packed part in the frame of its body."""
    local = np.array(part["low"]) + part["vertices"].reshape(-1, 3) / 65535.0 * np.array(part["size"])
    matrix = np.array(part["matrix"]).reshape(4, 4).T
    return local @ matrix[:3, :3].T + matrix[:3, 3]


# -- what is packed ----------------------------------------------------------------------------------------------


def test_packed_motion_is_that_of_pinocchio(panda: Robot) -> None:
    t = np.array([0.0, 0.5, 1.25])
    q = REST + np.outer(t, np.linspace(-0.4, 0.5, 7))
    ball = Obstacle(coal.Sphere(0.1), lambda t: [t, 0.0, 2.0 * t])
    box = Obstacle(coal.Box(0.1, 0.2, 0.3), pin.SE3(pin.utils.rotate("z", 0.3), np.ones(3)))
    scene = unpack(Scene(panda, obstacles=(ball, box)).pack(t, q))
    poses = scene["poses"].reshape(3, scene["bodies"], 7)
    data = panda.model.createData()
    np.testing.assert_allclose(scene["times"], t)
    for k in range(3):
        pin.forwardKinematics(panda.model, data, q[k])
        for i in range(7):
            np.testing.assert_allclose(
                pin.XYZQUATToSE3(poses[k, i]).homogeneous, data.oMi[i + 1].homogeneous, atol=1e-6
            )
    np.testing.assert_allclose(poses[:, 7, :3], np.column_stack([t, 0 * t, 2 * t]))
    np.testing.assert_allclose(poses[0, 8], [1, 1, 1, 0, 0, np.sin(0.15), np.cos(0.15)], atol=1e-6)


def test_packed_robot_fills_the_boxes_of_its_visual_geometry(panda: Robot) -> None:
    scene = unpack(Scene(panda).pack(np.zeros(1), REST[None]))
    assert panda.visual is not None
    for body in range(-1, 7):
        boxes = []
        for item in panda.visual.geometryObjects:
            if item.parentJoint == body + 1:
                box = item.geometry.computeLocalAABB() or item.geometry.aabb_local
                low, high = box.min_, box.max_
                cube = np.array(
                    [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
                )
                boxes.append(np.array([item.placement.act(corner) for corner in cube]))
        drawn = [corners(part) for part in scene["parts"] if part["body"] == body]
        assert bool(drawn) == bool(boxes)
        # An axis of the hand is turned, so the box around its turned box is a little larger than its triangles.
        outer, inner = np.vstack(boxes), np.vstack(drawn)
        assert (inner.min(axis=0) >= outer.min(axis=0) - 0.004).all()
        assert (inner.max(axis=0) <= outer.max(axis=0) + 0.004).all()
        assert np.ptp(inner, axis=0).max() > 0.75 * np.ptp(outer, axis=0).max()
    colors = {tuple(part["color"]) for part in scene["parts"]}
    assert len(colors) > 4  # the mesh files' own: white, grey, black, and small lamps
    assert all(part["faces"].max() < part["vertices"].size // 3 for part in scene["parts"])


def test_collision_meshes_are_not_even_read() -> None:
    robot = load_robot("panda", chain_to="panda_hand")
    Scene(robot).pack(np.zeros(1), REST[None])
    assert "collision" not in vars(robot.shapes)


def test_equal_meshes_are_stored_once() -> None:
    scene = unpack(Scene(load_robot("kinova")).pack(np.zeros(1), np.zeros((1, load_robot("kinova").n))))
    places = [part["vertices"].ctypes.data for part in scene["parts"]]
    assert len(set(places)) < len(places)


positive = st.floats(0.01, 5.0)


@settings(max_examples=15, deadline=None)
@given(positive, positive, positive)
def test_solids_have_their_volume(a: float, b: float, c: float) -> None:
    ball = 4.0 / 3.0 * np.pi
    cases = {
        coal.Sphere(a): ball * a**3,
        coal.Ellipsoid(a, b, c): ball * a * b * c,
        coal.Box(a, b, c): a * b * c,
        coal.Cylinder(a, b): np.pi * a**2 * b,
        coal.Capsule(a, b): np.pi * a**2 * b + ball * a**3,
        coal.Cone(a, b): np.pi * a**2 * b / 3.0,
    }
    for shape, volume in cases.items():
        mesh = solid_mesh(shape)
        x, y, z = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
        assert np.einsum("ij,ij->", x, np.cross(y, z)) / 6.0 == pytest.approx(volume, rel=0.03)
        shape.computeLocalAABB()
        np.testing.assert_allclose(mesh.vertices.min(axis=0), shape.aabb_local.min_, atol=0.02 * max(a, b, c))
        np.testing.assert_allclose(mesh.vertices.max(axis=0), shape.aabb_local.max_, atol=0.02 * max(a, b, c))


def test_meshes_of_plans_are_drawn_as_their_hulls() -> None:
    corners = np.array([[x, y, z] for x in (0.4, 0.5) for y in (0.0, 0.2) for z in (0.3, 0.6)])
    (found,) = obstacles_of(Solids(meshes=[Mesh(np.vstack((corners, [[0.45, 0.1, 0.4]])), "part")]))
    mesh = solid_mesh(found.shape)
    assert found.name == "part"
    np.testing.assert_allclose(np.unique(mesh.vertices, axis=0), np.unique(corners, axis=0), atol=1e-6)
    x, y, z = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", x, np.cross(y, z)) / 6.0 == pytest.approx(0.1 * 0.2 * 0.3)


def test_half_space_cannot_be_drawn(ppr: Robot) -> None:
    with pytest.raises(ViewerError, match="Halfspace cannot be drawn"):
        Scene(ppr, obstacles=(Obstacle(coal.Halfspace(), [0, 0, 0]),)).pack(np.zeros(1), np.zeros((1, 3)))


def test_mesh_that_only_pinocchio_reads_is_drawn_in_one_colour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import trimesh

    def fail(*args: object, **options: object) -> None:
        raise KeyError("no such reader")

    robot = load_robot("xarm7")
    before = unpack(Scene(robot).pack(np.zeros(1), np.zeros((1, 7))))["parts"]
    monkeypatch.setattr(trimesh, "load_scene", fail)
    after = unpack(Scene(robot).pack(np.zeros(1), np.zeros((1, 7))))["parts"]
    assert len(after) == len(before)
    for one, other in zip(before, after, strict=True):
        np.testing.assert_allclose(corners(one).min(axis=0), corners(other).min(axis=0), atol=1e-4)
        assert one["faces"].size == other["faces"].size


def test_robot_without_shapes_is_a_skeleton(panda: Robot, ppr: Robot) -> None:
    for robot in (panda, ppr):
        bare = replace(robot, shapes=None)
        parts = unpack(Scene(bare).pack(np.zeros(1), np.zeros((1, robot.n))))["parts"]
        assert len(parts) == len(skeleton(bare)) > robot.n
        joints = [item for item in skeleton(bare) if item.name in {joint.name for joint in robot.joints}]
        data = robot.model.createData()
        for i, item in enumerate(joints):
            axis = data.joints[i + 1].S[:3] + data.joints[i + 1].S[3:]
            np.testing.assert_allclose(item.placement.rotation[:, 2], axis, atol=1e-9)


def test_scene_refuses_parts_it_cannot_draw(ppr: Robot) -> None:
    with pytest.raises(UnknownNameError, match="no frame is named 'tipp'"):
        Scene(ppr, traces={"actual": "tipp"})
    for path in (np.zeros((3, 2)), np.zeros((0, 3)), np.full((2, 3), np.nan)):
        with pytest.raises(InputError, match="path 'reference' must be finite points"):
            Scene(ppr, paths={"reference": path})
    with pytest.raises(InputError, match=r"position of 'disc' must be 3 numbers"):
        Scene(ppr, obstacles=(Obstacle(coal.Sphere(1.0), [0, 0], name="disc"),)).poses(0.0, np.zeros(3))


def test_long_path_keeps_its_ends(ppr: Robot) -> None:
    points = np.random.default_rng(0).normal(size=(54_321, 3))
    kept = Scene(ppr, paths={"reference": points}).paths["reference"]
    assert len(kept) == 2000
    np.testing.assert_array_equal(kept[[0, -1]], points[[0, -1]])


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.001, 3.0), min_size=1, max_size=20), st.floats(1.0, 100.0))
def test_sampling_keeps_ends_and_straight_lines(steps: list[float], rate: float) -> None:
    robot = load_robot("ppr")
    t = np.concatenate([[1.0], 1.0 + np.cumsum(steps)])
    slope = np.array([1.0, -2.0, 0.5])
    frames, q = sampled(robot, t, np.outer(t, slope), rate=rate)
    np.testing.assert_allclose(frames[[0, -1]], t[[0, -1]])
    assert np.diff(frames).max() <= 1.0 / rate * (1.0 + 1e-9)
    np.testing.assert_allclose(q, np.outer(frames, slope), atol=1e-9)


def test_sampling_refuses_bad_motions(ppr: Robot) -> None:
    for t, q, message in (
        ([0.0, 1.0], np.zeros((3, 3)), "got shape"),
        ([0.0], np.zeros((1, 2)), "q must hold 3 finite joint values"),
        ([], np.zeros((0, 3)), "q must hold"),
        ([0.0], np.full((1, 3), np.inf), "q must hold"),
        ([1.0, 0.0], np.zeros((2, 3)), "t must not decrease"),
    ):
        with pytest.raises(InputError, match=message):
            sampled(ppr, t, q, rate=30.0)


# -- the file ----------------------------------------------------------------------------------------------------


def test_panda_for_ten_seconds_is_small_and_has_no_address(panda: Robot, tmp_path: Path) -> None:
    t = np.linspace(0.0, 10.0, 1001)
    q = REST + 0.3 * np.sin(t[:, None] * np.arange(1, 8))
    path = write_html(tmp_path / "panda.html", Scene(panda, traces={"actual": "panda_hand"}), t, q)
    assert path.stat().st_size < 2.5e6  # asked for: 6 MB
    text = path.read_text(encoding="utf-8")
    assert "connect-src 'none'" in text
    assert "default-src 'none'" in text
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!data:)", text)
    packed = re.search(r'<script id="scene" type="text/plain">([^<]*)</script>', text)
    assert packed is not None
    assert unpack(base64.b64decode(packed[1]))["times"].size == 301


def test_file_is_replaced_whole_or_not_at_all(ppr: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.html"
    assert write_html(path, Scene(ppr), [0.0], np.zeros((1, 3))) == path
    before = path.read_bytes()

    def die(file: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", die)
    with pytest.raises(KeyboardInterrupt):
        write_html(path, Scene(ppr), [0.0], np.ones((1, 3)))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_folder_is_made_and_a_failed_write_is_reported(ppr: Robot, tmp_path: Path) -> None:
    assert write_html(tmp_path / "new" / "run.html", Scene(ppr), [0.0], np.zeros((1, 3))).exists()
    with pytest.raises(OutputError, match="cannot write"):
        write_html(tmp_path, Scene(ppr), [0.0], np.zeros((1, 3)))


# -- the live view -----------------------------------------------------------------------------------------------


def listeners() -> dict[int, str]:
    """Ports listened on, with their addresses, as the system sees them."""
    table = {}
    for file in (Path("/proc/net/tcp"), Path("/proc/net/tcp6")):
        for line in file.read_text().splitlines()[1:]:
            local, state = line.split()[1], line.split()[3]
            if state == "0A":
                address, port = local.split(":")
                table[int(port, 16)] = address
    return table


def port_of(viewer: Viewer) -> int:
    return int(viewer.url.rstrip("/").rpartition(":")[2])


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="reads the system's table of sockets, which is Linux's")
def test_server_listens_on_loopback_only(ppr: Robot) -> None:
    with Viewer(Scene(ppr), np.zeros(3), port=0) as viewer:
        assert listeners()[port_of(viewer)] == "0100007F"
    assert port_of(viewer) not in listeners()


def test_two_viewers_share_a_preferred_port(ppr: Robot) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with Viewer(Scene(ppr), np.zeros(3), port=port) as one, Viewer(Scene(ppr), np.zeros(3), port=port) as two:
            assert len({port, port_of(one), port_of(two)}) == 3


async def fetch(url: str, **headers: str) -> tuple[int, bytes]:
    try:
        answer = await AsyncHTTPClient().fetch(HTTPRequest(url, headers=headers))
    except HTTPClientError as error:
        return error.code, b""
    return answer.code, answer.body


def test_server_answers_this_machine_by_its_own_name_only(ppr: Robot) -> None:
    with Viewer(Scene(ppr, title="a title"), np.zeros(3), port=0) as viewer:
        code, page = asyncio.run(fetch(viewer.url))
        assert code == 200
        assert f"connect-src ws://127.0.0.1:{port_of(viewer)}".encode() in page
        assert asyncio.run(fetch(viewer.url, Host="example.org"))[0] == 404
        socket_url = viewer.url.replace("http", "ws") + "motion"
        with pytest.raises(HTTPClientError, match="403"):
            asyncio.run(connect_from(socket_url, "http://example.org"))


async def connect_from(url: str, origin: str) -> None:
    await websocket_connect(HTTPRequest(url, headers={"Origin": origin}))


def test_browsers_receive_frames_and_motions_and_may_leave(ppr: Robot) -> None:
    scene = Scene(ppr)

    async def browse(viewer: Viewer) -> None:
        loop = asyncio.get_running_loop()
        url = viewer.url.replace("http", "ws") + "motion"
        first, second = await websocket_connect(url), await websocket_connect(url)
        while viewer.browsers < 2:
            await asyncio.sleep(0.01)
        await loop.run_in_executor(None, viewer.show, 0.25, np.array([0.1, 0.2, 0.3]))
        for browser in (first, second):
            message = np.frombuffer(await browser.read_message(), "<f4")
            np.testing.assert_allclose(message[:3], [0, 1, 0.25])
            np.testing.assert_allclose(
                message[3:].reshape(3, 7), scene.poses(0.0, np.array([0.1, 0.2, 0.3])), atol=1e-6
            )
        # One that comes late has the run from its start.
        await asyncio.sleep(0.02)
        await loop.run_in_executor(None, viewer.show, 0.5, np.zeros(3))
        late = await websocket_connect(url)
        times = [np.frombuffer(await late.read_message(), "<f4")[2] for _ in range(2)]
        np.testing.assert_array_equal(times, [0.25, 0.5])
        late.close()
        assert np.frombuffer(await second.read_message(), "<f4")[2] == 0.5
        first.close()
        assert (await first.read_message(), await first.read_message())[1] is None
        while viewer.browsers > 1:
            await asyncio.sleep(0.01)
        viewer.play([0.0, 2.0], np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]]), fps=10)
        message = np.frombuffer(await second.read_message(), "<f4")
        np.testing.assert_allclose(message[:2], [1, 21])
        np.testing.assert_allclose(message[2:23], np.linspace(0.0, 2.0, 21), atol=1e-6)
        # One that comes late is shown what the others see.
        late = await websocket_connect(url)
        np.testing.assert_array_equal(np.frombuffer(await late.read_message(), "<f4"), message)
        await loop.run_in_executor(None, viewer.close)
        for browser in (second, late):
            assert await browser.read_message() is None
            browser.close()

    with Viewer(scene, np.zeros(3), port=0, speed=1e6) as viewer:
        asyncio.run(browse(viewer))
        viewer.show(3.0, np.zeros(3))  # nobody listens; a run goes on
        viewer.close()


def test_show_keeps_pace_with_the_clock(ppr: Robot) -> None:
    def seconds(viewer: Viewer, pause: float = 0.0) -> float:
        start = time.monotonic()
        for t in np.linspace(0.0, 0.5, 101):
            time.sleep(pause)
            viewer.show(t, np.zeros(3))
        return time.monotonic() - start

    with Viewer(Scene(ppr), np.zeros(3), port=0) as viewer:
        assert 0.45 < seconds(viewer) < 0.8
    with Viewer(Scene(ppr), np.zeros(3), port=0, speed=1e6) as viewer:
        assert seconds(viewer) < 0.3
    with pytest.raises(InputError, match="speed must be"):
        Viewer(Scene(ppr), np.zeros(3), speed=0.0)


SCRIPT = """
import sys, time, numpy as np
from eos_pin.robot.loading import load_robot
from eos_pin.viewer.scene import Scene
from eos_pin.viewer.viewer import Viewer
viewer = Viewer(Scene(load_robot("ppr")), np.zeros(3), port=0)
print(viewer.url, flush=True)
if sys.argv[1] == "runs":
    for t in np.arange(0.0, 60.0, 0.01):
        viewer.show(t, np.zeros(3))
elif sys.argv[1] == "fails":
    raise ValueError("the run went wrong")
"""


@pytest.mark.parametrize("end", ["returns", "fails", "runs"])
def test_server_leaves_no_process_behind(end: str) -> None:
    command = [sys.executable, "-c", SCRIPT, end]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, process_group=0
    ) as script:
        assert script.stdout is not None
        assert script.stderr is not None
        url = script.stdout.readline().strip()
        if end == "runs":
            with socket.create_connection(("127.0.0.1", int(url.rstrip("/").rpartition(":")[2]))):
                script.send_signal(signal.SIGINT)
        errors = script.stderr.read()
        script.wait(20)
    assert ("KeyboardInterrupt" in errors) == (end == "runs")
    assert ("the run went wrong" in errors) == (end == "fails")
    assert errors.count("Traceback") == (end != "returns")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", int(url.rstrip("/").rpartition(":")[2])))
    with pytest.raises(ProcessLookupError):  # no process of its group is left
        os.killpg(script.pid, 0)


def test_viewer_open_returns_whether_a_browser_came(ppr: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) or True)
    with Viewer(Scene(ppr), np.zeros(3), port=0) as viewer:
        assert viewer.open(wait=0.05) is False
        assert opened == [viewer.url]


def test_writing_a_file_loads_no_server() -> None:
    code = "import sys, eos_pin.viewer.viewer; print({'tornado', 'zmq', 'meshcat', 'trimesh'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
