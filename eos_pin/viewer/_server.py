"""The web server behind a live view: one page, one WebSocket, this machine only.

It runs in a thread of the script that shows something. There is no other process that could stay behind, and no
state that a slow or vanished browser could block.
"""

from __future__ import annotations

import asyncio
import socket
import threading
from typing import Any

import tornado.httpserver
import tornado.web
import tornado.websocket

#: The only interface that is listened on.
LOOPBACK = "127.0.0.1"
#: Messages kept for browsers that connect late; of more, older ones are thinned out.
KEPT = 2000


class Server:
    """Serves a page, and sends messages to every browser that shows it.

    Attributes:
        url: Address of the page.
        clients: Browsers connected now.
        seen: Set once a browser has connected.
    """

    def __init__(self, port: int) -> None:
        """Listen, on another port if `port` is taken; `serve` starts answering.

        Args:
            port: Preferred port, 0 for any.
        """
        try:
            self._socket = socket.create_server((LOOPBACK, port))
        except OSError:
            self._socket = socket.create_server((LOOPBACK, 0))
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self.url = f"http://{LOOPBACK}:{self.port}/"
        self.clients: set[_Browser] = set()
        self.seen = threading.Event()
        self.page = b""
        #: Messages that a browser which connects late is sent first.
        self.history: list[bytes] = []
        self._ready = threading.Event()
        self._closed = False

    def serve(self, page: str) -> None:
        """Answer from now on, in a thread that ends with the process."""
        self.page = page.encode()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="eos_pin viewer", daemon=True)
        self._thread.start()
        self._ready.wait()

    def send(self, message: bytes, *, final: bool = False) -> None:
        """Send to all browsers; one that is still busy with an earlier message skips this one.

        Args:
            message: Message to send.
            final: Whether it must not be skipped; messages before it are no longer of interest.
        """
        if not self._closed:
            self._loop.call_soon_threadsafe(self._broadcast, message, final)

    def close(self) -> None:
        """Stop listening and end the thread."""
        if not self._closed:
            self._closed = True
            self._loop.call_soon_threadsafe(self._closing.set)
            self._thread.join(timeout=5.0)

    def _broadcast(self, message: bytes, final: bool) -> None:
        if final:
            self.history.clear()
        self.history.append(message)
        if len(self.history) > KEPT:
            del self.history[1::2]
        for browser in self.clients:
            browser.post(message, final=final)

    async def _serve(self) -> None:
        routes: list[Any] = [("/", _Page, {"server": self}), ("/motion", _Browser, {"server": self})]
        application = tornado.web.Application(log_function=lambda handler: None)
        # Other host names are refused, so that no web page can reach this server by a name of its own.
        application.add_handlers(r"127\.0\.0\.1|localhost", routes)
        server = tornado.httpserver.HTTPServer(application)
        server.add_socket(self._socket)
        self._loop, self._closing = asyncio.get_running_loop(), asyncio.Event()
        self._ready.set()
        await self._closing.wait()
        server.stop()
        # A browser that is alive answers at once; one that hangs is not waited for.
        closing = [browser.part() for browser in self.clients]
        if closing:
            await asyncio.wait([asyncio.ensure_future(each) for each in closing], timeout=1.0)
        await server.close_all_connections()


class _Page(tornado.web.RequestHandler):
    def initialize(self, server: Server) -> None:
        self.server = server

    def get(self) -> None:
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.set_header("Cache-Control", "no-store")
        self.write(self.server.page)


class _Browser(tornado.websocket.WebSocketHandler):
    def initialize(self, server: Server) -> None:
        self.server, self.busy = server, False
        self.waiting: set[asyncio.Task[None]] = set()
        self.gone = asyncio.Event()

    def open(self, *args: str, **kwargs: str) -> None:
        self.set_nodelay(True)
        self.server.clients.add(self)
        self.server.seen.set()
        for message in self.server.history:
            self.post(message, final=True)

    def post(self, message: bytes, *, final: bool) -> None:
        if final or not self.busy:
            self.busy = True
            task = asyncio.ensure_future(self._write(message))
            self.waiting.add(task)
            task.add_done_callback(self.waiting.discard)

    async def part(self) -> None:
        """Send the remaining messages, close, and wait for the answer."""
        await asyncio.gather(*self.waiting)
        self.close(1001, "the run has ended")
        await self.gone.wait()

    async def _write(self, message: bytes) -> None:
        try:
            await self.write_message(message, binary=True)
        except tornado.websocket.WebSocketClosedError:
            pass  # the browser has gone; on_close has forgotten it or is about to
        finally:
            self.busy = False

    def on_message(self, message: str | bytes) -> None:
        """Ignore messages of browsers."""

    def on_close(self) -> None:
        self.server.clients.discard(self)
        self.gone.set()
