"""The page's server: from a free port to Ctrl-C."""

import asyncio
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from aiohttp import WSCloseCode, web

from tripillar.viewer.page.address import listening_on, page_url
from tripillar.viewer.page.guard import Guard, Handler, add_headers
from tripillar.viewer.page.page import Page, Subject
from tripillar.viewer.page.session import Session

FILES = {
    "/": "page.html",
    "/page.css": "page.css",
    "/page.js": "page.js",
    "/picture.js": "picture.js",
    "/plot.js": "plot.js",
    "/files.js": "files.js",
}  #: all that there is
MAX_BROWSERS = 8  #: at once; each has a scene of its own, 40 MB
MAX_CONNECTIONS = 64  #: at once, without those browsers; one more ends the oldest
MAX_BYTES = 2**16  #: of a message; the state of 500 pads takes 20 kB
PATIENCE_S = 10.0  #: for a request and its answer
GOODBYE_S = 1.0  #: for a browser to take leave
HEARTBEAT_S = 20.0  #: between two signs of life of a browser


def serve(subject: Subject, host: str, port: int, on_ready: Callable[[str], None]) -> None:
    """Serve the page until Ctrl-C or a termination.

    Parameters
    ----------
    subject : Subject
        What the page shows.
    host, port : str, int
        Where to listen; port 0 is any free one.
    on_ready : callable
        Told the page's address, with its token, once browsers can come.

    Raises
    ------
    OSError
        If that port cannot be listened on; `require_free` says so earlier.
    """
    asyncio.run(_serve(subject, host, port, on_ready))


async def _serve(subject: Subject, host: str, port: int, on_ready: Callable[[str], None]) -> None:
    ended, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    server = Server(subject, host)
    working: list[asyncio.Task[Any]] = [asyncio.create_task(ended.wait())]
    if subject.watch is not None:
        working.append(asyncio.create_task(subject.watch.run()))
    try:
        on_ready(await server.start(host, port))
        done, _ = await asyncio.wait(working, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()  # the sensor's failure, if it is that
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)  # a second Ctrl-C interrupts
        for task in working:
            task.cancel()
        await server.stop()


class Server:
    """Serves the page on one port, with bounds on all that a stranger can ask for.

    Parameters
    ----------
    subject : Subject
        What the page shows.
    host : str
        As the user gave it.
    """

    def __init__(self, subject: Subject, host: str) -> None:
        self._subject, self._guard = subject, Guard(host)
        self._sockets: dict[web.WebSocketResponse, object] = {}  # and the connection that each is on

    async def start(self, host: str, port: int) -> str:
        """Listen; the page's address, with the token."""
        guard = self._guard

        @web.middleware
        async def admitted(request: web.Request, handler: Handler) -> web.StreamResponse:
            return await guard.admit(request, handler)

        app = web.Application(middlewares=[admitted], client_max_size=MAX_BYTES)
        app.on_response_prepare.append(add_headers)
        app.add_routes([web.get(path, self._file) for path in FILES])
        app.add_routes([web.get("/socket", self._socket)])
        self._runner = web.AppRunner(app, access_log=None, keepalive_timeout=PATIENCE_S, shutdown_timeout=GOODBYE_S)
        await self._runner.setup()
        self._http = self._runner.server
        assert self._http is not None
        http = self._http

        def connected() -> asyncio.BaseProtocol:
            strangers = [one for one in http.connections if one not in self._sockets.values()]
            if len(strangers) >= MAX_CONNECTIONS and strangers[0].transport is not None:
                strangers[0].transport.abort()  # the oldest: nobody can hold all places
            return http()

        opened = listening_on(host, port)
        self._listening = await asyncio.get_running_loop().create_server(connected, sock=opened)
        self._sweeping = asyncio.create_task(self._sweep())
        return page_url(host, opened.getsockname()[1], guard.token)

    async def stop(self) -> None:
        """Say goodbye to all browsers."""
        if hasattr(self, "_listening"):
            self._sweeping.cancel()
            self._listening.close()
            goodbyes = [asyncio.create_task(socket.close(code=WSCloseCode.GOING_AWAY)) for socket in self._sockets]
            if goodbyes:
                await asyncio.wait(goodbyes, timeout=GOODBYE_S)
            await self._runner.cleanup()

    async def _file(self, request: web.Request) -> web.StreamResponse:
        return web.FileResponse(Path(__file__).with_name(FILES[request.path]))

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        socket = web.WebSocketResponse(
            max_msg_size=MAX_BYTES, heartbeat=HEARTBEAT_S, compress=False, timeout=GOODBYE_S, autoping=False
        )
        await socket.prepare(request)
        if len(self._sockets) >= MAX_BROWSERS:
            said = f"{MAX_BROWSERS} browsers look already: close one of them, and reload."
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=said.encode())
            return socket
        self._sockets[socket] = request.protocol
        page = None
        try:
            page = Page(self._subject)
            await Session(page, socket).run()
        finally:
            del self._sockets[socket]
            if page is not None:
                page.close()
        return socket

    async def _sweep(self) -> None:
        """End connections that neither ask nor take their answer."""
        since: WeakKeyDictionary[object, float] = WeakKeyDictionary()
        assert self._http is not None
        while True:
            await asyncio.sleep(1.0)
            browsers, now = set(self._sockets.values()), time.monotonic()
            for connection in self._http.connections:
                if connection in browsers:
                    since.pop(connection, None)
                elif now - since.setdefault(connection, now) > PATIENCE_S and connection.transport is not None:
                    connection.transport.abort()
