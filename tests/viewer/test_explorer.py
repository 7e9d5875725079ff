"""The explorer: its kinematics against the package, and its page in a browser."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typecheck
from browser import MARKS, Chromium, Page, light, wait_for

from eos_pin import (
    Chart,
    DistanceTask,
    EosError,
    ExtendedDynamics,
    InputError,
    OrientationTask,
    Robot,
    Task,
    load_robot,
    make_task,
    rest_posture,
    self_motion_manifold,
)
from eos_pin.planning.obstacles.bodies import Bodies, Clearances
from eos_pin.viewer import explorer
from eos_pin.viewer.explorer import described, write_explorer

KINEMATICS = Path(explorer.__file__).with_name("kinematics.js")
NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="no Node on this machine; the browser tests run the same script")
pytestmark = pytest.mark.usefixtures("unchecked")


def computed(data: dict[str, Any], cases: Any, program: str) -> Any:
    """Result of a program on the page's kinematics, with `robot`, `chart` and `cases` at hand."""
    code = (
        f"const K = require({json.dumps(str(KINEMATICS))});"
        "const {data, cases} = JSON.parse(require('fs').readFileSync(0));"
        "const robot = new K.Robot(data), V = Float64Array.from(data.V);"
        "const chart = new K.Chart(robot, data.q, V, new Float64Array(robot.r));"
        "const plain = (key, value) => ArrayBuffer.isView(value) ? Array.from(value) : value;"
        f"console.log(JSON.stringify((() => {{ {program} }})(), plain));"
    )
    assert NODE
    text = json.dumps({"data": data, "cases": cases})
    run = subprocess.run([NODE, "-e", code], input=text, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def made(name: str, kind: str) -> tuple[Task, np.ndarray]:
    robot = load_robot(name, chain_to="auto")
    task = make_task(robot, kind)  # type: ignore[arg-type]
    return task, rest_posture(task)


def points(task: Task, chart: Chart, count: int, seed: int) -> list[np.ndarray]:
    """Postures on a chart, well inside of it."""
    random, found = np.random.default_rng(seed), []
    while len(found) < count:
        q = chart.q_bar + random.uniform(-0.5, 0.5, task.robot.n)
        try:
            if (
                chart.margin(task.linearize(q)[1]) > 0.5
                and np.abs(chart.inverse(task.value(q), chart.v(q)).q - q).max() < 1e-6
            ):
                found.append(q)
        except EosError:
            continue
    return found


ROBOTS = [
    ("panda", "pose"),
    ("xarm7", "position"),
    ("kinova", "position"),
    ("planar_chain_10", "position"),
    ("planar_chain_10", "pose"),
    ("ppr", "position"),
    ("talos_left_arm", "orientation"),
    ("ur5", "point-axis"),
    ("panda", "axis"),
    ("ppr", "heading"),
]


@needs_node
@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), ROBOTS)
def test_page_computes_the_joints_that_the_package_does(name: str, kind: str) -> None:
    task, q = made(name, kind)
    chart = Chart.from_base(task, q)
    data, _ = described(task, q, self_collision=False)
    states = points(task, chart, 1000, 1)
    cases = [{"z": task.value(x).tolist(), "v": chart.v(x).tolist()} for x in states]
    found = computed(data, cases, "return cases.map(({z, v}) => chart.reach(z, v)?.q);")
    assert max(np.abs(np.array(y) - x).max() for y, x in zip(found, states, strict=True)) < 1e-9


@needs_node
@pytest.mark.parametrize(("name", "kind"), ROBOTS[:4])
def test_page_changes_charts_as_the_package_does(name: str, kind: str) -> None:
    task, q = made(name, kind)
    chart = Chart.from_base(task, q)
    data, _ = described(task, q, self_collision=False)
    states = points(task, chart, 5, 2)
    program = (
        "return cases.map(q => { const c = chart.next(q), {J} = robot.evaluate(q);"
        "return [c.V, c.v, chart.margin(J)]; });"
    )
    for (V, v, margin), x in zip(computed(data, [x.tolist() for x in states], program), states, strict=True):
        after = Chart.from_base(task, x, previous=chart)
        assert np.abs(np.reshape(V, after.V.shape) - after.V).max() < 1e-12
        assert np.abs(v - after.v_bar).max() < 1e-12
        assert margin == pytest.approx(chart.margin(task.linearize(x)[1]), abs=1e-12)


