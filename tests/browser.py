"""A headless browser for tests of pages."""

from __future__ import annotations

import asyncio
import base64
import io
import json
import os
import shutil
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.request import Request, urlopen

import numpy as np
import pytest
from PIL import Image
from tornado.websocket import websocket_connect

from eos_pin.robot.model import Robot

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
MARKS = [
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


#: Edges of pictures stay rough: without a graphics card, smooth ones take twice the time.
ROUGH = (
    "const plain = HTMLCanvasElement.prototype.getContext; HTMLCanvasElement.prototype.getContext = "
    "function (kind, options) { return plain.call(this, kind, { ...options, antialias: false }); };"
)


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

    def open(self, url: str, **how: Any) -> Page:
        return Page(self, url, **how)

    def close(self) -> None:
        self.process.terminate()
        self.process.wait(10)
        self.loop.close()


class Page:
    """One tab."""

    def __init__(
        self, browser: Chromium, url: str, *, before: tuple[tuple[str, dict[str, Any]], ...] = (), wait: bool = True
    ) -> None:
        self.loop, self.events, self.number = browser.loop, [], 0
        self.base = f"http://127.0.0.1:{browser.port}/json"
        with urlopen(Request(f"{self.base}/new?about:blank", method="PUT"), timeout=10) as answer:
            self.tab = json.load(answer)
        self.socket = self.loop.run_until_complete(self._connect())
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.do(f"{domain}.enable")
        for method, parameters in (("Page.addScriptToEvaluateOnNewDocument", {"source": ROUGH}), *before):
            self.do(method, **parameters)
        self.do("Page.navigate", url=url)
        if wait:
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


def light(robot: Robot) -> Robot:
    """The robot drawn by its joints: without a graphics card each picture of meshes takes half a second."""
    return replace(robot, shapes=SimpleNamespace(visual=None, collision=robot.collision))


def wait_for(condition: Any, seconds: float) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
