"""The page in a real browser: what a person would see of it."""

from __future__ import annotations

import asyncio
import base64
import io
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import coal
import numpy as np
import pytest
from PIL import Image
from tornado.websocket import websocket_connect

from eos_pin.robot import Robot
from eos_pin.scene import Obstacle, Scene
from eos_pin.viewer import Viewer, write_html

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(
        CHROMIUM is None and not os.environ.get("EOS_PIN_NEEDS_BROWSER"),
        reason="no Chromium on this machine; install the package chromium",
    ),
]
FLAGS = [
    *("--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"),
    *("--disable-sync", "--mute-audio", "--window-size=1000,640", "--remote-debugging-port=0"),
]


class Chromium:
    """A headless browser, spoken to by the DevTools protocol."""

    def __init__(self, profile: str) -> None:
        assert CHROMIUM
        self.loop = asyncio.new_event_loop()
        silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self.process = subprocess.Popen([CHROMIUM, *FLAGS, f"--user-data-dir={profile}", "about:blank"], **silent)
        file = Path(profile, "DevToolsActivePort")
        wait_for(lambda: file.is_file() and file.read_text().count("\n"), 30.0)
        self.port = int(file.read_text().split()[0])

    def open(self, url: str) -> Page:
        return Page(self, url)

    def close(self) -> None:
        self.process.terminate()
        self.process.wait(10)
        self.loop.close()


class Page:
    """One tab."""

    def __init__(self, browser: Chromium, url: str) -> None:
        self.loop, self.events, self.number = browser.loop, [], 0
        self.base = f"http://127.0.0.1:{browser.port}/json"
        with urlopen(Request(f"{self.base}/new?about:blank", method="PUT"), timeout=10) as answer:
            self.tab = json.load(answer)
        self.socket = self.loop.run_until_complete(self._connect())
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.do(f"{domain}.enable")
        self.do("Page.navigate", url=url)
        wait_for(lambda: self.js("document.body && document.body.dataset.state"), 30.0)

    async def _connect(self) -> Any:
        return await websocket_connect(self.tab["webSocketDebuggerUrl"], max_message_size=2**28)

    def do(self, method: str, **parameters: Any) -> dict[str, Any]:
        self.number += 1
        return self.loop.run_until_complete(asyncio.wait_for(self._do(method, parameters), 30))

    async def _disconnect(self) -> None:
        self.socket.close()
        while await self.socket.read_message() is not None:
            pass

    async def _do(self, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        await self.socket.write_message(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while True:
            message = await self.socket.read_message()
            assert isinstance(message, str), "the browser has gone"
            answer = json.loads(message)
            if answer.get("id") == self.number:
                assert "result" in answer, answer
                return answer["result"]
            self.events.append(answer)

    def js(self, expression: str) -> Any:
        return self.do("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def picture(self) -> np.ndarray:
        data = self.do("Page.captureScreenshot", format="png")["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"), dtype=float)

    def key(self, key: str) -> None:
        text = {"text": key} if len(key) == 1 else {}
        self.do("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        self.do("Input.dispatchKeyEvent", type="keyUp", key=key)

    def clock(self) -> float:
        return float(self.js("document.getElementById('seek').value"))

    def requests(self) -> list[str]:
        return [
            event["params"]["request"]["url"] for event in self.events if event["method"] == "Network.requestWillBeSent"
        ]

    def troubles(self) -> list[Any]:
        self.js("0")  # events that are on their way arrive before the answer
        wrong = ("Runtime.exceptionThrown", "Log.entryAdded")
        return [
            event
            for event in self.events
            if event["method"] in wrong and event["params"].get("entry", {}).get("level", "error") == "error"
        ]

    def close(self) -> None:
        self.loop.run_until_complete(self._disconnect())
        with urlopen(f"{self.base}/close/{self.tab['id']}", timeout=10):
            pass


def wait_for(condition: Any, seconds: float) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Chromium]:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Chromium(profile)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def motion() -> tuple[np.ndarray, np.ndarray]:
    t = np.linspace(0.0, 10.0, 401)
    rest = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.8])
    return t, rest + 0.4 * np.sin(0.2 * np.pi * t[:, None] * np.array([1, 2, 1, 2, 1, 2, 1]))


@pytest.fixture(scope="module")
def replay(panda: Robot, motion: tuple[np.ndarray, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> str:
    t, q = motion
    path = tmp_path_factory.mktemp("replay") / "panda.html"
    reference = np.array([panda.placement(each, "panda_hand").translation for each in q])
    scene = Scene(
        panda,
        paths={"reference": reference},
        traces={"actual": "panda_hand"},
        obstacles=(Obstacle(coal.Sphere(0.08), [0.6, 0.4, 0.3], name="ball"),),
        title="panda </script> & <b>friends</b>",
    )
    return write_html(path, scene, t, q).as_uri()


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


def test_replay_makes_no_request(chromium: Chromium, replay: str) -> None:
    page = chromium.open(f"{replay}#paused")
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


def test_replay_plays_pauses_steps_and_changes_speed(chromium: Chromium, replay: str) -> None:
    page = chromium.open(replay)
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
    page.key(" ")
    started = time.monotonic()
    wait_for(lambda: page.clock() > 2.0, 20.0)
    assert time.monotonic() - started < 10.0
    page.key("End")
    assert page.clock() == pytest.approx(10.0)
    names = page.js("[...document.querySelectorAll('#legend button')].map(b => b.textContent).join()")
    assert names == "reference,actual,ball"
    assert not page.troubles()
    page.close()


def test_live_view_follows_the_run_in_two_browsers(chromium: Chromium, panda: Robot, motion: Any) -> None:
    t, q = motion
    with Viewer(Scene(panda, traces={"actual": "panda_hand"}), q[0], port=0) as viewer:
        pages = [chromium.open(viewer.url) for _ in range(2)]
        wait_for(lambda: viewer.browsers == 2, 10.0)
        for instant, joints in zip(t[:40], q[:40], strict=True):
            viewer.show(instant, joints)
        for page in pages:
            wait_for(lambda page=page: page.clock() > 0.7, 10.0)
            assert page.js("document.getElementById('live').textContent") == "live"
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
