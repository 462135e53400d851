"""The page's server: where it listens, whom it lets in, and a session for each browser."""

import asyncio
import hmac
import ipaddress
import logging
import re
import secrets
import socket
from collections.abc import Callable
from pathlib import Path

from aiohttp import WSCloseCode, web
from aiohttp.http import HttpProcessingError
from aiohttp.typedefs import Handler

from hardware.session import ended_by_signal
from tripillar.viewer.page.page import Page, Subject

FILES = (
    "page.css",
    "page.js",
    "numbers.js",
    "picture.js",
    "plot.js",
    "files.js",
)  #: all that is served beside page.html
MAX_BROWSERS = 8  #: at once; each has a scene of its own, 40 MB
MAX_CONNECTIONS = 64  #: at once, browsers with a page not counted; one more ends the oldest
MAX_BYTES = 2**16  #: of a message; the state of 500 pads takes 20 kB
PATIENCE_S = 10.0  #: for a request and its answer
GOODBYE_S = 1.0  #: for a browser to take leave
POLL_S = 0.05  #: between two looks at a sensor, and for Ctrl-C
HEARTBEAT_S = 20.0  #: between two pings of a browser
HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}  #: of every answer, refusals too
#: nothing from elsewhere, and no script but the page's files; {host} for browsers whose 'self' is no web socket
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self' ws://{host} wss://{host}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
#: requests that are no HTTP are refused with 400, and are no error of ours to be printed
logging.getLogger("aiohttp.server").addFilter(
    lambda record: not (record.exc_info and isinstance(record.exc_info[1], HttpProcessingError))
)
HOST = re.compile(r"(?:\[([0-9a-f:.]+)\]|([^\[\]:@/]+))(?::[0-9]+)?")


# where it listens


def page_url(host: str, port: int, token: str) -> str:
    """The page's address for browsers: loopback for all interfaces, IPv6 in brackets.

    >>> page_url("0.0.0.0", 8080, "a"), page_url("::1", 80, "b")
    ('http://127.0.0.1:8080/?token=a', 'http://[::1]:80/?token=b')
    """
    plain = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    return f"http://[{plain}]:{port}/?token={token}" if ":" in plain else f"http://{plain}:{port}/?token={token}"


# whom it lets in