@needs_node
@pytest.mark.parametrize(("name", "kind"), ROBOTS[:3])
def test_page_computes_gravity_inertia_and_distances(name: str, kind: str) -> None:
    """All that is shown as colour, at a thousand postures on the chart and beyond its edge."""
    task, q = made(name, kind)
    robot, chart = task.robot, Chart.from_base(task, q)
    data, _ = described(task, q)
    random, states = np.random.default_rng(3), []
    while len(states) < 1000:
        x = q + random.uniform(-2.0, 2.0, robot.n)
        sigma = np.linalg.svd(task.linearize(x)[1], compute_uv=False)
        # Rounding grows with the condition of G'.
        if sigma[-1] > 0.02 * sigma[0]:
            states.append(x)
    program = (
        "return cases.map(q => { const {J} = robot.evaluate(q), {energy, torque} = robot.gravityLoad();"
        "return [energy, torque, robot.clearance(), robot.manipulability(J), robot.mass(), robot.coupling(J),"
        "chart.margin(J)]; });"
    )
    seen = computed(data, [x.tolist() for x in states], program)
    energy, torque, apart, ways, mass, coupling, margin = (np.array(column) for column in zip(*seen, strict=True))
    clearances, still = Clearances(Bodies.fitted(robot)), np.zeros(robot.n)
    J = [task.linearize(x)[1] for x in states]
    sigma = np.linalg.svd(J, compute_uv=False)
    # Beyond the edge G'U has another sign than at the base point.
    assert (np.linalg.det(J @ chart.U) < 0.0).any()
    expected = [
        (margin, [chart.margin(each) for each in J]),
        (energy, [robot.potential_energy(x) for x in states]),
        (torque, [robot.gravity(x) for x in states]),
        (mass.reshape(-1, robot.n, robot.n), [robot.mass(x) for x in states]),
        (coupling, [ExtendedDynamics.from_state(robot, Chart.from_base(task, x), x, still).coupling for x in states]),
        (apart, clearances.pairs(np.transpose(states)).min(axis=0)),
        ([each["value"] for each in ways], sigma.prod(axis=1)),
        ([each["ratio"] for each in ways], sigma[:, -1] / sigma[:, 0]),
    ]
    for found, own in expected:
        np.testing.assert_allclose(found, own, rtol=0.0, atol=1e-9)


@needs_node
@pytest.mark.parametrize(("name", "kind"), [("panda", "pose"), ("xarm7", "pose"), ("ppr", "position")])
def test_page_traces_the_component_that_the_package_does(name: str, kind: str) -> None:
    task, q = made(name, kind)
    data, _ = described(task, q, self_collision=False)
    program = "const way = K.trace(robot, data.q, chart.z); let s; do s = way.next(); while (!s.done); return s.value;"
    seen = computed(data, [], program)
    manifold = self_motion_manifold(task, task.value(q), starts=[q])
    component = next(each for each in manifold.components if each.locate(q).distance < 1e-9)
    assert seen["closed"] == component.closed
    assert seen["s"][-1] == pytest.approx(component.length, rel=1e-2)
    assert max(np.abs(task.minus(task.value(np.array(x)), manifold.z)).max() for x in seen["nodes"]) < 1e-9
    assert max(component.locate(np.array(x)).distance for x in seen["nodes"][::10]) < 1e-6


