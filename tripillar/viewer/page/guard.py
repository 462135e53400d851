"""Who is let in to the page: whoever has its token, under a name of this machine, from the page itself."""

import hmac
import ipaddress
import re
import secrets
from collections.abc import Awaitable, Callable

from aiohttp import web

HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
#: nothing from elsewhere, and no script but the page's file; {host} for browsers whose 'self' is no web socket
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self' ws://{host} wss://{host}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HOST = re.compile(r"(?:\[([0-9a-f:.]+)\]|([^\[\]:@/]+))(?::[0-9]+)?")
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Guard:
    """The page's token, and who has it.

    Parameters
    ----------
    host : str
        The address to listen on as the user gave it; where it is a name, the page may be called by it.

    Notes
    -----
    A page of another site can make a browser ask this server for anything. Its requests carry its own Origin, and no
    cookie of ours, which is SameSite=Strict; a name of its own that it lets point here (DNS rebinding) is in their
    Host. An address of numbers cannot point elsewhere, so the one that a connection came to is always right.
    """

    def __init__(self, host: str) -> None:
        self.token = secrets.token_urlsafe(32)
        self._host = host.lower()

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
        name = host_name(host)
        here = ipaddress.ip_address(address.partition("%")[0])
        if isinstance(here, ipaddress.IPv6Address):
            here = here.ipv4_mapped or here
        try:
            return ipaddress.ip_address(name) == here
        except ValueError:
            return name == self._host or (name == "localhost" and here.is_loopback)


def host_name(host: str) -> str:
    """The name in a Host header, without its port and an address's brackets; empty if it is none.

    >>> host_name("[::1]:8080"), host_name("LocalHost:80"), host_name("127.0.0.1"), host_name("a:b"), host_name("[a")
    ('::1', 'localhost', '127.0.0.1', '', '')
    """
    found = HOST.fullmatch(host.lower())
    return "" if found is None else found[1] or found[2]


async def add_headers(request: web.BaseRequest, response: web.StreamResponse) -> None:
    """What every answer says, refusals too."""
    response.headers.update(HEADERS)
