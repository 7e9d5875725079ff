"""The page in a real browser: what a person would see of it."""

from __future__ import annotations

import base64
import gzip
import os
import re
import shlex
import shutil
import subprocess
import threading
import time
import zlib
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

import coal
import numpy as np
import pytest
from browser import CHROMIUM, FLAGS, MARKS, Chromium, Page, light, wait_for
from PIL import Image

from eos_pin.robot.model import Robot
from eos_pin.viewer.curves import live_curves
from eos_pin.viewer.scene import Obstacle, Scene
from eos_pin.viewer.viewer import Viewer, write_html

pytestmark = MARKS


@pytest.fixture(scope="module")
def motion() -> tuple[np.ndarray, np.ndarray]:
    t = np.linspace(0.0, 10.0, 401)
    rest = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.8])
    return t, rest + 0.4 * np.sin(0.2 * np.pi * t[:, None] * np.array([1, 2, 1, 2, 1, 2, 1]))


def written(robot: Robot, motion: tuple[np.ndarray, np.ndarray], path: Path) -> str:
    """Address of a replay."""
    t, q = motion
    reference = np.array([robot.placement(each, "panda_hand").translation for each in q])
    scene = Scene(
        robot,
        paths={"reference": reference},
        traces={"actual": "panda_hand"},
        obstacles=(Obstacle(coal.Sphere(0.08), [0.6, 0.4, 0.3], name="ball"),),
        title="panda </script> & <b>friends</b>",
    )
    return write_html(path, scene, t, q).as_uri()