@needs_node
def test_page_reads_rotations_near_half_a_turn() -> None:
    import pinocchio as pin

    task = OrientationTask(load_robot("panda", chain_to="panda_hand_tcp"), "panda_hand_tcp")
    q = np.array([0.0, 0.3, 0.0, -1.8, 0.0, 1.6, 0.1])
    data, _ = described(task, q, self_collision=False)
    random, cases = np.random.default_rng(4), []
    for size in (0.0, 1e-9, 1e-4, 1.0, 3.0, 3.14, 3.1415, np.pi - 1e-7):
        axis = random.normal(size=3)
        R0 = pin.exp3(random.normal(size=3))
        delta = size * axis / np.linalg.norm(axis)
        cases.append({"delta": delta.tolist(), "R": R0.ravel().tolist()})
    program = "return cases.map(({delta, R}) => { const z = robot.plus(R, delta); return [z, robot.minus(z, R)]; });"
    for (z, back), case in zip(computed(data, cases, program), cases, strict=True):
        delta = np.array(case["delta"])
        assert np.abs(z - task.plus(np.array(case["R"]), delta)).max() < 1e-12
        assert np.abs(back - delta).max() < 1e-7


@needs_node
def test_page_stays_on_the_task_all_round_the_loop() -> None:
    task, q = made("panda", "pose")
    data, _ = described(task, q, self_collision=False)
    # Twice round, over many charts; and out of reach, where it stops.
    program = (
        "const p = new K.Posture(robot, data.q, V), z = p.z, errors = [];"
        "for (let k = 0; k < 300; k++) { p.moveTo(z, p.v.map(x => x + .1)); errors.push(p.error(z)); }"
        "const charts = p.charts, far = z.map((x, i) => i < 3 ? x + 5 : x), part = p.moveTo(far, p.v);"
        "return [Math.max(...errors), charts, part, p.error(), p.q];"
    )
    worst, charts, part, left, ended = computed(data, [], program)
    assert worst < 1e-9
    assert charts > 5
    assert 0.0 <= part < 0.5
    assert left < 1e-9
    assert np.isfinite(ended).all()


def test_colours_of_the_loop_are_those_of_cividis() -> None:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    colours = explorer.COLOURS.split()
    assert colours == [to_hex(colour) for colour in colormaps["cividis"](np.linspace(0.0, 1.0, len(colours)))]


def test_explorer_refuses_tasks_and_robots_without_formulas(panda: Robot, tmp_path: Path) -> None:
    q = np.array([0.0, 0.3, 0.0, -1.8, 0.0, 1.6, 0.1])
    with pytest.raises(InputError, match=r"formulas for the tasks position, orientation, pose, heading"):
        write_explorer(tmp_path / "a.html", DistanceTask(panda, "panda_hand_tcp", (1.0, 0.0, 0.0)), q)
    ur5 = load_robot("ur5", chain_to="tool0")
    with pytest.raises(InputError, match="no self-motion to explore"):
        write_explorer(tmp_path / "a.html", make_task(ur5, "pose"), rest_posture(make_task(ur5, "pose")))
    # A finger that follows the other.
    task = make_task(load_robot("panda", chain_to="panda_rightfinger"), "position")
    with pytest.raises(InputError, match=r"panda_finger_joint2 follows panda_finger_joint1: choose a frame before"):
        write_explorer(tmp_path / "a.html", task, rest_posture(task))
    assert not list(tmp_path.iterdir())


# -- the page ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    task, q = made("panda", "pose")
    with typecheck.off():
        task = make_task(light(task.robot), "pose")
        return write_explorer(tmp_path_factory.mktemp("explorer") / "panda.html", task, q)


