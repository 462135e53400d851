"""Where the page listens."""

import socket

from geometry.errors import TriPillarError


class AddressError(TriPillarError, OSError):
    """An address that cannot be listened on."""


def listening_on(host: str, port: int) -> socket.socket:
    """A socket that listens there.

    Raises
    ------
    AddressError
        If the host is none of this machine, or another program listens on that port.
    """
    opened = None
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        opened = socket.socket(family, kind, protocol)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind(address)
        opened.listen()
    except (OSError, UnicodeError) as error:
        if opened is not None:
            opened.close()
        why = error.strerror if isinstance(error, OSError) else "no name of a machine"
        raise AddressError(
            f"cannot listen on {host}, port {port}: {why}; give another --host or --http-port."
        ) from None
    return opened


def require_free(host: str, port: int) -> None:
    """Refuse an address that cannot be listened on, before anything takes time.

    Raises
    ------
    AddressError
        As `listening_on`.
    """
    listening_on(host, port).close()


def page_url(host: str, port: int, token: str) -> str:
    """The page's address as browsers take it.

    Every interface has the loopback's name, too; IPv6 stands in brackets.

    >>> page_url("0.0.0.0", 8080, "a"), page_url("::1", 80, "b")
    ('http://127.0.0.1:8080/?token=a', 'http://[::1]:80/?token=b')
    """
    plain = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    return f"http://[{plain}]:{port}/?token={token}" if ":" in plain else f"http://{plain}:{port}/?token={token}"