@pytest.fixture(scope="module")
def replay(panda: Robot, motion: tuple[np.ndarray, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(panda, motion, tmp_path_factory.mktemp("replay") / "panda.html")


@pytest.fixture(scope="module")
def light_replay(panda: Robot, motion: tuple[np.ndarray, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> str:
    """For what does not depend on how the robot looks."""
    return written(light(panda), motion, tmp_path_factory.mktemp("light") / "panda.html")


def background(picture: np.ndarray) -> np.ndarray:
    """What the page looks like where there is nothing: its gradient runs from top to bottom."""
    return picture[:, -1:]


def test_replay_shows_the_robot_and_it_moves(chromium: Chromium, replay: str) -> None:
    page = chromium.open(f"{replay}#t=1&paused")
    first = page.picture()
    assert page.js("document.body.dataset.state") == "ready"
    assert page.clock() == pytest.approx(1.0)
    page.js("document.getElementById('seek').value = 3; document.getElementById('seek').oninput()")
    time.sleep(0.3)
    second = page.picture()
    middle = (slice(100, 520), slice(300, 700))
    seen = np.abs(first - background(first))[middle].max(axis=-1) > 40
    assert 0.05 < seen.mean() < 0.6
    moved = np.abs(first - second)[middle].max(axis=-1) > 40
    assert moved.mean() > 0.03
    assert not page.troubles()
    page.close()


def test_replay_makes_no_request(chromium: Chromium, light_replay: str) -> None:
    page = chromium.open(f"{light_replay}#paused")
    time.sleep(0.3)
    page.js("0")
    assert page.requests()[0].startswith("file://")
    assert all(url.startswith(("file://", "data:", "blob:")) for url in page.requests())
    assert len([url for url in page.requests() if url.startswith("file://")]) == 1
    # Even a page that wanted to could not.
    assert (
        page.js("fetch('http://127.0.0.1:9/').then(() => 'sent', e => 'refused').then(r => window.outcome = r), 0") == 0
    )
    wait_for(lambda: page.js("window.outcome"), 5.0)
    assert page.js("window.outcome") == "refused"
    assert not any("127.0.0.1:9" in url for url in page.requests())
    page.close()


def test_replay_plays_pauses_steps_and_changes_speed(chromium: Chromium, light_replay: str) -> None:
    page = chromium.open(light_replay)
    assert page.js("document.title") == "panda </script> & <b>friends</b>"
    wait_for(lambda: page.clock() > 0.3, 20.0)
    page.key(" ")
    here = page.clock()
    time.sleep(0.3)
    assert page.clock() == here
    page.key("ArrowRight")
    assert page.clock() == pytest.approx(here + 1 / 30)
    page.key("Home")
    assert page.clock() == 0.0
    page.js("const s = document.getElementById('speed'); s.value = '5'; s.onchange()")
    page.js(
        "window.seen = []; (function look(stamp) {"
        " if (stamp) seen.push([stamp, Number(document.getElementById('seek').value)]);"
        " requestAnimationFrame(look) })()"
    )
    page.key(" ")
    wait_for(lambda: page.clock() > 2.0, 60.0)
    # However slowly pictures come, each one advances by five times the time since the one before, up to 0.25 s.
    seen = np.array(page.js("seen"))
    seen = seen[(seen[:, 1] > 0.0) & (seen[:, 1] < 10.0)]
    passed = np.minimum(np.diff(seen[:, 0]) / 1000.0, 0.25)
    assert np.diff(seen[:, 1]) == pytest.approx(5.0 * passed, abs=0.02)
    page.key("End")
    assert page.clock() == pytest.approx(10.0)
    names = page.js("[...document.querySelectorAll('#legend button')].map(b => b.textContent).join()")
    assert names == "reference,actual,ball"
    assert not page.troubles()
    page.close()


def test_live_view_follows_the_run_in_two_browsers(chromium: Chromium, panda: Robot, motion: Any) -> None:
    t, q = motion
    curves = live_curves(panda, q[0])
    with Viewer(Scene(light(panda), traces={"actual": "panda_hand"}), q[0], port=0, curves=curves) as viewer:
        pages = [chromium.open(viewer.url) for _ in range(2)]
        wait_for(lambda: viewer.browsers == 2, 10.0)
        for instant, joints in zip(t[:40], q[:40], strict=True):
            viewer.show(instant, joints)
        for page in pages:
            wait_for(lambda page=page: page.clock() > 0.7, 10.0)
            assert page.js("document.getElementById('live').textContent") == "live"
            # Both at once: more of the run may come between two questions.
            read = "[document.querySelector('#curves output').textContent, document.getElementById('seek').value]"
            told, instant = map(float, page.js(read))
            assert told == pytest.approx(np.interp(instant, t, q[:, 0]), abs=2e-3)
        pages[0].close()
        wait_for(lambda: viewer.browsers == 1, 10.0)
        viewer.show(t[40], q[40])
        wait_for(lambda: pages[1].clock() == pytest.approx(t[40]), 10.0)
        viewer.play(t, q)
        wait_for(lambda: pages[1].js("Number(document.getElementById('seek').max)") == 10.0, 10.0)
        wait_for(lambda: 0.2 < pages[1].clock() < 5.0, 10.0)
    wait_for(lambda: pages[1].js("document.getElementById('live').textContent") == "ended", 10.0)
    assert not pages[1].troubles()
    pages[1].close()


# -- every state of the page has a picture or a word -------------------------------------------------------------


def visible(page: Page) -> str:
    """All text that a person sees."""
    return str(page.js("document.body.innerText") or "")


def test_picture_command_of_the_readme_has_the_robot_in_it(replay: str, tmp_path: Path) -> None:
    """The command is run word by word; it takes a picture as soon as the page counts as loaded."""
    (command,) = re.findall(r"`(chromium .*?)`", Path(__file__).parents[2].joinpath("README.md").read_text())
    page = tmp_path / "runs" / "panda-position" / "replay.html"
    page.parent.mkdir(parents=True)
    shutil.copy(url2pathname(urlsplit(replay).path), page)
    (tmp_path / "docs").mkdir()
    # A browser that may be started by root and has a profile of its own.
    browser, flags = tmp_path / "chromium", [flag for flag in FLAGS if not flag.startswith("--remote-debugging")]
    browser.write_text(f'#!/bin/sh\nexec {shlex.join([str(CHROMIUM), *flags])} --user-data-dir=profile "$@"\n')
    browser.chmod(0o755)
    path = {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    run = ["sh", "-c", command]
    subprocess.run(run, cwd=tmp_path, env=os.environ | path, capture_output=True, timeout=60, check=True)
    picture = np.asarray(Image.open(tmp_path / "docs" / "panda.png").convert("RGB"), dtype=float)
    assert picture.shape[:2] == (640, 1000)
    seen = np.abs(picture - background(picture))[100:520, 300:700].max(axis=-1) > 40
    assert seen.mean() > 0.05


def test_page_unpacks_scenes_packed_by_python(chromium: Chromium, light_replay: str) -> None:
    page = chromium.open(f"{light_replay}#paused")
    random = np.random.default_rng(0)
    noise = random.bytes(70_000)
    texts = (b"", b"a", b"abcabc" * 20_000, noise, noise[:9_000] * 5, bytes(range(256)) * 300, b"x" * 300_000)
    for data in texts:
        for level in (0, 1, 9):
            packed = base64.b64encode(gzip.compress(data, level, mtime=0)).decode()
            bytes_of = f"Uint8Array.from(atob('{packed}'), c => c.charCodeAt(0))"
            digest = (
                f"(() => {{ const out = new Uint8Array(inflate({bytes_of})); let sum = 7; "
                "for (const byte of out) sum = (31 * sum + byte) % 1000003; return out.length + ' ' + sum; })()"
            )
            total = 7
            for byte in data:
                total = (31 * total + byte) % 1000003
            assert page.js(digest) == f"{len(data)} {total}"
    # Codes that are agreed on rather than sent are for short texts only.
    fixed = zlib.compressobj(9, zlib.DEFLATED, -15, strategy=zlib.Z_FIXED)
    raw = fixed.compress(b"abcd" * 50) + fixed.flush()
    packed = base64.b64encode(bytes(10) + raw + bytes(4) + (200).to_bytes(4, "little")).decode()
    bytes_of = f"Uint8Array.from(atob('{packed}'), c => c.charCodeAt(0))"
    assert page.js(f"new TextDecoder().decode(inflate({bytes_of}))") == "abcd" * 50
    page.close()


def test_page_that_is_still_loading_shows_it(chromium: Chromium, light_replay: str) -> None:
    text = Path(url2pathname(urlsplit(light_replay).path)).read_bytes()
    go_on = threading.Event()

    class Slow(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write(text[: len(text) // 2])
            self.wfile.flush()
            go_on.wait(30.0)
            self.wfile.write(text[len(text) // 2 :])

        def log_message(self, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Slow)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        page = chromium.open(f"http://127.0.0.1:{server.server_port}/#paused", wait=False)
        wait_for(lambda: "Loading the replay" in visible(page), 10.0)
        assert page.js("document.body.dataset.state") is None
        go_on.set()
        wait_for(lambda: page.js("document.body.dataset.state") == "ready", 20.0)
        assert "Loading" not in visible(page)
        page.close()
    finally:
        server.shutdown()
        server.server_close()


@pytest.mark.parametrize("part", [0.2, 0.9999])
def test_file_that_was_cut_off_shows_an_error(chromium: Chromium, replay: str, part: float, tmp_path: Path) -> None:
    text = Path(url2pathname(urlsplit(replay).path)).read_bytes()
    cut = tmp_path / "cut.html"
    cut.write_bytes(text[: min(int(part * len(text)), len(text) - 40)])
    page = chromium.open(cut.as_uri())
    assert page.js("document.body.dataset.state") == "failed"
    assert "This replay is incomplete" in visible(page)
    assert "eos-pin replay RUN.npz --html FILE" in visible(page)
    page.close()


def test_browser_without_webgl_shows_advice(chromium: Chromium, light_replay: str) -> None:
    none = "HTMLCanvasElement.prototype.getContext = () => null;"
    page = chromium.open(light_replay, before=(("Page.addScriptToEvaluateOnNewDocument", {"source": none}),))
    assert page.js("document.body.dataset.state") == "failed"
    said = visible(page)
    assert "this browser has no WebGL" in said
    assert "another browser" in said
    assert "panda </script> & friends" in said.replace("<b>", "").replace("</b>", "")
    assert page.js("document.getElementById('bar').offsetParent") is None
    page.close()


def test_browser_whose_graphics_are_reset_shows_it(chromium: Chromium, light_replay: str) -> None:
    page = chromium.open(f"{light_replay}#paused")
    page.js(
        "document.querySelector('#view canvas').getContext('webgl2').getExtension('WEBGL_lose_context').loseContext()"
    )
    wait_for(lambda: "Reload the page" in visible(page), 10.0)
    page.close()


def test_browser_without_scripts_shows_it(chromium: Chromium, light_replay: str) -> None:
    off = (("Emulation.setScriptExecutionDisabled", {"value": True}),)
    page = chromium.open(light_replay, before=off, wait=False)
    wait_for(lambda: "JavaScript" in visible(page), 20.0)
    assert "Loading" not in visible(page)
    page.close()


def test_narrow_screen_has_all_controls(chromium: Chromium, light_replay: str) -> None:
    narrow = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    page = chromium.open(f"{light_replay}#paused", before=(("Emulation.setDeviceMetricsOverride", narrow),))
    for hidden in ("true", "false"):
        page.js(f"document.getElementById('live').hidden = {hidden}")
        boxes = page.js(
            "['play', 'seek', 'clock', 'live', 'speed', 'reset']"
            ".map(id => document.getElementById(id).getBoundingClientRect())"
            ".filter(box => box.width).map(box => [box.left, box.right])"
        )
        assert len(boxes) == 5
        assert all(right - left >= 30 for left, right in boxes)
        edges = [edge for box in boxes for edge in box]
        assert edges == sorted(edges)
        assert edges[0] >= 16
        assert edges[-1] <= 390 - 16
    # The camera comes back to where it was.
    start = page.picture()
    page.do("Input.dispatchMouseEvent", type="mouseWheel", x=195, y=400, deltaX=0, deltaY=-600)
    wait_for(lambda: np.abs(page.picture() - start).max() > 40, 10.0)
    page.js("document.getElementById('reset').click()")
    wait_for(lambda: np.abs(page.picture() - start)[:700].max() < 40, 10.0)
    page.close()