def drag(page: Page, handle: int, right: float, down: float) -> None:
    """Take a handle with the mouse and move it by some pixels."""
    x, y = page.js(f"explorer.onScreen(explorer.handles[{handle}].at)")
    page.do("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button="left", clickCount=1)
    for k in range(1, 6):
        where = {"x": x + k * right / 5, "y": y + k * down / 5}
        page.do("Input.dispatchMouseEvent", type="mouseMoved", **where, button="left", buttons=1)
    page.do("Input.dispatchMouseEvent", type="mouseReleased", x=x + right, y=y + down, button="left", clickCount=1)


def state(page: Page) -> dict[str, Any]:
    return page.js(
        "({z: Array.from(explorer.posture.z), v: Array.from(explorer.posture.v), q: Array.from(explorer.posture.q),"
        "error: explorer.posture.error(), milliseconds: explorer.milliseconds})"
    )


@MARKS[0]
@MARKS[1]
def test_explorer_moves_task_and_self_motion_by_hand(chromium: Chromium, written: Path, tmp_path: Path) -> None:
    task, q = made("panda", "pose")
    assert write_explorer(tmp_path / "meshes.html", task, q).stat().st_size < 4e6
    page = chromium.open(written.as_uri())
    wait_for(lambda: page.js("explorer.loop() !== null"), 20.0)
    start = state(page)
    nodes, margins = page.js(
        "(({nodes, heights}) => [nodes.map(q => Array.from(q)), heights.map(h => h.margin)])(explorer.loop())"
    )
    chart = Chart.from_base(task, np.array(start["q"]))
    for q, margin in list(zip(nodes, margins, strict=True))[::10]:
        assert margin == pytest.approx(chart.margin(task.linearize(np.array(q))[1]), abs=1e-9)
    # What is chosen is the height of the map and the colour of the loop, between the values beside the scale.
    page.js("{ const s = document.querySelector('#panel h2 select'); s.value = 'coupling'; s.onchange(); }")
    shown = page.js("[...document.querySelectorAll('#panel .scale span')].map(each => Number(each.textContent))")
    M, J = task.robot.mass(np.array(nodes[0])), task.linearize(np.array(nodes[0]))[1]
    along, rest = J.T, np.linalg.svd(J)[2][-1]
    shared = np.linalg.solve(along.T @ M @ along, along.T @ M @ rest)
    cosine = np.sqrt(rest @ M @ along @ shared / (rest @ M @ rest))
    couplings = page.js("explorer.loop().heights.map(each => each.coupling)")
    assert couplings[0] == pytest.approx(cosine, abs=1e-9)
    assert shown == pytest.approx([min(couplings), max(couplings)], rel=6e-3)
    drag(page, 1, -60.0, 15.0)
    elbow = state(page)
    assert np.abs(np.array(elbow["v"]) - start["v"]).max() > 0.05
    # By the package: the task has not moved.
    assert np.abs(task.minus(task.value(np.array(elbow["q"])), np.array(start["z"]))).max() < 1e-9
    assert np.abs(np.array(elbow["z"]) - start["z"]).max() < 1e-12
    drag(page, 0, 30.0, -40.0)
    hand = state(page)
    assert np.abs(np.array(hand["z"]) - elbow["z"])[:3].max() > 0.02
    assert np.abs(np.array(hand["z"]) - elbow["z"])[3:].max() < 1e-9
    assert np.abs(np.array(hand["v"]) - elbow["v"]).max() < 1e-9
    assert np.abs(task.minus(task.value(np.array(hand["q"])), np.array(hand["z"]))).max() < 1e-9
    # The keyboard moves what the sliders do.
    page.js("document.querySelector('[aria-label=\"Self-motion coordinate 1\"]').focus()")
    for kind in ("keyDown", "keyUp"):
        page.do("Input.dispatchKeyEvent", type=kind, key="ArrowRight", code="ArrowRight", windowsVirtualKeyCode=39)
    keyed = state(page)
    assert keyed["v"][0] != hand["v"][0]
    assert keyed["error"] < 1e-9
    pace = "[...document.querySelectorAll('#panel td')].some(cell => /^[\\d.]+ ms, \\d+ \\/ s$/.test(cell.textContent))"
    wait_for(lambda: page.js(pace), 10.0)
    assert all(url.startswith(("file://", "data:", "blob:")) for url in page.requests())
    assert len([url for url in page.requests() if url.startswith("file://")]) == 1
    assert not page.troubles()
    # In a second browser the same file moves a robot of its own.
    other = Chromium(str(tmp_path / "profile"))
    try:
        beside = other.open(written.as_uri())
        assert state(beside)["q"] == start["q"]
        beside.js("explorer.go(Array.from(explorer.posture.z), [0.2])")
        assert state(beside)["v"] == pytest.approx([0.2])
        assert state(page)["q"] == keyed["q"]
        assert not beside.troubles()
    finally:
        other.close()
    page.close()


@MARKS[0]
@MARKS[1]
def test_explorer_colours_its_map_of_two_coordinates(unchecked: None, chromium: Chromium, tmp_path: Path) -> None:
    task, q = made("planar_chain_10", "position")
    page = chromium.open(write_explorer(tmp_path / "chain.html", task, q).as_uri())
    wait_for(lambda: page.js("explorer.idle()"), 20.0)
    cells = page.js("explorer.map().heights.map(h => h && h.margin)")
    assert page.js("document.getElementById('panel').scrollWidth <= document.getElementById('panel').clientWidth")
    page.js("{ const s = [...document.querySelectorAll('#panel h2 select')].pop(); s.value = 'margin'; s.onchange(); }")
    shown = page.js("[...document.querySelectorAll('#panel .scale span')].map(each => Number(each.textContent))")
    chart, z = Chart.from_base(task, q), task.value(q)
    side = round(len(cells) ** 0.5)
    own = {}
    for k in (k for k, cell in enumerate(cells) if cell is not None):
        v = np.zeros(8)
        v[:2] = 1.5 * (np.array([k % side, k // side]) - side // 2) / (side // 2)
        own[k] = chart.margin(task.linearize(chart.inverse(z, v).q)[1])
    assert len(own) > 100
    assert [cells[k] for k in own] == pytest.approx(list(own.values()), abs=1e-9)
    assert shown == pytest.approx([min(own.values()), max(own.values())], rel=1e-2)
    assert not page.troubles()
    page.close()


@MARKS[0]
@MARKS[1]
def test_explorer_tilts_the_axis_of_an_arm_with_six_joints(unchecked: None, chromium: Chromium, tmp_path: Path) -> None:
    task, q = made("ur5", "point-axis")
    page = chromium.open(write_explorer(tmp_path / "ur5.html", task, q).as_uri())
    start = state(page)
    pulled = "explorer.handles[{}].drag(explorer.handles[{}].at.map((x, i) => x + [0.04, 0.03, 0.05][i]))"
    page.js(pulled.format(2, 2))
    tilted = state(page)
    assert np.abs(np.array(tilted["z"]) - start["z"])[:3].max() < 1e-9
    assert np.abs(np.array(tilted["z"]) - start["z"])[3:].max() > 0.02
    assert np.abs(np.array(tilted["v"]) - start["v"]).max() < 1e-9
    assert np.abs(task.minus(task.value(np.array(tilted["q"])), np.array(tilted["z"]))).max() < 1e-9
    # The tool turns about its axis, shown by a mark beside it.
    assert "the mark beside the tool" in page.js("document.getElementById('caption').textContent")
    page.js(pulled.format(1, 1))
    turned = state(page)
    assert np.abs(np.array(turned["v"]) - tilted["v"]).max() > 0.02
    assert np.abs(np.array(turned["z"]) - tilted["z"]).max() < 1e-12
    assert not page.troubles()
    page.close()


@MARKS[0]
@MARKS[1]
def test_explorer_fits_a_narrow_screen_and_takes_touch(chromium: Chromium, written: Path) -> None:
    narrow = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    touch = ("Emulation.setTouchEmulationEnabled", {"enabled": True})
    page = chromium.open(written.as_uri(), before=(("Emulation.setDeviceMetricsOverride", narrow), touch))
    boxes = page.js(
        "[...document.querySelectorAll('#panel input, #panel canvas, #panel button, #view canvas')]"
        ".map(e => e.getBoundingClientRect()).map(b => [b.left, b.right])"
    )
    assert len(boxes) >= 10
    assert all(left >= -0.5 and right <= 390.5 for left, right in boxes)
    below, above = page.js(
        "[document.getElementById('panel').getBoundingClientRect().top,"
        "document.querySelector('#view canvas').getBoundingClientRect().bottom]"
    )
    assert above <= below + 1.0
    wait_for(lambda: page.js("explorer.loop() !== null"), 20.0)
    x, y = page.js("explorer.onScreen(explorer.handles[1].at)")
    page.do("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
    for k in range(1, 6):
        page.do("Input.dispatchTouchEvent", type="touchMove", touchPoints=[{"x": x - 8 * k, "y": y + 3 * k}])
    page.do("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    touched = state(page)
    assert abs(touched["v"][0]) > 0.05
    assert touched["error"] < 1e-9
    assert not page.troubles()
    page.close()