class Guard:
    """Lets in whoever has the page's token, under a name of this machine, from the page itself.

    The host is the address to listen on as the user gave it; where it is a name, the page may be called by it.

    Notes
    -----
    A page of another site can make a browser ask this server for anything. Its requests carry its own Origin, and no
    cookie of ours, which is SameSite=Strict. If it lets a name of its own point here (DNS rebinding), that name is in
    the Host header. A numeric address cannot point elsewhere, so the one that a connection came to is always right.
    """

    def __init__(self, host: str) -> None:
        self.token = secrets.token_urlsafe(32)
        self._host = host.lower()

    @web.middleware
    async def admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Answer a request, or refuse it with 403."""
        address, port = request.get_extra_info("sockname")[:2]
        hosts, origins = request.headers.getall("Host", []), request.headers.getall("Origin", [])
        if len(hosts) != 1 or not self.is_ours(hosts[0], address):
            raise web.HTTPForbidden(text="This server has no such name: open the address that it printed.\n")
        is_own = origins in ([f"http://{hosts[0]}"], [f"https://{hosts[0]}"])  # https: of a proxy before this server
        if not is_own and (origins or "Upgrade" in request.headers):
            raise web.HTTPForbidden(text="Pages of other sites have no access.\n")
        cookie = f"tripillar_{port}"  # a browser gives the cookies of one port to all
        is_entering = request.path == "/" and self._is_token(request.query.get("token", ""))
        if not is_entering and not self._is_token(request.cookies.get(cookie, "")):
            raise web.HTTPForbidden(text="Open the address that tripillar printed, with its token.\n")
        response = await handler(request)
        if not response.prepared:  # a web socket is over by now
            response.headers["Content-Security-Policy"] = POLICY.format(host=hosts[0])
            if is_entering:
                response.set_cookie(cookie, self.token, httponly=True, samesite="Strict")
        return response

    def _is_token(self, said: str) -> bool:
        return hmac.compare_digest(said.encode(errors="replace"), self.token.encode())

    def is_ours(self, host: str, address: str) -> bool:
        """Whether a Host header names this server to a connection that came to an address."""
        found = HOST.fullmatch(host.lower())
        name = "" if found is None else found[1] or found[2]
        here = ipaddress.ip_address(address.partition("%")[0])
        if isinstance(here, ipaddress.IPv6Address):
            here = here.ipv4_mapped or here
        try:
            return ipaddress.ip_address(name) == here
        except ValueError:
            return name == self._host or (name == "localhost" and here.is_loopback)


# the server


class Server:
    """Serves the page on one port, with bounds on all that a stranger can ask for; the host is as the user gave it."""

    def __init__(self, subject: Subject, host: str) -> None:
        self._subject, self._host, self._guard = subject, host, Guard(host)
        self._sockets: dict[web.WebSocketResponse, asyncio.BaseProtocol | None] = {}  # and the connection of each
        app = web.Application(middlewares=[self._guard.admit], client_max_size=MAX_BYTES)
        app.on_response_prepare.append(self._add_headers)
        app.add_routes([web.get(f"/{name}", self._file) for name in ("", *FILES)])
        app.add_routes([web.get("/socket", self._socket)])
        self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=GOODBYE_S)

    async def start(self, listening: socket.socket) -> str:
        """Serve on a socket of `hardware.streams.stream.listening_on`; returns the page's address."""
        await self._runner.setup()
        http, loop = self._runner.server, asyncio.get_running_loop()
        assert http is not None

        def end(connection: web.RequestHandler) -> None:
            """End a connection that is no browser's, whether it asks, waits or does not take its answer."""
            if connection not in self._sockets.values() and connection.transport is not None:
                connection.transport.abort()

        def connected() -> asyncio.BaseProtocol:
            strangers = [one for one in http.connections if one not in self._sockets.values()]
            if len(strangers) >= MAX_CONNECTIONS:
                end(strangers[0])  # the oldest: nobody can hold all places
            connection = http()
            loop.call_later(PATIENCE_S, end, connection)
            return connection

        self._listening = await loop.create_server(connected, sock=listening)
        return page_url(self._host, listening.getsockname()[1], self._guard.token)

    async def stop(self) -> None:
        """Close all browsers' sockets and stop listening."""
        self._listening.close()
        goodbyes = [asyncio.create_task(one.close(code=WSCloseCode.GOING_AWAY)) for one in self._sockets]
        if goodbyes:
            await asyncio.wait(goodbyes, timeout=GOODBYE_S)
        await self._runner.cleanup()

    async def _add_headers(self, request: web.BaseRequest, response: web.StreamResponse) -> None:
        response.headers.update(HEADERS)

    async def _file(self, request: web.Request) -> web.StreamResponse:
        return web.FileResponse(Path(__file__).with_name(request.path[1:] or "page.html"))

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        """A browser's session, until it leaves."""
        browser = web.WebSocketResponse(
            max_msg_size=MAX_BYTES, heartbeat=HEARTBEAT_S, compress=False, timeout=GOODBYE_S, autoping=False
        )
        await browser.prepare(request)
        if len(self._sockets) >= MAX_BROWSERS:
            said = f"{MAX_BROWSERS} browsers look already: close one of them, and reload."
            await browser.close(code=WSCloseCode.TRY_AGAIN_LATER, message=said.encode())
            return browser
        self._sockets[browser] = request.protocol
        page = None
        try:
            page = Page(self._subject)
            await page.run(browser)
        finally:
            del self._sockets[browser]
            if page is not None:
                page.close()
        return browser


async def serve(subject: Subject, host: str, listening: socket.socket, on_ready: Callable[[str], None]) -> None:
    """Serve the page, and look at its sensor, until Ctrl-C or a termination; a second one interrupts.

    The host is as the user gave it, the socket one of `hardware.streams.stream.listening_on`. `on_ready` is called
    with the page's address, which holds its token, once browsers can come.
    """
    server = Server(subject, host)
    with ended_by_signal() as is_ended:
        on_ready(await server.start(listening))
        try:
            while not is_ended():
                if subject.feed is not None:
                    subject.feed.look()
                await asyncio.sleep(POLL_S)
        finally:
            await server.stop()
